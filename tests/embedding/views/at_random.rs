//! Views, scenes and what they are drawn with, at random from frame to frame: in one recording as each alone.

use super::{BLACK, SIZE, hard_cloud, into, render_views};
use crate::array_image::ArrayImage;
use crate::host::Host;
use crate::stage::{camera, cloud, guest, options, with_host};
use ashsplat::scene::{CutOut, Gaussians, Inside, Pose, Volume};
use ashsplat::vk::Image;
use ashsplat::{
    Camera, DeviceScene, Placed, RecordedFrame, RenderSettings, Renderer, Reservation, SceneSettings,
};
use glam::{Mat3, Vec3};

/// Views of a recording, at most.
const MOST: u32 = 3;
/// Small scenes.
const SMALL: u32 = 20;

/// Cameras beside each other can share a sort where they draw the same list; small scenes of one buffer come into batches; a large
/// one never does.
fn at_random(host: &Host, frames: u32) {
    let context = guest(host);
    let small: Vec<Gaussians> = (0..SMALL).map(|seed| cloud(12, 20 + seed)).collect();
    let mut scenes = DeviceScene::upload_all(&context, &small.iter().collect::<Vec<_>>()).expect("scenes");
    scenes.push(DeviceScene::upload(&context, &hard_cloud(), 0).expect("a scene"));
    let array = ArrayImage::new(host, SIZE, 2 * MOST);
    let layers: Vec<Image> = (0..2 * MOST).map(|layer| array.adopt(&context, layer)).collect();
    let [mut together, mut alone] = [true, false].map(|shared_sort| {
        let mut renderer = Renderer::new(&context).expect("kernels");
        let wanted = Reservation {
            views: if shared_sort { MOST } else { 1 },
            shared_sort,
            images_only: true,
            scenes: SMALL + 1,
            tint: true,
            cut_outs: SMALL + 1,
            ..Reservation::new(SMALL * 256 + 900, 1, SIZE[0], SIZE[1])
        };
        renderer.reserve(&wanted).expect("memory");
        renderer
    });
    let half = [CutOut {
        volume: Volume::Box { half_size: Vec3::new(0.4, 2.0, 2.0) },
        pose: Pose::IDENTITY,
        inside: Inside::Removed,
    }];
    let mut state = 7u32;
    let mut below = |most: u32| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 16) % most
    };
    let (mut sorts, mut batched) = ([0; MOST as usize + 1], 0);
    for frame in 0..frames {
        let lists: [Vec<Placed>; 2] = [(); 2].map(|()| {
            // Scenes of a batch are alike in these.
            let [tinted, cut, plain] = [(); 3].map(|()| below(2) > 0);
            let mut placed = |scene| {
                let settings = SceneSettings {
                    visible: below(6) > 0,
                    tint: [[1.0; 3], [0.5, 1.0 + 0.1 * below(5) as f32, 1.0]][usize::from(tinted)],
                    opacity: [1.0, [1.0, 0.75, 0.5, 0.0][below(4) as usize]][usize::from(tinted)],
                    sh_degree: [None, Some(0)][usize::from(plain || below(9) == 0)],
                    cut_outs: if cut && below(9) > 0 { &half } else { &[] },
                    ..SceneSettings::default()
                };
                let pose = Pose {
                    world_from_object: Mat3::from_rotation_y(0.3 * below(20) as f32),
                    translation: Vec3::new(0.1 * below(9) as f32 - 0.4, 0.05 * below(9) as f32, 0.0),
                    scale: [1.0, 0.5, 1.25][below(3) as usize],
                };
                Placed { settings, ..Placed::at(scene, pose) }
            };
            scenes.iter().map(&mut placed).collect()
        });
        let base = camera(0.2 * below(30) as f32, SIZE[0], SIZE[1]);
        let cameras: Vec<Camera> = (0..MOST)
            .map(|_| match below(4) {
                0 => camera(0.2 * below(30) as f32, 40, 30),
                _ => base.moved_aside([0.1 * below(9) as f32 - 0.4, 0.0]),
            })
            .collect();
        let settings = [None, Some(0)].map(|sh_degree| RenderSettings { sh_degree, ..Default::default() });
        let own = settings[below(2) as usize];
        let views: Vec<RecordedFrame> = cameras
            .iter()
            .zip(&layers)
            .map(|(camera, layer)| RecordedFrame {
                target: into(layer, BLACK, [0; 2]),
                ..RecordedFrame::new(&lists[usize::from(below(3) == 0)], camera, &own)
            })
            .collect();
        // Those that are left have a recording each: all layers are drawn.
        let (first, others) = views.split_at(1 + below(MOST) as usize);
        others.iter().for_each(|view| drop(render_views(host, &mut together, &[*view])));
        render_views(host, &mut together, first);
        let report = together.slot_report(0).expect("a report").expect("finished");
        assert!(!report.overflow && report.sorts as usize <= first.len(), "frame {frame}: {report:?}");
        sorts[first.len() - report.sorts as usize] += 1;
        batched += report.batched_scenes;
        for (view, layer) in views.iter().zip(&layers[MOST as usize..]) {
            let target = into(layer, BLACK, [0; 2]);
            render_views(host, &mut alone, &[RecordedFrame { target, ..*view }]);
        }
        let texels = array.read(host);
        for (view, camera) in cameras.iter().enumerate() {
            let rows = |layer: usize| {
                let rows = texels[layer].chunks(SIZE[0] as usize).take(camera.height as usize);
                rows.map(|row| row[..camera.width as usize].to_vec()).collect::<Vec<_>>()
            };
            assert!(
                rows(view) == rows(MOST as usize + view),
                "frame {frame}, view {view} of {}",
                views.len()
            );
        }
    }
    assert!(sorts[0] > 0 && sorts[1] > 0 && batched > frames, "{sorts:?} sorts spared, {batched} in batches");
    drop((together, alone, layers));
    array.destroy(host);
}

#[test]
fn views_change_from_frame_to_frame() {
    with_host(&options(), |host| at_random(host, 40));
}

#[test]
#[ignore = "40 of them are enough for each change"]
fn views_change_a_thousand_times() {
    with_host(&options(), |host| at_random(host, 1000));
}
