//! Errors of the caller are reported as typed errors before anything is recorded.

mod recorders;

use crate::host::{Host, HostOptions, InFlight};
use crate::memory::{HostBuffer, HostTexture};
use crate::stage::{adopt, camera, cloud, guest, options, rendered, with_host};
use ashsplat::ash::vk;
use ashsplat::forward::Dropout;
use ashsplat::kernels::compose::expected_depth;
use ashsplat::scene::{Cut, Pose};
use ashsplat::vk::{
    Buffer, CompileOnly, Context, ContextOptions, Features, ForeignDevice, Image, ImageState, ImageUse,
    Kernel, LimitsOverride, MemoryKind, Recorder,
};
use ashsplat::{
    Background, Blending, ColorEncoding, DepthTarget, DeviceScene, Error, Gaussians, HostImage, Occluder,
    Placed, RecordedFrame, RenderSettings, Renderer, Reservation, Target, Update,
};
use glam::{Mat3, Vec3};

/// The error of a context with a changed description.
fn refused(host: &Host, change: impl FnOnce(&mut ForeignDevice<'_>)) -> Error {
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
        let error = refused(host, |h| h.features = features).to_string();
        assert!(error.contains("lacks scalarBlockLayout, subgroupSizeControl (the device has"), "{error}");
    });
    // The device itself lacks the feature.
    with_host(&HostOptions { without: Some("maintenance4"), ..options() }, |host| {
        let error = refused(host, |_| ());
        assert!(matches!(&error, Error::MissingFeature { feature, .. } if feature.contains("maintenance4")));
    });
    with_host(&options(), |host| {
        let error = refused(host, |h| h.features = Features { synchronization2: false, ..h.features });
        assert!(
            error.to_string().contains("synchronization2") && !error.to_string().contains('\n'),
            "{error}"
        );
        let error = refused(host, |h| h.physical_device = vk::PhysicalDevice::null());
        assert!(matches!(&error, Error::Argument { what, .. } if what == "physical_device"), "{error}");
        let error = refused(host, |h| h.queue = Some(vk::Queue::null()));
        assert!(matches!(&error, Error::Argument { what, .. } if what == "queue"), "{error}");
        let error = refused(host, |h| h.queue_family = 77);
        assert!(matches!(&error, Error::Argument { what, .. } if what == "queue_family"), "{error}");
        // The functions of such a context would take the host's handles for their own.
        let compile_only = Some(CompileOnly { texts: false });
        let options = ContextOptions { compile_only, ..ContextOptions::default() };
        // SAFETY: as in `refused`.
        let error = unsafe { Context::from_foreign(&host.foreign(), &options) }.err().expect("refused");
        assert!(matches!(&error, Error::Argument { what, .. } if what == "compile_only"), "{error}");
    });
}

/// A context without a queue cannot submit, but can still record.
#[test]
fn a_host_may_keep_its_queue() {
    with_host(&options(), |host| {
        let foreign = ForeignDevice { queue: None, ..host.foreign() };
        // SAFETY: as in `guest`.
        let context =
            unsafe { Context::from_foreign(&foreign, &ContextOptions::default()) }.expect("a context");
        let mut renderer = Renderer::new(&context).expect("kernels");
        let (gaussians, camera) = (cloud(50, 1), camera(0.2, 32, 32));
        let staging_bytes = Reservation::update_bytes(50, 1);
        renderer.reserve(&Reservation { staging_bytes, ..Reservation::new(50, 1, 32, 32) }).expect("memory");
        let mut scene = DeviceScene::empty(&context, 50, 1).expect("a scene");
        scene.set_count(50).expect("room");
        let (settings, placed) = (RenderSettings::default(), [Placed::from(&scene)]);
        let updates = [Update { scene: &scene, first: 0, gaussians: &gaussians }];
        let frame = RecordedFrame { updates: &updates, ..RecordedFrame::new(&placed, &camera, &settings) };
        rendered(host, &mut renderer, &frame);
        assert!(renderer.slot_report(0).expect("a report").expect("finished").visible > 10);
        let error = context.run("nothing", |_| Ok(())).expect_err("no queue");
        assert!(error.to_string().contains("queue"), "{error}");
    });
}

