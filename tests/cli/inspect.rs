//! `inspect`: the Gaussians of a pixel make its colour.

use super::*;
use ashsplat::RenderSettings;
use ashsplat::scene::sh;
use glam::{DVec3, Mat3};

const MEANS: [[f32; 3]; 3] = [[0.1, 0.1, 2.5], [0.12, 0.08, 3.2], [0.08, 0.14, 1.8]];
const SCALES: [[f32; 3]; 3] = [[0.2, 0.08, 0.1], [0.3, 0.15, 0.1], [0.15, 0.15, 0.15]];
const QUATS: [[f32; 4]; 3] = [[1.0, 0.2, 0.0, 0.1], [0.9, 0.0, 0.3, 0.0], [1.0, 0.0, 0.0, 0.0]];
const OPACITIES: [f32; 3] = [0.9, 0.85, 0.95];
const COLORS: [[f32; 3]; 3] = [[1.0, 0.6, 0.1], [0.0, 0.9, 1.0], [1.0, 0.2, 0.8]];
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

#[test]
fn the_gaussians_of_a_pixel_make_its_colour() {
    let place = TestFolder::empty();
    place.write_scene("example.ply", &example());
    let size = Intrinsics::from_fov_x(0.8, 800, 800);
    let intrinsics = Intrinsics { fx: 500.0, fy: 500.0, cx: 400.0, cy: 400.0, ..size };
    let camera = Camera::with_pose(Mat3::IDENTITY, Vec3::ZERO, intrinsics);
    ashsplat_files::cameras_json::write(place.at("one.json"), [("a", &camera)], &Default::default())
        .expect("written");
    place.run("inspect @example.ply --pixel 1,1").refused(&["-s DATASET", "--path"]);
    let inspect = "inspect @example.ply --path @one.json --pixel";
    let report = place.json_of(format!("{inspect} 420,420 --json"));
    let samples = report["samples"].as_array().expect("samples");
    assert_eq!(samples.len(), 3);
    let (mut left, mut color) = (1.0, DVec3::ZERO);
    for (sample, index) in samples.iter().zip(ORDER) {
        let number = |name: &str| sample[name].as_f64().expect("a number");
        let alpha = number("alpha");
        let weight = alpha * left;
        left *= 1.0 - alpha;
        color += weight * DVec3::from_array(COLORS[index].map(f64::from));
        assert_eq!(sample["id"], index);
        let depth = f64::from(MEANS[index][2]);
        for (name, expected) in [("depth", depth), ("weight", weight), ("transmittance_left", left)] {
            let value = number(name);
            assert!((value - expected).abs() < 1e-5, "{name} {value} of {index}, not {expected}");
        }
    }
    let reported: [f64; 3] = serde_json::from_value(report["color"].clone()).expect("a colour");
    let reported = DVec3::from_array(reported);
    assert!(reported.abs_diff_eq(color, 1e-5), "{reported} instead of {color}");
    // The report matches the picture: same pixel, same colour.
    let mut renderer = crate::common::engine::renderer();
    renderer.upload(&example()).expect("uploaded");
    let frame = renderer.render(&camera, &RenderSettings::default()).expect("a frame");
    let drawn = Vec3::from_array(frame.color[420 * 800 + 420]);
    assert!(drawn.as_dvec3().abs_diff_eq(reported, 1e-6), "{drawn}");

    let table = place.run(format!("{inspect} 420,420")).ok().stdout;
    let rows: Vec<&str> = table.lines().collect();
    assert_eq!(rows.len(), 5, "{table}");
    for (row, depth) in rows[1..4].iter().zip(["1.8000", "2.5000", "3.2000"]) {
        assert_says(row, &[depth]);
    }
    assert!(rows[4].starts_with("final colour "), "{table}");
    place.run(format!("{inspect} 800,0")).refused(&["800,0", "800x800"]);
}
