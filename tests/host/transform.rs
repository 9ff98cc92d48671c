//! Transforms and merges of Gaussians on the host.

use crate::common::splats::scene;
use ashsplat::scene::{Gaussians, Similarity};
use ashsplat_files::decimate::decimate;
use glam::{DQuat, DVec3, EulerRot};

fn similarity() -> Similarity {
    Similarity {
        rotation: DQuat::from_euler(EulerRot::ZYX, 0.4, -1.2, 2.5),
        scale: 2.5,
        translation: DVec3::new(1.0, -20.0, 3.5),
    }
}

fn inverse(similarity: &Similarity) -> Similarity {
    let rotation = similarity.rotation.inverse();
    let scale = 1.0 / similarity.scale;
    Similarity { rotation, scale, translation: -(scale * (rotation * similarity.translation)) }
}

fn largest_difference(a: &Gaussians, b: &Gaussians) -> f32 {
    let pairs = |a: &[[f32; 3]], b: &[[f32; 3]]| {
        a.as_flattened().iter().zip(b.as_flattened()).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
    };
    pairs(&a.means, &b.means).max(pairs(&a.log_scales, &b.log_scales)).max(pairs(&a.sh, &b.sh))
}

#[test]
fn a_move_and_its_inverse_cancel() {
    let before = scene(200, 3);
    let mut after = before.clone();
    after.transform(&similarity());
    assert!(largest_difference(&before, &after) > 1.0);
    after.transform(&inverse(&similarity()));
    assert!(largest_difference(&before, &after) < 2e-5, "{}", largest_difference(&before, &after));
    let both = inverse(&similarity()).after(&similarity());
    assert!(both.translation.length() < 1e-12 && (both.scale - 1.0).abs() < 1e-12);
}

#[test]
fn no_move_keeps_every_bit() {
    let before = scene(50, 2);
    let mut after = before.clone();
    after.transform(&Similarity::default());
    after.mirror([false; 3]);
    assert_eq!(before, after);
    after.mirror([true, false, true]);
    assert_ne!(before, after);
    after.mirror([true, false, true]);
    assert_eq!(before, after);
}

#[test]
fn decimation_reaches_its_target() {
    for (count, target) in [(500, 250), (500, 1), (500, 499), (500, 500), (500, 2000), (3, 1), (0, 5)] {
        let mut gaussians = scene(count, 1);
        decimate(&mut gaussians, target);
        gaussians.check_shapes().unwrap();
        assert_eq!(gaussians.len(), target.min(count));
        assert!(gaussians.means.as_flattened().iter().all(|v| v.is_finite()));
    }
}

/// Merging two halves of one Gaussian gives its moments.
#[test]
fn a_merged_pair_has_the_moments_of_both() {
    let mut pair = Gaussians {
        sh_degree: 0,
        means: vec![[1.0, 2.0, 5.0], [3.0, 2.0, 5.0]],
        quats: vec![[1.0, 0.0, 0.0, 0.0]; 2],
        log_scales: vec![[1f32.ln(), 0.5f32.ln(), 0.25f32.ln()]; 2],
        opacity_logits: vec![0.0; 2],
        sh: vec![[1.0, 0.0, -1.0], [3.0, 0.0, -1.0]],
    };
    decimate(&mut pair, 1);
    assert_eq!((pair.means[0], pair.sh[0]), ([2.0, 2.0, 5.0], [2.0, 0.0, -1.0]));
    let mut variances = pair.log_scales[0].map(|s| (2.0 * s).exp());
    variances.sort_by(f32::total_cmp);
    for (variance, expected) in variances.into_iter().zip([0.0625, 0.25, 2.0]) {
        assert!((variance - expected).abs() < 1e-5, "{variances:?}");
    }
    // Opacity times area equals the sum of both.
    let area = |[a, b, c]: [f32; 3]| a * b + b * c + c * a;
    let after = pair.opacity(0) * area(pair.log_scales[0].map(f32::exp));
    assert!((after - 2.0 * 0.5 * area([1.0, 0.5, 0.25])).abs() < 1e-4);
}

/// Among distant pairs of twins, twins merge with each other.
#[test]
fn the_nearest_alike_are_merged_first() {
    let mut twins = Gaussians::default();
    for index in 0..40 {
        let mut one = scene(1, 0);
        one.means[0] = [10.0 * (index / 2) as f32, 0.01 * (index % 2) as f32, 0.0];
        one.log_scales[0] = [-2.0; 3];
        one.sh[0] = [0.1; 3];
        twins.append(&one);
    }
    decimate(&mut twins, 20);
    let mut places: Vec<i32> = twins.means.iter().map(|mean| mean[0].round() as i32).collect();
    places.sort_unstable();
    assert_eq!(places, (0..20).map(|i| 10 * i).collect::<Vec<_>>());
}
