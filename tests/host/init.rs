//! The Gaussians that training starts from, and their shapes.

use ashsplat::scene::gaussians::sh_coefficients;
use ashsplat::scene::{Bounds, Gaussians, PointCloud};
use ashsplat_files::init::{mean_squared_neighbour_distances, random_points};
use glam::Vec3;
use proptest::prelude::*;

/// Mean squared distances by brute force: all distances, sorted.
fn brute_force(positions: &[[f32; 3]]) -> Vec<f64> {
    let squared =
        |a: &[f32; 3], b: &[f32; 3]| (0..3).map(|i| (f64::from(a[i]) - f64::from(b[i])).powi(2)).sum::<f64>();
    let mean = |(index, p): (usize, &[f32; 3])| {
        let others = positions.iter().enumerate().filter(|(other, _)| *other != index);
        let mut distances: Vec<f64> = others.map(|(_, q)| squared(p, q)).collect();
        distances.sort_by(f64::total_cmp);
        distances.truncate(3);
        (distances.iter().sum::<f64>() / distances.len().max(1) as f64).max(1e-7)
    };
    positions.iter().enumerate().map(mean).collect()
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(40) })]
    /// A coarse grid makes many coincident points and equal distances.
    #[test]
    fn neighbours_equal_brute_force(grid in prop::collection::vec([-3..3i32, -3..3, -3..3], 0..120), scale in 0.001..100f32) {
        let positions: Vec<[f32; 3]> = grid.iter().map(|p| p.map(|v| v as f32 * scale)).collect();
        let (fast, slow) = (mean_squared_neighbour_distances(&positions).unwrap(), brute_force(&positions));
        for (index, (a, b)) in fast.iter().zip(&slow).enumerate() {
            prop_assert!((a - b).abs() <= 1e-12 * b, "{index}: {a}, expected {b}");
        }
        prop_assert_eq!(fast.len(), slow.len());
    }
}

#[test]
fn many_coincident_points_are_no_trap() {
    let mut positions = vec![[1.0, 2.0, 3.0]; 200_000];
    positions.extend([[0.0; 3], [-0.0; 3], [5.0, 0.0, 0.0]]);
    let start = std::time::Instant::now();
    let dist2 = mean_squared_neighbour_distances(&positions).unwrap();
    assert!(start.elapsed().as_secs() < 20);
    assert_eq!(dist2[0], 1e-7);
    // 0 and -0 coincide: one neighbour at 0, two at √14.
    assert!((dist2[200_000] - 28.0 / 3.0).abs() < 1e-9 && dist2[200_000] == dist2[200_001]);
}

#[test]
fn start_values() {
    let points = PointCloud { positions: vec![[0.0; 3], [2.0, 0.0, 0.0]], colors: vec![[255, 0, 51]; 2] };
    let gaussians = ashsplat_files::initial_gaussians(&points, 2).unwrap();
    gaussians.check_shapes().unwrap();
    assert_eq!(gaussians.means, points.positions);
    assert!(gaussians.log_scales.as_flattened().iter().all(|s| (s.exp() - 2.0).abs() < 1e-6));
    assert!(gaussians.opacity_logits.iter().all(|o| (1.0 / (1.0 + (-o).exp()) - 0.1).abs() < 1e-6));
    let dc = gaussians.sh_of(1)[0];
    assert!((dc[0] - 0.5 / 0.282_094_8).abs() < 1e-5 && (dc[1] + dc[0]).abs() < 1e-6);
    assert!(gaussians.sh_of(1)[1..].iter().all(|c| *c == [0.0; 3]));
    assert!(ashsplat_files::initial_gaussians(&PointCloud::default(), 3).unwrap().is_empty());
    assert!(ashsplat_files::initial_gaussians(&points, 4).is_err());
    let bad = PointCloud { positions: vec![[f32::NAN; 3]], colors: vec![[0; 3]] };
    assert!(ashsplat_files::initial_gaussians(&bad, 0).is_err());
    let bad = PointCloud { positions: vec![[0.0; 3]], colors: vec![] };
    assert!(ashsplat_files::initial_gaussians(&bad, 0).is_err());
}

#[test]
fn shapes_and_degrees() {
    let points = random_points(4, Bounds { min: Vec3::ZERO, max: Vec3::ONE }, 0);
    let mut gaussians = ashsplat_files::initial_gaussians(&points, 3).unwrap();
    gaussians.sh.iter_mut().enumerate().for_each(|(i, c)| *c = [i as f32; 3]);
    for degree in 0..=3 {
        let changed = gaussians.with_sh_degree(degree);
        changed.check_shapes().unwrap();
        assert_eq!(changed.sh_degree, degree);
        for index in 0..4 {
            assert_eq!(changed.sh_of(index), &gaussians.sh_of(index)[..sh_coefficients(degree)]);
        }
        let back = changed.with_sh_degree(3);
        assert_eq!(back.sh_of(2)[..sh_coefficients(degree)], *changed.sh_of(2));
        assert!(back.sh_of(2)[sh_coefficients(degree)..].iter().all(|c| *c == [0.0; 3]));
    }
    for damage in [
        |g: &mut Gaussians| g.quats.truncate(3),
        |g: &mut Gaussians| g.log_scales.push([0.0; 3]),
        |g: &mut Gaussians| g.opacity_logits.clear(),
        |g: &mut Gaussians| g.sh.truncate(63),
        |g: &mut Gaussians| g.sh_degree = 2,
        |g: &mut Gaussians| g.sh_degree = 4,
    ] {
        let mut damaged = gaussians.clone();
        damage(&mut damaged);
        assert!(damaged.check_shapes().is_err());
    }
}
