//! New parameters for scenes on the device.

use crate::scenes::renderer;
use crate::stage::*;

pub fn replace(all: &mut Gaussians, first: usize, new: &Gaussians) {
    let end = first + new.len();
    all.means[first..end].copy_from_slice(&new.means);
    all.quats[first..end].copy_from_slice(&new.quats);
    all.log_scales[first..end].copy_from_slice(&new.log_scales);
    all.opacity_logits[first..end].copy_from_slice(&new.opacity_logits);
    let sh = all.sh.len() / all.len();
    all.sh[sh * first..sh * end].copy_from_slice(&new.sh);
}

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
    // Few Gaussians within a row and across rows, across both chunks, and almost all of them.
    let first = [0, 7, 8, 19, 30, 744, 764, 767, 768, 1199, 130, 200];
    let counts = [1, 2, 8, 4, 33, 24, 9, 1, 16, 1, 950, 1000];
    with_host(&options(), |host| {
        for (sh_degree, planes) in [(0, 4), (1, 6), (2, 10), (3, 15)] {
            let options = ContextOptions { hazard_check: true, ..small_bindings(planes * 16 * 1024) };
            let context = guest_of(&host.foreign(), &options);
            let mut expected = cloud_of_degree(sh_degree, 1200, 1);
            let scene = uploaded(&context, &expected);
            assert_eq!((scene.plan().chunk_gaussians, scene.plan().chunks), (768, 2));
            let staging_bytes = Reservation::update_bytes(1000, sh_degree);
            let reservation = Reservation { staging_bytes, ..Reservation::new(1200, sh_degree, 16, 16) };
            let mut renderer = reserved(&context, &reservation);
            let camera = camera(0.1, 16, 16);
            let placed = [(&scene).into()];
            for (number, (first, count)) in first.into_iter().zip(counts).enumerate() {
                let new = cloud_of_degree(sh_degree, count, 10 + number as u32);
                replace(&mut expected, first, &new);
                let updates = [Update { scene: &scene, first: first as u32, gaussians: &new }];
                let frame = RecordedFrame { updates: &updates, ..frame_of(&placed, &camera) };
                rendered(host, &mut renderer, &frame);
                let same = scene.download().expect("Gaussians") == expected;
                assert!(same, "degree {sh_degree}: {count} from {first}");
            }
        }
    });
}

/// Nearest value with the 11 binary digits of a half.
fn nearest_half(value: f32) -> f32 {
    let step = (value.abs().log2().floor().max(-14.0) - 10.0).exp2();
    (value / step).round_ties_even() * step
}

type Rounding = fn(&Gaussians) -> Vec<[f32; 3]>;

fn nearest_halves(gaussians: &Gaussians) -> Vec<[f32; 3]> {
    gaussians.sh.iter().map(|c| c.map(nearest_half)).collect()
}

/// The coefficients in steps of the largest / 127, those of degree 0 as they are.
fn nearest_bytes(gaussians: &Gaussians) -> Vec<[f32; 3]> {
    let own = (gaussians.sh_degree as usize + 1).pow(2);
    let rounded = |own: &[[f32; 3]]| {
        let step = own[1..].as_flattened().iter().fold(0f32, |max, value| max.max(value.abs())) / 127.0;
        let higher = own[1..].iter().map(|c| c.map(|value| (value / step).round() * step));
        std::iter::once(own[0]).chain(higher).collect::<Vec<_>>()
    };
    gaussians.sh.chunks(own).flat_map(rounded).collect()
}

/// SH of SPZ files, multiples of 1/128 of either sign, keep their bits in bytes; others do not.
#[test]
fn sh_of_spz_files_are_exact_in_bytes() {
    with_guest(|_, context| {
        let mut exact = cloud_of_degree(3, 300, 1);
        exact
            .sh
            .iter_mut()
            .flatten()
            .for_each(|value| *value = ((*value * 128.0).round() / 128.0).clamp(-1.0, 1.0));
        let mut mirrored = exact.clone();
        // Mirroring makes 1 of -1, and a Gaussian with both is not exact.
        exact.sh[5][0] = -1.0;
        mirrored.sh[5][0] = 1.0;
        for scene in [&exact, &mirrored] {
            assert_eq!(ShStorage::lossless(scene), ShStorage::Bytes);
            let stored = DeviceScene::upload_stored(&context, scene, 0, ShStorage::Bytes).expect("a scene");
            assert_eq!(&stored.download().expect("Gaussians"), scene);
        }
        mirrored.sh[6][0] = -1.0;
        assert_eq!(ShStorage::lossless(&mirrored), ShStorage::Half);
        exact.sh[4][0] = 0.3;
        assert_eq!(ShStorage::lossless(&exact), ShStorage::F32);
        assert_eq!(ShStorage::lossless(&cloud_of_degree(0, 9, 1)), ShStorage::F32);
    });
}

