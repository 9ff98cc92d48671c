//! New parameters for scenes on the device.

use crate::scenes::renderer;
use crate::stage::{assert_same, camera, cloud, guest, options, owned, rendered, with_host};
use ashsplat::scene::Gaussians;
use ashsplat::vk::{Context, ContextOptions, LimitsOverride};
use ashsplat::{DeviceScene, Placed, RecordedFrame, RenderSettings, Renderer, Reservation, Update};

/// Replaces a range of Gaussians.
fn replace(all: &mut Gaussians, first: usize, new: &Gaussians) {
    let end = first + new.len();
    all.means[first..end].copy_from_slice(&new.means);
    all.quats[first..end].copy_from_slice(&new.quats);
    all.log_scales[first..end].copy_from_slice(&new.log_scales);
    all.opacity_logits[first..end].copy_from_slice(&new.opacity_logits);
    let sh = all.sh.len() / all.len();
    all.sh[sh * first..sh * end].copy_from_slice(&new.sh);
}

#[test]
fn updates_replace_a_part_of_a_scene() {
    with_host(&options(), |host| {
        let context = guest(host);
        let (start, new) = (cloud(500, 1), cloud(120, 2));
        let mut expected = start.clone();
        replace(&mut expected, 200, &new);
        let scene = DeviceScene::upload(&context, &start, 0).expect("a scene");
        let mut renderer = renderer(&context, 500, Reservation::update_bytes(500, 1));
        let (settings, camera) = (RenderSettings::default(), camera(0.1, 110, 70));
        let placed = [Placed::from(&scene)];
        let before = RecordedFrame::new(&placed, &camera, &settings);
        let update = [Update { scene: &scene, first: 200, gaussians: &new }];
        assert_same(&rendered(host, &mut renderer, &before), &owned(&start, &camera, &settings), [0.0; 3]);
        let frame = RecordedFrame { updates: &update, ..before };
        let after = owned(&expected, &camera, &settings);
        assert_same(&rendered(host, &mut renderer, &frame), &after, [0.0; 3]);
        assert_same(&rendered(host, &mut renderer, &before), &after, [0.0; 3]);
        assert_eq!(scene.download().expect("Gaussians"), expected);

        // An empty scene.
        let mut empty = DeviceScene::empty(&context, 500, 1).expect("a scene");
        let update = [Update { scene: &empty, first: 0, gaussians: &start }];
        let frame = RecordedFrame { updates: &update, ..before };
        rendered(host, &mut renderer, &frame);
        empty.set_count(500).expect("room");
        let placed = [Placed::from(&empty)];
        let pixels = rendered(host, &mut renderer, &RecordedFrame::new(&placed, &camera, &settings));
        assert_same(&pixels, &owned(&start, &camera, &settings), [0.0; 3]);
        assert!(empty.set_count(501).is_err());
    });
}

/// A cloud with spherical harmonics of some degree.
fn cloud_of_degree(sh_degree: u32, count: usize, seed: u32) -> Gaussians {
    let own = cloud(count, seed);
    let coefficients = (sh_degree as usize + 1).pow(2);
    let value = |i: usize, k: usize| own.sh[4 * i + k % 4].map(|x| x / (1 + k) as f32);
    let sh = (0..count * coefficients).map(|at| value(at / coefficients, at % coefficients)).collect();
    Gaussians { sh_degree, sh, ..own }
}

/// An update replaces exactly its Gaussians, wherever in rows and chunks it begins and ends.
#[test]
fn updates_replace_any_range() {
    const RANGES: [(usize, usize); 12] = [
        (0, 1),
        (7, 2),
        (8, 8),
        (19, 4),
        (30, 33),
        (1000, 24),
        (1020, 9),
        (1023, 1),
        (1024, 16),
        (1199, 1),
        (130, 950),
        (200, 1000),
    ];
    with_host(&options(), |host| {
        for (sh_degree, planes) in [(0, 4), (1, 6), (2, 10), (3, 15)] {
            let lowered = LimitsOverride {
                max_storage_buffer_range: Some(planes * 16 * 1024),
                ..LimitsOverride::default()
            };
            let options = ContextOptions {
                hazard_check: true,
                limits_override: Some(lowered),
                ..ContextOptions::default()
            };
            // SAFETY: as in `guest`.
            let context = unsafe { Context::from_foreign(&host.foreign(), &options) }.expect("a context");
            let mut expected = cloud_of_degree(sh_degree, 1200, 1);
            let scene = DeviceScene::upload(&context, &expected, 0).expect("a scene");
            assert_eq!((scene.plan().chunk_gaussians, scene.plan().chunks), (1024, 2));
            let mut renderer = Renderer::new(&context).expect("kernels");
            let staging_bytes = Reservation::update_bytes(1000, sh_degree);
            let reservation = Reservation { staging_bytes, ..Reservation::new(1200, sh_degree, 16, 16) };
            renderer.reserve(&reservation).expect("memory");
            let (settings, camera) = (RenderSettings::default(), camera(0.1, 16, 16));
            let placed = [(&scene).into()];
            for (number, (first, count)) in RANGES.into_iter().enumerate() {
                let new = cloud_of_degree(sh_degree, count, 10 + number as u32);
                replace(&mut expected, first, &new);
                let updates = [Update { scene: &scene, first: first as u32, gaussians: &new }];
                let frame =
                    RecordedFrame { updates: &updates, ..RecordedFrame::new(&placed, &camera, &settings) };
                rendered(host, &mut renderer, &frame);
                let same = scene.download().expect("Gaussians") == expected;
                assert!(same, "degree {sh_degree}: {count} from {first}");
            }
        }
    });
}

/// The later of two overlapping updates wins.
#[test]
fn overlapping_updates_are_made_in_their_order() {
    with_host(&options(), |host| {
        let context = guest(host);
        let [start, first, second, none] = [cloud(300, 1), cloud(100, 2), cloud(100, 3), cloud(0, 4)];
        let mut expected = start.clone();
        for (new, at) in [(&first, 100), (&second, 150)] {
            replace(&mut expected, at, new);
        }
        let scene = DeviceScene::upload(&context, &start, 0).expect("a scene");
        let mut renderer = renderer(&context, 300, Reservation::update_bytes(400, 1));
        let (settings, camera, clone) = (RenderSettings::default(), camera(0.1, 110, 70), scene.clone());
        let update = |scene, first, gaussians| Update { scene, first, gaussians };
        let updates = [
            update(&scene, 150, &first),
            update(&scene, 100, &first),
            update(&scene, 0, &none),
            // A clone is the same scene.
            update(&clone, 150, &second),
        ];
        let placed = [Placed::from(&scene)];
        let frame = RecordedFrame { updates: &updates, ..RecordedFrame::new(&placed, &camera, &settings) };
        assert_same(&rendered(host, &mut renderer, &frame), &owned(&expected, &camera, &settings), [0.0; 3]);
        assert_eq!(scene.download().expect("Gaussians"), expected);
    });
}
