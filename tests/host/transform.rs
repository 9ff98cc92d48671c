//! Transforms and merges of Gaussians on the host.

use crate::common::splats::scene;
use ashsplat::scene::Gaussians;
use ashsplat_files::decimate::decimate;

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
