//! Many scenes in one frame: batches draw them by few dispatches, with the bits of single scenes.

use crate::array_image::ArrayImage;
use crate::cost::record_allocations;
use crate::scenes::planes;
use crate::stage::*;
use ashsplat::frame::LaunchSizes;

/// Gaussian counts of many sizes: none, a part of a block, a block, several blocks. One scene has more than a batch
/// takes.
fn clouds() -> Vec<Gaussians> {
    let counts = [8, 0, 256, 300, 17, 1, 640, 8, 40];
    let cloud = |number: usize| {
        let count = if number == 96 { 5000 } else { counts[number % counts.len()] };
        let cloud = cloud(count, number as u32);
        if number % 5 == 3 { cloud.with_sh_degree(0) } else { cloud }
    };
    (0..99).map(cloud).collect()
}

/// Uploads scenes to few buffers, and again each to its own buffer.
fn each_way(context: &Context, clouds: &[Gaussians]) -> [Vec<DeviceScene>; 2] {
    let together = DeviceScene::upload_all(context, &clouds.iter().collect::<Vec<_>>()).expect("scenes");
    let apart = clouds.iter().map(|cloud| uploaded(context, cloud));
    [together, apart.collect()]
}

fn pose(number: usize) -> Pose {
    let turn = number as f32;
    Pose {
        world_from_object: Mat3::from_quat(Quat::from_euler(
            glam::EulerRot::XYZ,
            turn,
            2.0 * turn,
            3.0 * turn,
        )),
        translation: Vec3::new(turn.sin(), turn.cos(), (2.0 * turn).sin()) * 0.5,
        scale: 0.25 + 0.125 * (number % 5) as f32,
    }
}

/// Poses, scales, tints, degrees, cut-outs, a selection, hidden scenes, and some scenes from a separate buffer among
/// the others.
#[test]
fn batches_have_the_bits_of_single_scenes() {
    with_guest(|host, context| {
        let clouds = clouds();
        let [together, apart] = each_way(&context, &clouds);
        let gaussians: usize = clouds.iter().map(Gaussians::len).sum();
        let wanted = Reservation {
            scenes: clouds.len() as u32,
            tint: true,
            cut_outs: 64,
            selection: true,
            filter_3d: true,
            distance_order: true,
            orthographic: true,
            ..Reservation::new(gaussians as u32, 1, 110, 70)
        };
        let mut renderer = reserved(&context, &wanted);
        let volume = Volume::Ellipsoid { radii: Vec3::splat(0.5) };
        let cut_outs = [CutOut { volume, pose: Pose::IDENTITY, inside: Inside::Removed }; 2];
        let mask = mask_of(&context, &[0x55; 1024]);
        let selection = Some(Selection { mask: &mask, color: [1.0, 0.5, 0.0], share: 0.5 });
        let settings = |number: usize| match number % 11 {
            2 | 3 => SceneSettings { tint: [1.0, 0.5, 0.25], opacity: 0.75, ..SceneSettings::default() },
            4 => SceneSettings { cut_outs: &cut_outs[..1 + number % 2], ..SceneSettings::default() },
            5 => SceneSettings { visible: false, ..SceneSettings::default() },
            6 => SceneSettings { sh_degree: Some(0), ..SceneSettings::default() },
            7 => SceneSettings { selection, ..SceneSettings::default() },
            _ => SceneSettings::default(),
        };
        let mut orthographic = camera(0.3, 110, 70);
        orthographic.projection = ashsplat::scene::Projection::Orthographic;
        (orthographic.fx, orthographic.fy) = (20.0, 20.0);
        let (usual, extent) = (RenderSettings::default(), ashsplat::Extent::Reference);
        let frames = [
            (camera(0.3, 110, 70), usual),
            (camera(2.0, 110, 70), RenderSettings { filter_3d: true, ..usual }),
            (camera(1.2, 110, 70), RenderSettings { extent, antialias: true, ..usual }),
            (camera(0.3, 110, 70), RenderSettings { distance_order: true, ..usual }),
            (orthographic, RenderSettings { distance_order: true, ..usual }),
        ];
        for (camera, own) in &frames {
            let mut pictures = Vec::new();
            for (is_apart, scenes) in [(false, &together), (true, &apart)] {
                let placed = (0..clouds.len()).map(|number| {
                    // Every seventh scene comes from the other upload.
                    let scene = if number % 7 == 6 { &apart[number] } else { &scenes[number] };
                    Placed { settings: settings(number), ..Placed::at(scene, pose(number)) }
                });
                let placed: Vec<Placed> = placed.collect();
                pictures.push(rendered(host, &mut renderer, &RecordedFrame::new(&placed, camera, own)));
                let report = report_of(&mut renderer, 0);
                assert!(report.visible > 1000 && !report.overflow, "{report:?}");
                // Three batches: 25 scenes, 15 of SH degree 0, 10 with a tint; fewer where culling blocks are small. The
                // others are in separate buffers, hidden, selected, too large, or too few.
                let block = LaunchSizes::new(context.limits()).elementwise_workgroup;
                let batched = if block == 256 { 50 } else { 49 };
                assert_eq!(report.batched_scenes, if is_apart { 0 } else { batched }, "blocks of {block}");
            }
            assert!(pictures[0] == pictures[1], "{camera:?}");
            assert!(pictures[0].iter().any(|pixel| pixel[3] < 0.5));
        }
    });
}