/// SH coefficients in halves and bytes: a scene of floats with the same values is drawn alike, to the bit, at every degree, also after
/// updates.
#[test]
fn stored_scenes_are_drawn_as_their_rounded_values() {
    let of_halves = [(0, 4), (1, 5), (2, 7), (3, 9)]
        .map(|of| (ShStorage::Half, "half_sh", nearest_halves as Rounding, of));
    let of_bytes = [(0, 4), (1, 5), (2, 6), (3, 7)]
        .map(|of| (ShStorage::Bytes, "byte_sh", nearest_bytes as Rounding, of));
    with_host(&options(), |host| {
        for (stored, field, rounded_sh, (sh_degree, planes)) in of_halves.into_iter().chain(of_bytes) {
            let options = ContextOptions { hazard_check: true, ..small_bindings(planes * 16 * 1024) };
            let context = guest_of(&host.foreign(), &options);
            let mut start = cloud_of_degree(sh_degree, 1200, 1);
            // Subnormal and largest halves.
            start.sh[7] = [3e-6, -1e-8, 65504.0];
            let scene = DeviceScene::upload_stored(&context, &start, 0, stored).expect("a scene");
            assert_eq!((scene.plan().planes, scene.plan().chunks), (planes as u32, 2));
            let new = cloud_of_degree(sh_degree, 33, 2);
            let camera = camera(0.1, 60, 40);
            let mut reservation = Reservation {
                staging_bytes: Reservation::update_bytes(33, sh_degree),
                ..Reservation::new(1200, sh_degree, 60, 40)
            };
            let placed = [Placed::from(&scene)];
            let mut lacking = reserved(&context, &reservation);
            assert_argument(
                &refused(host, &mut lacking, &frame_of(&placed, &camera)),
                &format!("{field}: not reserved"),
            );
            match stored {
                ShStorage::Bytes => reservation.byte_sh = true,
                _ => reservation.half_sh = true,
            }
            let mut renderer = reserved(&context, &reservation);
            let mut expected = start.clone();
            for first in [1010, 3] {
                replace(&mut expected, first as usize, &new);
                let rounded = Gaussians { sh: rounded_sh(&expected), ..expected.clone() };
                let updates = [Update { scene: &scene, first, gaussians: &new }];
                let frame = RecordedFrame { updates: &updates, ..frame_of(&placed, &camera) };
                assert_drawn(host, &mut renderer, &frame, &rounded);
                let lower = RenderSettings { sh_degree: Some(sh_degree.saturating_sub(1)), ..*SETTINGS };
                assert_drawn(host, &mut renderer, &RecordedFrame { settings: &lower, ..frame }, &rounded);
                assert_eq!(scene.download().expect("Gaussians"), rounded);
            }
            let mask =
                &context.allocate("selection", &[("mask", 256)], MemoryKind::Device).expect("memory")[0];
            context.upload(mask, &[0x55; 256]).expect("a mask");
            let selection = Selection { mask, color: [1.0, 0.5, 0.0], share: 0.5 };
            let selected = |own: &mut Renderer| own.render_selected(&camera, &SETTINGS, selection);
            let floats = uploaded(&context, &scene.download().expect("Gaussians"));
            let [stored_colors, float_colors] =
                [&scene, &floats].map(|own| renderer.with_scene(own, selected).expect("a frame").color);
            assert_eq!(stored_colors, float_colors);
            let differentiate =
                |own: &mut Renderer| own.gradients(&camera, &SETTINGS, &[[0.0; 3]; 60 * 40], None).map(drop);
            assert_error(renderer.with_scene(&scene, differentiate), "its SH are not floats");
            // Rounding hardly changes the picture: 70 and 50 dB. The update has replaced the largest value.
            let [halves, floats] =
                [&scene.download().expect("Gaussians"), &expected].map(|own| owned(own, &camera, &SETTINGS));
            let squares = halves
                .color
                .as_flattened()
                .iter()
                .zip(floats.color.as_flattened())
                .map(|(a, b)| f64::from(a - b).powi(2));
            let mean = squares.sum::<f64>() / (4 * 60 * 40) as f64;
            let max = if stored == ShStorage::Half { 1e-7 } else { 1e-5 };
            assert!(mean < max, "{stored:?}, degree {sh_degree}: {mean:e}");
        }
    });
}

/// The later of two overlapping updates wins.
#[test]
fn overlapping_updates_are_made_in_their_order() {
    with_guest(|host, context| {
        let [start, first, second, none] = [cloud(300, 1), cloud(100, 2), cloud(100, 3), cloud(0, 4)];
        let mut expected = start.clone();
        for (new, at) in [(&first, 100), (&second, 150)] {
            replace(&mut expected, at, new);
        }
        let scene = uploaded(&context, &start);
        let mut renderer = renderer(&context, 300, Reservation::update_bytes(400, 1));
        let (camera, clone) = (camera(0.1, 110, 70), scene.clone());
        let update = |scene, first, gaussians| Update { scene, first, gaussians };
        let updates = [
            update(&scene, 150, &first),
            update(&scene, 100, &first),
            update(&scene, 0, &none),
            // A clone is the same scene.
            update(&clone, 150, &second),
        ];
        let placed = [Placed::from(&scene)];
        let frame = RecordedFrame { updates: &updates, ..frame_of(&placed, &camera) };
        assert_drawn(host, &mut renderer, &frame, &expected);
        assert_eq!(scene.download().expect("Gaussians"), expected);
    });
}
