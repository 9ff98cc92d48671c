//! `inspect` on a small example worked out by hand, through the library and through the program.

use super::*;
use ashsplat::scene::{Gaussians, sh};
use ashsplat::vk::{Context, ContextOptions};
use ashsplat::{RenderSettings, Renderer};
use glam::{DMat2, DMat3, DQuat, DVec2, DVec3, Mat3};
use tempfile::tempdir;

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
fn worked_example_by_the_library() {
    let context = Context::new(&ContextOptions::default()).expect("a device");
    let mut renderer = Renderer::new(&context).expect("a renderer");
    renderer.upload(&example()).expect("uploaded");
    let intrinsics = Intrinsics {
        fx: FOCAL as f32,
        fy: FOCAL as f32,
        cx: MIDDLE as f32,
        cy: MIDDLE as f32,
        width: 800,
        height: 800,
    };
    let camera = Camera::with_pose(Mat3::IDENTITY, Vec3::ZERO, intrinsics);
    let settings = RenderSettings::default();
    let report = renderer.inspect(&camera, &settings, PIXEL).expect("a report");
    let ids: Vec<usize> = report.samples.iter().map(|s| s.gaussian as usize).collect();
    assert_eq!(ids, ORDER);
    let mut left = 1.0;
    let mut color = DVec3::ZERO;
    for (sample, index) in report.samples.iter().zip(ORDER) {
        let alpha = alpha(index);
        assert!(
            (f64::from(sample.alpha) - alpha).abs() < 1e-5,
            "alpha {} of {index}, not {alpha}",
            sample.alpha
        );
        assert!((f64::from(sample.weight) - alpha * left).abs() < 1e-5, "weight of {index}");
        assert_eq!(sample.depth, MEANS[index][2]);
        color += alpha * left * DVec3::from_array(COLORS[index].map(f64::from));
        left *= 1.0 - alpha;
        assert!((f64::from(sample.transmittance_after) - left).abs() < 1e-5, "transmittance after {index}");
    }
    let reported = DVec3::from_array(report.color.map(f64::from));
    assert!(reported.abs_diff_eq(color, 1e-5), "{reported} instead of {color}");
    // The report matches the picture: same pixel, same colour.
    let frame = renderer.render(&camera, &settings).expect("a frame");
    let drawn = frame.color[(PIXEL[1] * 800 + PIXEL[0]) as usize];
    assert!(Vec3::from_array(drawn).abs_diff_eq(Vec3::from_array(report.color), 1e-6), "{drawn:?}");
}

#[test]
fn worked_example_by_the_program() {
    let folder = tempdir().expect("a temporary folder");
    let path = folder.path().join("example.ply");
    ashsplat_files::ply::write(&path, &example()).expect("written");
    let camera = ["--fx", "500", "--width", "800", "--height", "800"];
    let command = [["inspect", text(&path), "--pixel", "420,420"].as_slice(), &camera].concat();
    let report: serde_json::Value =
        serde_json::from_str(&succeed(&[command.as_slice(), &["--json"]].concat())).expect("JSON");
    let samples = report["samples"].as_array().expect("samples");
    assert_eq!(samples.len(), 3);
    let mut left = 1.0;
    for (sample, index) in samples.iter().zip(ORDER) {
        assert_eq!(sample["id"].as_u64(), Some(index as u64));
        let weight = sample["weight"].as_f64().expect("a weight");
        assert!((weight - alpha(index) * left).abs() < 1e-5, "weight {weight} of {index}");
        left *= 1.0 - alpha(index);
    }
    let table = succeed(&command);
    let rows: Vec<&str> = table.lines().collect();
    assert_eq!(rows.len(), 5, "{table}");
    assert!(
        rows[1].contains("1.8000") && rows[2].contains("2.5000") && rows[3].contains("3.2000"),
        "{table}"
    );
    assert!(rows[4].starts_with("final colour "), "{table}");
    let outside = [["inspect", text(&path), "--pixel", "800,0"].as_slice(), &camera].concat();
    refuse(&outside, &["800,0", "800x800"]);
}