/// Instances of one scene share a buffer anyway. Tests eyes with one sort and with two, also without push
/// descriptors.
#[test]
fn batches_of_instances_are_seen_by_several_views() {
    with_each_guest(|host, context| {
        let cloud = cloud(70, 4);
        let scene = uploaded(&context, &cloud);
        let apart: Vec<_> = (0..12).map(|_| uploaded(&context, &cloud)).collect();
        let left = camera(0.3, 48, 40).moved_aside([-1.0, 0.0]);
        let eyes = [left, left.moved_aside([2.0, 0.1])];
        let array = ArrayImage::new(host, &context, [48, 40], 2);
        let mut pictures = Vec::new();
        for (shared_sort, is_apart) in [(false, true), (false, false), (true, false), (true, true)] {
            let own = Reservation::new(12 * 70, 1, 48, 40);
            let wanted = Reservation { scenes: 12, views: 2, images_only: true, shared_sort, ..own };
            let mut renderer = reserved(&context, &wanted);
            let place =
                |number: usize| Placed::at(if is_apart { &apart[number] } else { &scene }, pose(number));
            let placed: Vec<Placed> = (0..12).map(place).collect();
            let frames = array.frames(&placed, &eyes);
            render_views(host, &mut renderer, &frames);
            let report = report_of(&mut renderer, 0);
            assert_eq!(report.batched_scenes, if is_apart { 0 } else { 24 });
            assert_eq!(report.sorts, if shared_sort { 1 } else { 2 });
            assert!(report.visible > 500, "{report:?}");
            pictures.push(array.read());
        }
        assert!(pictures.iter().all(|picture| *picture == pictures[0]) && pictures[0][0] != pictures[0][1]);
    });
}

/// A host's scenes are batched as ranges of one adopted buffer. Adopted one by one, they are drawn alone and look
/// the same.
#[test]
fn batches_of_a_hosts_buffer_are_of_one_adoption() {
    with_guest(|host, context| {
        let clouds: Vec<_> = (0..12).map(|number| cloud(20, number)).collect();
        let plan = DeviceScene::plan_for(&context, 20, 1, ShStorage::F32).expect("a plan");
        let stride = plan.chunk_bytes().next_multiple_of(256);
        let own = Staging::new(host, 12 * stride);
        // SAFETY: the buffer is the host's, of this size, and outlives the scenes. Uses of overlapping ranges are apart in time.
        let adopt = |offset, bytes| unsafe { Buffer::adopt(&context, "scenes", own.raw, offset, bytes) };
        let whole = adopt(0, 12 * stride).expect("adopted");
        let scenes = [true, false].map(|together| {
            let scene = |(number, cloud): (u64, &Gaussians)| {
                let at = number * stride;
                let chunk = match together {
                    true => whole.range(at, stride),
                    false => adopt(at, stride).expect("adopted"),
                };
                context.upload(&chunk, &planes(cloud, plan.chunk_gaussians as usize)).expect("uploaded");
                DeviceScene::from_buffers(&context, plan, vec![chunk], 20).expect("a scene")
            };
            (0..).zip(&clouds).map(scene).collect::<Vec<_>>()
        });
        let wanted = Reservation { scenes: 12, ..Reservation::new(12 * 20, 1, 64, 48) };
        let mut renderer = reserved(&context, &wanted);
        let camera = camera(0.3, 64, 48);
        let pictures = [0, 1].map(|which| {
            let placed = scenes[which].iter().enumerate();
            let placed: Vec<Placed> = placed.map(|(number, scene)| Placed::at(scene, pose(number))).collect();
            let pixels = rendered(host, &mut renderer, &frame_of(&placed, &camera));
            let report = report_of(&mut renderer, 0);
            assert!(report.visible > 100, "{report:?}");
            assert_eq!(report.batched_scenes, [12, 0][which]);
            pixels
        });
        assert!(pictures[0] == pictures[1]);
        drop((renderer, scenes, whole));
    });
}

#[test]
fn batches_take_nothing_from_the_heap() {
    with_host(&HostOptions::default(), |host| {
        for together in [true, false] {
            assert_eq!(record_allocations(host, together), 0);
        }
    });
}

#[test]
fn batches_fit_what_can_be_bound() {
    with_host(&options(), |host| {
        let context = guest_of_small_bindings(host);
        // One scene has two chunks.
        let clouds: Vec<_> =
            (0..20).map(|number| cloud(if number == 3 { 600 } else { 20 }, number)).collect();
        let [together, apart] = each_way(&context, &clouds);
        let wanted = Reservation { scenes: 20, ..Reservation::new(980, 1, 64, 48) };
        let mut renderer = reserved(&context, &wanted);
        let camera = camera(0.3, 64, 48);
        let pictures = [&together, &apart].map(|scenes| {
            let placed = scenes.iter().enumerate().map(|(number, scene)| Placed::at(scene, pose(number)));
            let placed: Vec<Placed> = placed.collect();
            rendered(host, &mut renderer, &frame_of(&placed, &camera))
        });
        assert!(pictures[0] == pictures[1]);
        for (scene, cloud) in together.iter().zip(&clouds) {
            assert!(scene.download().expect("Gaussians") == *cloud);
        }
        assert!(DeviceScene::upload_all(&context, &[]).expect("none").is_empty());
        let wrong = Gaussians { quats: Vec::new(), ..clouds[0].clone() };
        assert!(DeviceScene::upload_all(&context, &[&clouds[0], &wrong]).is_err());
    });
}
