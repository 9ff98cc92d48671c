//! Errors of recorders: objects of another context, and copies outside buffers.

use super::*;

/// Buffers, images and kernels of another context are a programming error: the recorder refuses them all.
#[test]
fn a_recorder_takes_nothing_of_another_context() {
    with_host(&options(), |host| {
        let (context, other) = (guest(host), guest(host));
        let buffers = |c: &Context| {
            c.allocate("test", &[("first", 64), ("second", 64)], MemoryKind::Device).expect("memory")
        };
        let (own, foreign) = (buffers(&context), buffers(&other));
        let image = |c: &Context| {
            Image::new(c, "image", vk::Format::R32_SFLOAT, [4, 4], ImageUse::Depth).expect("an image")
        };
        let (own_image, foreign_image) = (image(&context), image(&other));
        let kernel = |c: &Context| {
            let spec = expected_depth::Spec { workgroup_size: c.limits().workgroup_size(64) };
            Kernel::<expected_depth::Interface>::new(c, &spec).expect("a kernel")
        };
        let (own_kernel, foreign_kernel) = (kernel(&context), kernel(&other));
        let push = expected_depth::Push {
            image_width: 4,
            image_height: 4,
            offset_x: 0,
            offset_y: 0,
            min_weight: 0.5,
            empty: 0.0,
        };
        let bind = |depth_sums, target| expected_depth::Bind { accumulated: &own[0], depth_sums, target };
        let own_bind = bind(&own[1], &own_image);
        type Use<'a> = &'a dyn Fn(&mut Recorder);
        let uses: [(&str, Use); 10] = [
            ("kernel", &|r| r.dispatch(&foreign_kernel, &own_bind, &push, 1)),
            ("bound buffer", &|r| r.dispatch(&own_kernel, &bind(&foreign[1], &own_image), &push, 1)),
            ("bound image", &|r| r.dispatch(&own_kernel, &bind(&own[1], &foreign_image), &push, 1)),
            ("arguments", &|r| r.dispatch_indirect(&own_kernel, &own_bind, &push, &foreign[0])),
            ("fill", &|r| r.fill(&foreign[0], 1)),
            ("update", &|r| r.update(&foreign[0], &[0; 4])),
            ("copy from", &|r| r.copy(&foreign[0], &own[0])),
            ("copy to", &|r| r.copy(&own[0], &foreign[0])),
            ("image", &|r| r.copy_from_image(&foreign_image, &own[0])),
            ("image's buffer", &|r| r.copy_from_image(&own_image, &foreign[0])),
        ];
        for (what, record) in uses {
            let panicked = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
                let mut recorder = context.begin("test").expect("a recorder");
                record(&mut recorder);
            }));
            let panic = panicked.expect_err(what);
            let text = panic.downcast_ref::<String>().expect("a message");
            assert!(text.contains("another context"), "{what}: {text}");
        }
    });
}

/// Copies must fit, and an empty copy records no command.
#[test]
fn recorded_copies_stay_inside() {
    with_host(&options(), |host| {
        let context = guest(host);
        let requests = [("small", 60), ("large", 64)];
        let buffers = context.allocate("test", &requests, MemoryKind::Device).expect("memory");
        let image = Image::new(&context, "image", vk::Format::R32_SFLOAT, [4, 4], ImageUse::Depth);
        let image = image.expect("an image");
        type Use<'a> = &'a dyn Fn(&mut Recorder);
        let outside: [Use; 2] =
            [&|r| r.copy_from_image(&image, &buffers[0]), &|r| r.copy_to_image(&buffers[0], &image)];
        for record in outside {
            let panicked = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
                record(&mut context.begin("test").expect("a recorder"));
            }));
            let panic = panicked.expect_err("60 bytes for 16 texels");
            let text = panic.downcast_ref::<String>().expect("a message");
            assert!(text.contains("'small', 60 bytes) is smaller than Image('image'"), "{text}");
        }
        let recorded = context.run("test", |r| {
            let nothing = buffers[0].range(0, 0);
            r.fill(&nothing, 1);
            r.copy(&nothing, &buffers[1]);
            r.barrier();
            r.copy_to_image(&buffers[1], &image);
            Ok(())
        });
        recorded.expect("recorded");
    });
}
