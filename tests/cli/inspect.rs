//! `inspect` on a small example worked out by hand.

use super::*;
use ashsplat::RenderSettings;
use ashsplat::scene::sh;
use glam::{DMat2, DMat3, DQuat, DVec2, DVec3, Mat3};

const MEANS: [[f32; 3]; 3] = [[0.1, 0.1, 2.5], [0.12, 0.08, 3.2], [0.08, 0.14, 1.8]];
const SCALES: [[f32; 3]; 3] = [[0.2, 0.08, 0.1], [0.3, 0.15, 0.1], [0.15, 0.15, 0.15]];
const QUATS: [[f32; 4]; 3] = [[1.0, 0.2, 0.0, 0.1], [0.9, 0.0, 0.3, 0.0], [1.0, 0.0, 0.0, 0.0]];
const OPACITIES: [f32; 3] = [0.9, 0.85, 0.95];
const COLORS: [[f32; 3]; 3] = [[1.0, 0.6, 0.1], [0.0, 0.9, 1.0], [1.0, 0.2, 0.8]];
const FOCAL: f64 = 500.0;
const MIDDLE: f64 = 400.0;
const PIXEL: [u32; 2] = [420, 420];
/// Order by depth, front to back: 1.8, 2.5, 3.2.
const ORDER: [usize; 3] = [2, 0, 1];

fn example() -> Gaussians {
    Gaussians {
        sh_degree: 0,
        means: MEANS.to_vec(),
        quats: QUATS.to_vec(),
        log_scales: SCALES.iter().map(|s| s.map(f32::ln)).collect(),
        opacity_logits: OPACITIES.iter().map(|o| (o / (1.0 - o)).ln()).collect(),
        sh: COLORS.iter().map(|c| c.map(sh::rgb_to_sh_dc)).collect(),
    }
}

/// Alpha of one Gaussian at the pixel, in f64, directly from the equations of EWA splatting.
fn alpha(index: usize) -> f64 {
    let mean = DVec3::from_array(MEANS[index].map(f64::from));
    let [w, x, y, z] = QUATS[index].map(f64::from);
    let rotation = DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize());
    let axes = rotation * DMat3::from_diagonal(DVec3::from_array(SCALES[index].map(f64::from)));
    let covariance = axes * axes.transpose();
    // Rows of the projection's Jacobian; the camera is at the origin.
    let jx = DVec3::new(FOCAL / mean.z, 0.0, -FOCAL * mean.x / (mean.z * mean.z));
    let jy = DVec3::new(0.0, FOCAL / mean.z, -FOCAL * mean.y / (mean.z * mean.z));
    let off = jx.dot(covariance * jy);
    let dilation = 0.3;
    let xx = jx.dot(covariance * jx) + dilation;
    let yy = jy.dot(covariance * jy) + dilation;
    let conic = DMat2::from_cols_array(&[xx, off, off, yy]).inverse();
    let center = DVec2::new(FOCAL * mean.x / mean.z, FOCAL * mean.y / mean.z) + MIDDLE - 0.5;
    let d = center - DVec2::new(f64::from(PIXEL[0]), f64::from(PIXEL[1]));
    (f64::from(OPACITIES[index]) * (-0.5 * d.dot(conic * d)).exp()).min(0.99)
}

#[test]
fn worked_example() {
    let place = Place::empty();
    place.write_scene("example.ply", &example());
    let inspect = "inspect @example.ply --fx 500 --width 800 --height 800 --pixel";
    let report = place.json_of(format!("{inspect} 420,420 --json"));
    let samples = report["samples"].as_array().expect("samples");
    assert_eq!(samples.len(), 3);
    let (mut left, mut color) = (1.0, DVec3::ZERO);
    for (sample, index) in samples.iter().zip(ORDER) {
        let alpha = alpha(index);
        let weight = alpha * left;
        left *= 1.0 - alpha;
        color += weight * DVec3::from_array(COLORS[index].map(f64::from));
        assert_eq!(sample["id"], index);
        let depth = f64::from(MEANS[index][2]);
        let expected = [("depth", depth), ("alpha", alpha), ("weight", weight), ("transmittance_left", left)];
        for (name, expected) in expected {
            let value = sample[name].as_f64().expect("a number");
            assert!((value - expected).abs() < 1e-5, "{name} {value} of {index}, not {expected}");
        }
    }
    let reported: [f64; 3] = serde_json::from_value(report["color"].clone()).expect("a colour");
    let reported = DVec3::from_array(reported);
    assert!(reported.abs_diff_eq(color, 1e-5), "{reported} instead of {color}");
    // The report matches the picture: same pixel, same colour.
    let [focal, middle] = [FOCAL, MIDDLE].map(|value| value as f32);
    let size = Intrinsics::from_fov_x(0.8, 800, 800);
    let intrinsics = Intrinsics { fx: focal, fy: focal, cx: middle, cy: middle, ..size };
    let camera = Camera::with_pose(Mat3::IDENTITY, Vec3::ZERO, intrinsics);
    let mut renderer = crate::common::engine::renderer();
    renderer.upload(&example()).expect("uploaded");
    let frame = renderer.render(&camera, &RenderSettings::default()).expect("a frame");
    let drawn = Vec3::from_array(frame.color[(PIXEL[1] * 800 + PIXEL[0]) as usize]);
    assert!(drawn.as_dvec3().abs_diff_eq(reported, 1e-6), "{drawn}");

    let table = place.run(format!("{inspect} 420,420")).ok().stdout;
    let rows: Vec<&str> = table.lines().collect();
    assert_eq!(rows.len(), 5, "{table}");
    for (row, depth) in rows[1..4].iter().zip(["1.8000", "2.5000", "3.2000"]) {
        assert_has(row, &[depth]);
    }
    assert!(rows[4].starts_with("final colour "), "{table}");
    place.run(format!("{inspect} 800,0")).refused(&["800,0", "800x800"]);
}
