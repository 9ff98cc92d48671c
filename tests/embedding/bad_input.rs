//! Errors of the caller are reported as typed errors before anything is recorded.

use crate::stage::*;
use ashsplat::frame::Dropout;
use ashsplat::kernels::compose::expected_depth;
use ashsplat::scene::Cut;
use ashsplat::vk::{CompileOnly, Features, ForeignImage, Kernel, Recorder};

fn refused_device(host: &Host, change: impl FnOnce(&mut ForeignDevice<'_>)) -> Error {
    let mut foreign = host.foreign();
    change(&mut foreign);
    // SAFETY: refused before anything is made from it.
    unsafe { Context::from_foreign(&foreign, &ContextOptions::default()) }.err().expect("refused")
}

#[test]
fn a_host_that_has_not_enabled_a_feature_is_told_which() {
    // One error names all missing features.
    with_host(&options(), |host| {
        let features = Features { scalar_block_layout: false, subgroup_size_control: false, ..host.features };
        let error = refused_device(host, |h| h.features = features).to_string();
        assert!(error.contains("lacks scalarBlockLayout, subgroupSizeControl (the device has"), "{error}");
    });
    // The device itself lacks the feature.
    with_host(&HostOptions { without: Some("maintenance4"), ..options() }, |host| {
        let error = refused_device(host, |_| ());
        assert!(matches!(&error, Error::MissingFeature { feature, .. } if feature.contains("maintenance4")));
    });
    with_host(&options(), |host| {
        let error = refused_device(host, |h| h.features = Features { synchronization2: false, ..h.features });
        assert!(
            error.to_string().contains("synchronization2") && !error.to_string().contains('\n'),
            "{error}"
        );
        let error = refused_device(host, |h| h.physical_device = vk::PhysicalDevice::null());
        assert!(matches!(&error, Error::Argument { what, .. } if what == "physical_device"), "{error}");
        let error = refused_device(host, |h| h.queue = Some(vk::Queue::null()));
        assert!(matches!(&error, Error::Argument { what, .. } if what == "queue"), "{error}");
        let error = refused_device(host, |h| h.queue_family = 77);
        assert!(matches!(&error, Error::Argument { what, .. } if what == "queue_family"), "{error}");
        // The functions of such a context would take the host's handles for their own.
        let compile_only = Some(CompileOnly { texts: false });
        let options = ContextOptions { compile_only, ..ContextOptions::default() };
        // SAFETY: as in `refused`.
        let error = unsafe { Context::from_foreign(&host.foreign(), &options) }.err().expect("refused");
        assert!(matches!(&error, Error::Argument { what, .. } if what == "compile_only"), "{error}");
    });
}

#[test]
fn a_host_may_keep_its_queue() {
    with_host(&options(), |host| {
        let foreign = ForeignDevice { queue: None, ..host.foreign() };
        let context = guest_of(&foreign, &ContextOptions::default());
        let mut renderer = Renderer::new(&context).expect("kernels");
        let (gaussians, camera) = (cloud(50, 1), camera(0.2, 32, 32));
        let staging_bytes = Reservation::update_bytes(50, 1);
        renderer.reserve(&Reservation { staging_bytes, ..Reservation::new(50, 1, 32, 32) }).expect("memory");
        let mut scene = DeviceScene::empty(&context, 50, 1).expect("a scene");
        scene.set_count(50).expect("room");
        let placed = [Placed::from(&scene)];
        let updates = [Update { scene: &scene, first: 0, gaussians: &gaussians }];
        let frame = RecordedFrame { updates: &updates, ..frame_of(&placed, &camera) };
        rendered(host, &mut renderer, &frame);
        assert!(report_of(&mut renderer, 0).visible > 10);
        assert_error(context.run("nothing", |_| {}), "queue");
    });
}

#[test]
fn null_handles_and_wrong_images_are_refused() {
    with_guest(|host, context| {
        // SAFETY: refused before anything is done with the handles.
        unsafe {
            assert!(matches!(context.adopt_commands(vk::CommandBuffer::null()), Err(Error::Argument { .. })));
            let buffer = Buffer::adopt(&context, "none", vk::Buffer::null(), 0, 16);
            assert!(matches!(buffer, Err(Error::Argument { .. })));
        }
        let own = Staging::new(host, 1024);
        for (offset, bytes) in [(0, 0), (4, 16), (0, 15)] {
            // SAFETY: as above.
            let buffer = unsafe { Buffer::adopt(&context, "odd", own.raw, offset, bytes) };
            assert!(matches!(buffer, Err(Error::Argument { .. })), "{bytes} bytes at {offset}");
        }
        let storage = vk::ImageUsageFlags::STORAGE;
        let texture = Texture::new(host, vk::Format::R8G8B8A8_UNORM, storage, [8, 8]);
        let good = texture.foreign();
        let adopt = |change: &dyn Fn(&mut ForeignImage), purpose| {
            let mut foreign = good;
            change(&mut foreign);
            // SAFETY: as above; a view that is made is of the image as it is.
            unsafe { Image::adopt(&context, "target", &foreign, purpose) }
        };
        assert!(adopt(&|_| (), ImageUse::Target).is_ok());
        type Change<'a> = &'a dyn Fn(&mut ForeignImage);
        let sampled = |f: &mut ForeignImage| {
            (f.format, f.usage) = (vk::Format::R32_UINT, vk::ImageUsageFlags::SAMPLED);
        };
        // No device in use supports storage images of this format.
        let only_mutable = |f: &mut ForeignImage| {
            (f.format, f.flags) = (vk::Format::R8G8B8A8_SRGB, vk::ImageCreateFlags::MUTABLE_FORMAT);
        };
        let depths = |f: &mut ForeignImage| {
            let usage = vk::ImageUsageFlags::DEPTH_STENCIL_ATTACHMENT | vk::ImageUsageFlags::SAMPLED;
            (f.format, f.usage) = (vk::Format::D32_SFLOAT, usage);
            f.samples = vk::SampleCountFlags::TYPE_4;
        };
        let refused: [(Change, ImageUse, &str); 21] = [
            (&|f| f.image = vk::Image::null(), ImageUse::Target, "null"),
            (&|f| f.size = [0, 8], ImageUse::Target, "0 x 8"),
            (&|f| f.size = [8, 1 << 30], ImageUse::Target, "8 x 1073741824, each must be from 1 to "),
            (
                &depths,
                ImageUse::Occluder,
                "'target': it has 4 samples per pixel, kernels see images of one: resolve it",
            ),
            (&|f| f.samples = vk::SampleCountFlags::TYPE_2, ImageUse::Target, "2 samples"),
            (&|f| f.samples = vk::SampleCountFlags::empty(), ImageUse::Target, "samples is 0"),
            (&|f| f.usage = vk::ImageUsageFlags::SAMPLED, ImageUse::Target, "lacks STORAGE"),
            (&|_| (), ImageUse::Occluder, "lacks SAMPLED"),
            (&|f| f.format = vk::Format::D32_SFLOAT, ImageUse::Target, "D32_SFLOAT"),
            // Formats that no frame can use.
            (&|f| f.format = vk::Format::R32_UINT, ImageUse::Target, "R32_UINT is not one of"),
            (&|f| f.format = vk::Format::R8G8_UNORM, ImageUse::Target, "R8G8_UNORM is not one of"),
            (&sampled, ImageUse::Occluder, "R32_UINT is not one of"),
            (&|f| f.format = vk::Format::B8G8R8A8_UNORM, ImageUse::Target, "lack MUTABLE_FORMAT"),
            (&|f| f.format = vk::Format::R16G16_SFLOAT, ImageUse::Motion, "lack MUTABLE_FORMAT"),
            // Each field of a frame has its own formats.
            (&|f| f.format = vk::Format::R32_SFLOAT, ImageUse::Target, "R32_SFLOAT is not one of"),
            (&|_| (), ImageUse::Depth, "R8G8B8A8_UNORM is not one of [R32_SFLOAT]"),
            (&|_| (), ImageUse::Pick, "R8G8B8A8_UNORM is not one of [R32G32B32A32_UINT]"),
            (&|_| (), ImageUse::Motion, "R8G8B8A8_UNORM is not one of [R16G16_SFLOAT]"),
            (&|f| f.format = vk::Format::R32G32_UINT, ImageUse::Target, "R32G32_UINT is not one of"),
            (&|f| f.format = vk::Format::R8G8B8A8_SRGB, ImageUse::Target, "MUTABLE_FORMAT"),
            (&only_mutable, ImageUse::Target, "lack EXTENDED_USAGE"),
        ];
        for (change, purpose, expected) in refused {
            let error = adopt(change, purpose).expect_err(expected);
            assert!(error.to_string().contains(expected), "{error}");
        }
    });
}

/// No error in a frame changes the command buffer or the slot.
#[test]
fn bad_frames_are_refused_before_anything_is_recorded() {
    with_host(&options(), |host| {
        let (context, other) = (guest(host), guest(host));
        let good_camera = camera(0.3, 64, 48);
        let scene = uploaded(&context, &cloud(200, 1));
        let foreign = uploaded(&other, &cloud(200, 1));
        let large = uploaded(&context, &cloud(201, 1));
        let mut renderer = Renderer::new(&context).expect("kernels");
        let settings = RenderSettings::default();
        let in_flight = Commands::new(host);
        let placed = [Placed::from(&scene)];
        let good = RecordedFrame::new(&placed, &good_camera, &settings);
        assert_error(renderer.record(in_flight.begun(&context), 0, &good), "reserve");
        renderer.reserve(&Reservation::new(200, 1, 64, 48)).expect("memory");

        let usage = vk::ImageUsageFlags::STORAGE | vk::ImageUsageFlags::SAMPLED;
        let small = Texture::new(host, vk::Format::R8G8B8A8_UNORM, usage, [40, 48]);
        let single = Texture::new(host, vk::Format::R32_SFLOAT, usage, [64, 48]);
        let images = [
            small.adopt(&context, "target", ImageUse::Target),
            single.adopt(&context, "target", ImageUse::Depth),
            small.adopt(&other, "target", ImageUse::Target),
            single.adopt(&context, "target", ImageUse::Occluder),
        ];
        let of = |scenes| RecordedFrame { scenes, ..good };
        let seen_by = |camera| RecordedFrame { camera, ..good };
        let drawn_with = |settings| RecordedFrame { settings, ..good };
        let onto = |image, behind| RecordedFrame { target: into(image, behind, [0; 2]), ..good };
        let in_image = |image| onto(image, Background::Nothing);
        let nan = Camera { fx: f32::NAN, ..good_camera };
        let nothing = Camera { width: 0, ..good_camera };
        let wide = Camera { width: 65, ..good_camera };
        let parallel = good_camera.orthographic();
        let sheared =
            Pose { world_from_object: Mat3::from_diagonal(Vec3::new(1.0, 2.0, 1.0)), ..Pose::IDENTITY };
        let lost = Pose { translation: Vec3::NAN, ..Pose::IDENTITY };
        let inside_out = Pose { scale: -1.0, ..Pose::IDENTITY };
        let vanished = Pose { scale: 0.0, ..Pose::IDENTITY };
        let read = ImageState { layout: vk::ImageLayout::SHADER_READ_ONLY_OPTIMAL, ..ImageState::UNDEFINED };
        let depth = host_image(&images[3], read);
        let fresh_depth = HostImage { from: ImageState::UNDEFINED, ..depth };
        let whole_target = Texture::new(host, vk::Format::R8G8B8A8_UNORM, usage, [64, 48]);
        let whole = whole_target.adopt(&context, "target", ImageUse::Target);
        let exposed = |exposure| Target::Image {
            to: host_image(&whole, ImageState::UNDEFINED),
            behind: Background::Nothing,
            encoding: ColorEncoding::LinearSrgb { exposure },
        };
        let no_alpha = Texture::new(host, vk::Format::B10G11R11_UFLOAT_PACK32, usage, [64, 48]);
        let no_alpha_view = no_alpha.adopt(&context, "target", ImageUse::Target);
        let distances = host_image(&images[1], ImageState::UNDEFINED);
        let expected = |min_weight| Some(DepthTarget { to: distances, min_weight, empty: f32::NAN });
        let mapping = DepthMapping { scale: 1.0, offset: 0.0, clear_value: 0.0, linear: false };
        let unknown = DepthMapping { scale: f32::NAN, ..mapping };
        let flat = DepthMapping { scale: 0.0, ..mapping };
        let never = DepthMapping { clear_value: f32::NAN, ..mapping };
        let [large_scale, no_dilation, cut_wrong] = [
            RenderSettings { scale_modifier: f32::NAN, ..settings },
            RenderSettings { dilation_px2: 0.0, ..settings },
            RenderSettings { cut: Cut { min_opacity: 2.0, ..Cut::default() }, ..settings },
        ];
        let dropping = Some(Dropout { share: 0.1, seed: 1, iteration: 1 });
        let of_training = RenderSettings { dropout: dropping, ..settings };
        let new = cloud(10, 2);
        let shapeless = Gaussians { quats: Vec::new(), ..new.clone() };
        let change = |scene, first, gaussians| Update { scene, first, gaussians };
        let update = [change(&scene, 0, &new)];
        let [beyond, misshapen, elsewhere] = [
            [update[0], change(&scene, 100_000, &new)],
            [update[0], change(&scene, 0, &shapeless)],
            [update[0], change(&foreign, 0, &new)],
        ];
        let two = [Placed::from(&scene), Placed::from(&scene)];
        let (of_other, too_large) = ([Placed::from(&foreign)], [Placed::from(&large)]);
        let [stretched, nowhere, inside_out, vanished] =
            [sheared, lost, inside_out, vanished].map(|pose| [Placed { pose, ..placed[0] }]);
        let depth_settings = RenderSettings { inverse_depth: true, ..settings };
        let by_distance = RenderSettings { distance_order: true, ..settings };
        let both_settings = RenderSettings { filter_3d: true, ..depth_settings };
        let hidden = |depth, mapping| RecordedFrame { occluder: Some(Occluder { depth, mapping }), ..good };
        let target = "target (image 'target')";
        // Frame, wrong field, and words of the error.
        let bad = [
            (seen_by(&nan), "camera", "focal length"),
            (seen_by(&nothing), "camera", "image size 0x48"),
            (seen_by(&wide), "camera", "where 64 x 48 are reserved, needs"),
            (of(&[]), "scenes", "there are none"),
            (of(&of_other), "scenes[0].scene", "another context"),
            (
                of(&too_large),
                "scenes",
                "the frame needs 201 Gaussians, more than 200 (Reservation::gaussians)",
            ),
            (of(&two), "scenes", "2 of them, Reservation::scenes is 1"),
            (of(&stretched), "scenes[0].pose", "a uniform scale"),
            (of(&inside_out), "scenes[0].pose", "a scale of -1 is not possible"),
            (of(&vanished), "scenes[0].pose", "a scale of 0 is not possible"),
            (of(&nowhere), "scenes[0].pose", "not finite"),
            (drawn_with(&depth_settings), "Reservation::inverse_depth", "not reserved"),
            (seen_by(&parallel), "Reservation::orthographic", "not reserved"),
            (drawn_with(&by_distance), "Reservation::distance_order", "not reserved"),
            (in_image(&images[0]), target, "64 x 48 pixels at (0, 0) exceed its 40 x 48"),
            (in_image(&images[1]), target, "adopted for Depth, not for Target"),
            (in_image(&images[2]), target, "another context"),
            (in_image(&images[3]), target, "adopted for Occluder, not for Target"),
            (hidden(depth, mapping), "Reservation::occlusion", "not reserved"),
            (hidden(depth, flat), "occluder.mapping", "a scale of 0"),
            (hidden(depth, unknown), "occluder.mapping", "not finite"),
            (hidden(depth, never), "occluder.mapping", "not finite"),
            (hidden(fresh_depth, mapping), "occluder (image 'target')", "UNDEFINED"),
            (
                RecordedFrame { depth: expected(0.5), ..hidden(depth, mapping) },
                "depth (image 'target')",
                "is also its occluder",
            ),
            (RecordedFrame { target: exposed(0.0), ..good }, "target.encoding.exposure", "is 0, must be"),
            (RecordedFrame { target: exposed(f32::INFINITY), ..good }, "target.encoding.exposure", "is inf"),
            (in_image(&no_alpha_view), target, "has no alpha"),
            (onto(&whole, Background::Image), target, "UNDEFINED"),
            (
                onto(&whole, Background::Color([0.0, f32::NAN, 0.0])),
                "target.behind",
                "[0.0, NaN, 0.0] is not finite",
            ),
            (drawn_with(&large_scale), "settings.scale_modifier", "is NaN"),
            (drawn_with(&no_dilation), "settings.dilation_px2", "is 0"),
            (drawn_with(&cut_wrong), "settings.cut.min_opacity", "2 is not"),
            (drawn_with(&of_training), "settings.dropout", "of training"),
            (RecordedFrame { depth: expected(f32::NAN), ..good }, "depth.min_weight", "NaN"),
            (RecordedFrame { depth: expected(0.5), ..good }, "Reservation::expected_depth", "not reserved"),
            (
                drawn_with(&both_settings),
                "Reservation::inverse_depth, Reservation::filter_3d",
                "not reserved",
            ),
            (
                RecordedFrame { updates: &update, ..good },
                "updates",
                "more than 0 (Reservation::staging_bytes)",
            ),
            (RecordedFrame { updates: &beyond, ..good }, "updates[1].first", "exceed the scene's"),
            (RecordedFrame { updates: &misshapen, ..good }, "updates[1].gaussians.quats", "0 entries"),
            (RecordedFrame { updates: &elsewhere, ..good }, "updates[1].scene", "another context"),
        ];
        for (frame, field, words) in &bad {
            let error = renderer.record(in_flight.adopt(&context), 0, frame).expect_err(field);
            let text = error.to_string();
            let about = text.strip_prefix(&format!("{field}: ")).unwrap_or_default();
            assert!(about.contains(words) && !text.contains('\n'), "{text} (expected {field}: {words})");
            assert!(matches!(error, Error::Argument { .. } | Error::TooLarge { .. }), "{error:?}");
        }
        let error = renderer.record(in_flight.adopt(&context), 1, &good).expect_err("one slot");
        assert!(error.to_string().starts_with("slot: 1: 1 are reserved"), "{error}");
        let error = renderer.record(in_flight.adopt(&other), 0, &good).expect_err("of another context");
        assert_eq!(error.to_string(), "commands: it belongs to another context");

        // Settings changed after the reservation have no kernels.
        renderer.set_blending(Blending::SharedMemory);
        assert_error(renderer.record(in_flight.adopt(&context), 0, &good), "not built");
        renderer.set_blending(Blending::default());

        // Still usable, and frames ignore the background of the settings. The slot is in flight until the frame has
        // executed.
        let settings = RenderSettings { background: [0.0, f32::INFINITY, 0.0], ..settings };
        let good = RecordedFrame { settings: &settings, ..good };
        renderer.record(in_flight.adopt(&context), 0, &good).expect("a recording");
        assert_error(renderer.record(in_flight.adopt(&context), 0, &good), "in flight");
        assert_error(renderer.reserve(&Reservation::new(200, 1, 64, 48)), "in flight");
        in_flight.finish();
        assert!(report_of(&mut renderer, 0).visible > 50);
        drop((renderer, images, whole, no_alpha_view));
    });
}

#[test]
fn reservations_that_make_no_sense_are_refused() {
    with_guest(|host, context| {
        let mut renderer = Renderer::new(&context).expect("kernels");
        let good = Reservation::new(10, 0, 16, 16);
        for bad in [
            Reservation { width: 0, ..good },
            Reservation { height: 70_000, ..good },
            Reservation { slots: 0, ..good },
            Reservation { sh_degree: 4, ..good },
            Reservation { gaussians: u32::MAX, ..good },
            Reservation { slots: u32::MAX, ..good },
            Reservation { scenes: u32::MAX, ..good },
            Reservation { blend_passes: u32::MAX, ..good },
        ] {
            let error = renderer.reserve(&bad).expect_err("refused");
            assert!(matches!(error, Error::Argument { .. } | Error::TooLarge { .. }), "{error}");
        }
        let error = renderer.grow(&good).expect_err("nothing that could grow");
        assert_eq!(error.to_string(), "slots: none are reserved that could grow: call Renderer::reserve");
        renderer.reserve(&good).expect("memory");
        // The error names the field that needs more than kernels can bind. The previous reservation stays.
        let max = context.limits().max_storage_buffer_range;
        let words = u32::try_from(max / 4 + 1).expect("a number of words");
        for (field, bad) in [
            ("width, height", Reservation { width: 65_535, height: 65_535, instances: 8, ..good }),
            ("gaussians", Reservation { gaussians: words, instances: 8, ..good }),
            ("instances", Reservation { instances: words, ..good }),
            ("scenes, views", Reservation { scenes: 65_536, views: 1024, shared_sort: true, ..good }),
            ("staging_bytes", Reservation { staging_bytes: max + 1, ..good }),
        ] {
            for error in [
                renderer.reserve(&bad).expect_err(field),
                renderer.reservation_bytes(&bad).map(|_| ()).expect_err(field),
            ] {
                assert!(error.to_string().starts_with(&format!("Reservation::{field}")), "{field}: {error}");
            }
            renderer.slot_report(0).expect("the slot is still there");
        }
        let error = renderer.grow(&Reservation { instances: words, ..good }).expect_err("too many");
        assert!(error.to_string().starts_with("Reservation::instances: buffer"), "{error}");

        // More workgroups than the device's grids have.
        let lowered = LimitsOverride { max_workgroups_per_axis: Some(8), ..LimitsOverride::default() };
        let context_options = ContextOptions { limits_override: Some(lowered), ..ContextOptions::default() };
        let context = guest_of(&host.foreign(), &context_options);
        let mut renderer = Renderer::new(&context).expect("kernels");
        assert_error(renderer.reserve(&Reservation::new(10_000_000, 0, 16, 16)), "maxComputeWorkGroupCount");
    });
}

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
    with_guest(|_, context| {
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
        });
        recorded.expect("recorded");
    });
}