#[test]
fn null_handles_and_wrong_images_are_refused() {
    with_host(&options(), |host| {
        let context = guest(host);
        // SAFETY: refused before anything is done with the handles.
        unsafe {
            assert!(matches!(context.adopt_commands(vk::CommandBuffer::null()), Err(Error::Argument { .. })));
            let buffer = Buffer::adopt(&context, "none", vk::Buffer::null(), 0, 16);
            assert!(matches!(buffer, Err(Error::Argument { .. })));
        }
        let own = HostBuffer::new(host, 1024).expect("memory");
        for (offset, bytes) in [(0, 0), (4, 16), (0, 15)] {
            // SAFETY: as above.
            let buffer = unsafe { Buffer::adopt(&context, "odd", own.raw, offset, bytes) };
            assert!(matches!(buffer, Err(Error::Argument { .. })), "{bytes} bytes at {offset}");
        }
        own.destroy(host);
        let storage = vk::ImageUsageFlags::STORAGE;
        let texture = HostTexture::new(host, vk::Format::R8G8B8A8_UNORM, storage, [8, 8]).expect("an image");
        let good = texture.foreign();
        let adopt = |change: &dyn Fn(&mut ashsplat::vk::ForeignImage), purpose| {
            let mut foreign = good;
            change(&mut foreign);
            // SAFETY: as above; a view that is made is of the image as it is.
            unsafe { Image::adopt(&context, "target", &foreign, purpose) }
        };
        assert!(adopt(&|_| (), ImageUse::Target).is_ok());
        type Change<'a> = &'a dyn Fn(&mut ashsplat::vk::ForeignImage);
        let sampled = |f: &mut ashsplat::vk::ForeignImage| {
            (f.format, f.usage) = (vk::Format::R32_UINT, vk::ImageUsageFlags::SAMPLED);
        };
        // No device in use supports storage images of this format.
        let only_mutable = |f: &mut ashsplat::vk::ForeignImage| {
            (f.format, f.flags) = (vk::Format::R8G8B8A8_SRGB, vk::ImageCreateFlags::MUTABLE_FORMAT);
        };
        let depths = |f: &mut ashsplat::vk::ForeignImage| {
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
        texture.destroy(host);
    });
}

/// No error in a frame changes the command buffer or the slot.
#[test]
fn bad_frames_are_refused_before_anything_is_recorded() {
    with_host(&options(), |host| {
        let (context, other) = (guest(host), guest(host));
        let good_camera = camera(0.3, 64, 48);
        let scene = DeviceScene::upload(&context, &cloud(200, 1), 0).expect("a scene");
        let foreign = DeviceScene::upload(&other, &cloud(200, 1), 0).expect("a scene");
        let large = DeviceScene::upload(&context, &cloud(201, 1), 0).expect("a scene");
        let mut renderer = Renderer::new(&context).expect("kernels");
        let settings = RenderSettings::default();
        let in_flight = InFlight::new(host).expect("a command buffer");
        in_flight.begin(host).expect("recording");
        let placed = [Placed::from(&scene)];
        let good = RecordedFrame::new(&placed, &good_camera, &settings);
        let error = renderer.record(adopt(&context, &in_flight), 0, &good).expect_err("nothing reserved");
        assert!(error.to_string().contains("reserve"), "{error}");
        renderer.reserve(&Reservation::new(200, 1, 64, 48)).expect("memory");

        let usage = vk::ImageUsageFlags::STORAGE | vk::ImageUsageFlags::SAMPLED;
        let small = HostTexture::new(host, vk::Format::R8G8B8A8_UNORM, usage, [40, 48]).expect("an image");
        let single = HostTexture::new(host, vk::Format::R32_SFLOAT, usage, [64, 48]).expect("an image");
        // SAFETY: the descriptions match the images, which outlive the views.
        let view = |c: &Context, t: &HostTexture, purpose| unsafe {
            Image::adopt(c, "target", &t.foreign(), purpose).expect("adopted")
        };
        let images = [
            view(&context, &small, ImageUse::Target),
            view(&context, &single, ImageUse::Depth),
            view(&other, &small, ImageUse::Target),
            view(&context, &single, ImageUse::Occluder),
        ];
        let into = |image| Target::Image {
            to: HostImage { image, from: ImageState::UNDEFINED, offset: [0; 2] },
            behind: Background::Nothing,
            encoding: ColorEncoding::AsTrained,
        };
        let nan = { ashsplat::Camera { fx: f32::NAN, ..good_camera } };
        let nothing = { ashsplat::Camera { width: 0, ..good_camera } };
        let wide = { ashsplat::Camera { width: 65, ..good_camera } };
        let sheared =
            Pose { world_from_object: Mat3::from_diagonal(Vec3::new(1.0, 2.0, 1.0)), ..Pose::IDENTITY };
        let lost = Pose { translation: Vec3::NAN, ..Pose::IDENTITY };
        let inside_out = Pose { scale: -1.0, ..Pose::IDENTITY };
        let vanished = Pose { scale: 0.0, ..Pose::IDENTITY };
        let read = ImageState { layout: vk::ImageLayout::SHADER_READ_ONLY_OPTIMAL, ..ImageState::UNDEFINED };
        let depth = HostImage { image: &images[3], from: read, offset: [0; 2] };
        let fresh_depth = HostImage { from: ImageState::UNDEFINED, ..depth };
        let whole_target =
            HostTexture::new(host, vk::Format::R8G8B8A8_UNORM, usage, [64, 48]).expect("an image");
        let whole = view(&context, &whole_target, ImageUse::Target);
        let onto = |behind| Target::Image {
            to: HostImage { image: &whole, from: ImageState::UNDEFINED, offset: [0; 2] },
            behind,
            encoding: ColorEncoding::AsTrained,
        };
        let exposed = |exposure| Target::Image {
            to: HostImage { image: &whole, from: ImageState::UNDEFINED, offset: [0; 2] },
            behind: Background::Nothing,
            encoding: ColorEncoding::LinearSrgb { exposure },
        };
        let no_alpha = HostTexture::new(host, vk::Format::B10G11R11_UFLOAT_PACK32, usage, [64, 48]);
        let no_alpha = no_alpha.expect("an image");
        let no_alpha_view = view(&context, &no_alpha, ImageUse::Target);
        let distances = HostImage { image: &images[1], from: ImageState::UNDEFINED, offset: [0; 2] };
        let expected = |min_weight| Some(DepthTarget { to: distances, min_weight, empty: f32::NAN });
        let mapping =
            ashsplat::scene::DepthMapping { scale: 1.0, offset: 0.0, clear_value: 0.0, linear: false };
        let unknown = ashsplat::scene::DepthMapping { scale: f32::NAN, ..mapping };
        let flat = ashsplat::scene::DepthMapping { scale: 0.0, ..mapping };
        let never = ashsplat::scene::DepthMapping { clear_value: f32::NAN, ..mapping };
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
        let both_settings = RenderSettings { filter_3d: true, ..depth_settings };
        let hidden = |depth, mapping| RecordedFrame { occluder: Some(Occluder { depth, mapping }), ..good };
        let target = "target (image 'target')";
        // Frame, wrong field, and words of the error.
        let bad = [
            (RecordedFrame { camera: &nan, ..good }, "camera", "focal length"),
            (RecordedFrame { camera: &nothing, ..good }, "camera", "image size 0x48"),
            (RecordedFrame { camera: &wide, ..good }, "camera", "where 64 x 48 are reserved, needs"),
            (RecordedFrame { scenes: &[], ..good }, "scenes", "there are none"),
            (RecordedFrame { scenes: &of_other, ..good }, "scenes[0].scene", "another context"),
            (
                RecordedFrame { scenes: &too_large, ..good },
                "scenes",
                "the frame needs 201 Gaussians, more than 200 (Reservation::gaussians)",
            ),
            (RecordedFrame { scenes: &two, ..good }, "scenes", "2 of them, Reservation::scenes is 1"),
            (RecordedFrame { scenes: &stretched, ..good }, "scenes[0].pose", "a uniform scale"),
            (
                RecordedFrame { scenes: &inside_out, ..good },
                "scenes[0].pose",
                "a scale of -1 is not possible",
            ),
            (RecordedFrame { scenes: &vanished, ..good }, "scenes[0].pose", "a scale of 0 is not possible"),
            (RecordedFrame { scenes: &nowhere, ..good }, "scenes[0].pose", "not finite"),
            (
                RecordedFrame { settings: &depth_settings, ..good },
                "Reservation::inverse_depth",
                "not reserved",
            ),
            (
                RecordedFrame { target: into(&images[0]), ..good },
                target,
                "64 x 48 pixels at (0, 0) exceed its 40 x 48",
            ),
            (RecordedFrame { target: into(&images[1]), ..good }, target, "adopted for Depth, not for Target"),
            (RecordedFrame { target: into(&images[2]), ..good }, target, "another context"),
            (
                RecordedFrame { target: into(&images[3]), ..good },
                target,
                "adopted for Occluder, not for Target",
            ),
            (hidden(depth, mapping), "Reservation::occlusion", "not reserved"),
            (hidden(depth, flat), "occluder.mapping", "a scale of 0"),
            (hidden(depth, unknown), "occluder.mapping", "not finite"),
            (hidden(depth, never), "occluder.mapping", "not finite"),
            (hidden(fresh_depth, mapping), "occluder (image 'target')", "UNDEFINED"),
            (
                RecordedFrame { depth: expected(0.5), ..hidden(depth, mapping) },
                "depth (image 'target')",
                "is also the depth",
            ),
            (RecordedFrame { target: exposed(0.0), ..good }, "target.encoding.exposure", "is 0, must be"),
            (RecordedFrame { target: exposed(f32::INFINITY), ..good }, "target.encoding.exposure", "is inf"),
            (RecordedFrame { target: into(&no_alpha_view), ..good }, target, "has no alpha"),
            (RecordedFrame { target: onto(Background::Image), ..good }, target, "UNDEFINED"),
            (
                RecordedFrame { target: onto(Background::Color([0.0, f32::NAN, 0.0])), ..good },
                "target.behind",
                "[0.0, NaN, 0.0] is not finite",
            ),
            (RecordedFrame { settings: &large_scale, ..good }, "settings.scale_modifier", "is NaN"),
            (RecordedFrame { settings: &no_dilation, ..good }, "settings.dilation_px2", "is 0"),
            (RecordedFrame { settings: &cut_wrong, ..good }, "settings.cut.min_opacity", "2 is not"),
            (RecordedFrame { settings: &of_training, ..good }, "settings.dropout", "of training"),
            (RecordedFrame { depth: expected(f32::NAN), ..good }, "depth.min_weight", "NaN"),
            (RecordedFrame { depth: expected(0.5), ..good }, "Reservation::expected_depth", "not reserved"),
            (
                RecordedFrame { settings: &both_settings, ..good },
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
            let error = renderer.record(adopt(&context, &in_flight), 0, frame).expect_err(field);
            let text = error.to_string();
            let about = text.strip_prefix(&format!("{field}: ")).unwrap_or_default();
            assert!(about.contains(words) && !text.contains('\n'), "{text} (expected {field}: {words})");
            assert!(matches!(error, Error::Argument { .. } | Error::TooLarge { .. }), "{error:?}");
        }
        let error = renderer.record(adopt(&context, &in_flight), 1, &good).expect_err("one slot");
        assert!(error.to_string().starts_with("slot: 1: 1 are reserved"), "{error}");
        let error = renderer.record(adopt(&other, &in_flight), 0, &good).expect_err("of another context");
        assert_eq!(error.to_string(), "commands: it belongs to another context");

        // Settings changed after the reservation have no kernels.
        renderer.set_blending(Blending::SharedMemory);
        let error = renderer.record(adopt(&context, &in_flight), 0, &good).expect_err("no kernels");
        assert!(error.to_string().contains("not built"), "{error}");
        renderer.set_blending(Blending::default());

        // Still usable, and frames ignore the background of the settings. The slot is in flight until the frame has
        // executed.
        let settings = RenderSettings { background: [0.0, f32::INFINITY, 0.0], ..settings };
        let good = RecordedFrame { settings: &settings, ..good };
        renderer.record(adopt(&context, &in_flight), 0, &good).expect("a recording");
        let error = renderer.record(adopt(&context, &in_flight), 0, &good).expect_err("in flight");
        assert!(error.to_string().contains("in flight"), "{error}");
        let error = renderer.reserve(&Reservation::new(200, 1, 64, 48)).expect_err("in flight");
        assert!(error.to_string().contains("in flight"), "{error}");
        in_flight.submit(host).expect("a submission");
        in_flight.wait(host).expect("done");
        assert!(renderer.slot_report(0).expect("a report").expect("finished").visible > 50);
        in_flight.destroy(host);
        drop((renderer, images, whole, no_alpha_view));
        no_alpha.destroy(host);
        whole_target.destroy(host);
        small.destroy(host);
        single.destroy(host);
    });
}

#[test]
fn reservations_that_make_no_sense_are_refused() {
    with_host(&options(), |host| {
        let context = guest(host);
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
        let most = context.limits().max_storage_buffer_range;
        let words = u32::try_from(most / 4 + 1).expect("a number of words");
        for (field, bad) in [
            ("width, height", Reservation { width: 65_535, height: 65_535, instances: 8, ..good }),
            ("gaussians", Reservation { gaussians: words, instances: 8, ..good }),
            ("instances", Reservation { instances: words, ..good }),
            ("scenes, views", Reservation { scenes: 65_536, views: 1024, shared_sort: true, ..good }),
            ("staging_bytes", Reservation { staging_bytes: most + 1, ..good }),
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
        // SAFETY: as in `guest`.
        let context = unsafe { Context::from_foreign(&host.foreign(), &context_options) }.expect("a context");
        let mut renderer = Renderer::new(&context).expect("kernels");
        let error = renderer.reserve(&Reservation::new(10_000_000, 0, 16, 16)).expect_err("refused");
        assert!(error.to_string().contains("maxComputeWorkGroupCount"), "{error}");
    });
}
