//! Golden vectors of the host's computations: the initial Gaussians, and the scene extent.

// In a test, an unwrap is an assertion.
#![allow(clippy::unwrap_used)]

use std::path::Path;

use ashsplat::scene::{PointCloud, scene_extent};
use ashsplat_files::init::mean_squared_neighbour_distances;
use glam::Vec3;
use libtest_mimic::Trial;

use crate::golden::npz::Npz;

/// One trial per set with these fields.
pub fn trials(shared: &Path) -> Vec<Trial> {
    let mut sets = crate::golden::sets(shared);
    sets.retain(|set| Npz::names(&set.path).iter().any(|name| name == "dist2"));
    assert!(!sets.is_empty(), "no set has what the host computes");
    sets.into_iter()
        .map(|set| {
            Trial::test(format!("golden_{}_host", set.name), move || {
                check(&Npz::read(&set.path));
                Ok(())
            })
        })
        .collect()
}

fn check(set: &Npz) {
    let positions: Vec<[f32; 3]> =
        set.rows("xyz").into_iter().map(|p: [f64; 3]| p.map(|v| v as f32)).collect();
    let dist2 = mean_squared_neighbour_distances(&positions).unwrap();
    assert_close("dist2", dist2.iter().copied(), set.values("dist2"), 1e-6);

    // A point cloud's colours have 8 bits, so the set's colours are stored in the coefficients afterwards.
    let colors = vec![[0; 3]; positions.len()];
    let gaussians =
        ashsplat_files::initial_gaussians(&PointCloud { positions: positions.clone(), colors }, 3).unwrap();
    gaussians.check_shapes().unwrap();
    assert_eq!(gaussians.means, positions);
    assert!(gaussians.quats.iter().all(|&q| q == [1.0, 0.0, 0.0, 0.0]));
    let flat = |values: &[[f32; 3]]| values.as_flattened().iter().map(|&v| f64::from(v)).collect::<Vec<_>>();
    assert_close("log_scales", flat(&gaussians.log_scales).into_iter(), set.values("log_scales"), 2e-6);
    let logits = gaussians.opacity_logits.iter().map(|&v| f64::from(v));
    assert_close("opacity_logits", logits, set.values("opacity_logits"), 1e-6);
    let mut sh = gaussians.sh;
    for (index, rgb) in set.rows::<3>("rgb").into_iter().enumerate() {
        sh[16 * index] = rgb.map(|c| ashsplat::scene::sh::rgb_to_sh_dc(c as f32));
    }
    assert_close("sh", flat(&sh).into_iter(), set.values("sh"), 1e-6);

    let centers = set.rows::<3>("cam_centers");
    let extent = scene_extent(centers.iter().map(|c| Vec3::from_array(c.map(|v| v as f32))));
    assert_close("scene_extent", [f64::from(extent)].into_iter(), set.values("scene_extent"), 1e-6);
}

/// Elementwise: the error is at most `tolerance`, relative above 1 and absolute below.
fn assert_close(name: &str, computed: impl ExactSizeIterator<Item = f64>, expected: &[f64], tolerance: f64) {
    assert_eq!(computed.len(), expected.len(), "{name}");
    for (index, (a, b)) in computed.zip(expected).enumerate() {
        assert!((a - b).abs() <= tolerance * b.abs().max(1.0), "{name}[{index}]: {a}, expected {b}");
    }
}
