//! Other shapes for Gaussians: scale modifier, ellipsoids, points.

use crate::common::engine::renderer;
use ashsplat::frame::{ELLIPSOID_SIGMAS, POINT_RADIUS_PX};
use ashsplat::scene::{Camera, Gaussians, Intrinsics, sh};
use ashsplat::{Frame, RenderSettings, Shape};
use glam::{Mat3, Vec3};

/// A camera at the origin that looks along +z.
fn camera() -> Camera {
    Camera::with_pose(Mat3::IDENTITY, Vec3::ZERO, Intrinsics::from_fov_x(1.0, 128, 96))
}

/// One Gaussian on the optical axis: standard deviations, opacity.
fn one(scales: [f32; 3], opacity: f32) -> Gaussians {
    Gaussians {
        sh_degree: 0,
        means: vec![[0.0, 0.0, 4.0]],
        quats: vec![[1.0, 0.0, 0.0, 0.0]],
        log_scales: vec![scales.map(f32::ln)],
        opacity_logits: vec![(opacity / (1.0 - opacity)).ln()],
        sh: vec![[0.9, 0.5, 0.2].map(sh::rgb_to_sh_dc)],
    }
}

fn render(gaussians: &Gaussians, settings: &RenderSettings) -> Frame {
    let mut renderer = renderer();
    renderer.upload(gaussians).expect("uploaded");
    renderer.render(&camera(), settings).expect("a frame")
}

/// Half the width and height of the area that is more than half opaque, pixels.
fn half_extent(frame: &Frame) -> [f32; 2] {
    let width = frame.width as usize;
    let hit = |index: &usize| frame.transmittance[*index] < 0.5;
    let hits: Vec<usize> = (0..frame.transmittance.len()).filter(hit).collect();
    let extent = |of: &dyn Fn(usize) -> usize| {
        let (low, high) = (hits.iter().map(|&i| of(i)).min(), hits.iter().map(|&i| of(i)).max());
        low.zip(high).map_or(0.0, |(low, high)| 0.5 * (high - low + 1) as f32)
    };
    [extent(&|index| index % width), extent(&|index| index / width)]
}

#[test]
fn ellipsoids_are_opaque_up_to_their_surface() {
    let settings = RenderSettings { shape: Shape::Ellipsoid, ..RenderSettings::default() };
    let focal = camera().fx;
    let frame = render(&one([0.3, 0.15, 0.2], 0.4), &settings);
    let radius = |sigma: f32| ELLIPSOID_SIGMAS * sigma * focal / 4.0;
    let [x, y] = half_extent(&frame);
    assert!((x - radius(0.3)).abs() < 1.5 && (y - radius(0.15)).abs() < 1.5, "{x} {y}, {}", radius(0.3));
    // The colour is the Gaussian's, whatever its opacity.
    let middle = frame.color[(48 * 128 + 64) as usize];
    middle.iter().zip([0.9, 0.5, 0.2]).for_each(|(a, b)| assert!((a - b * 0.99).abs() < 0.01, "{middle:?}"));
    // Few pixels are half opaque: the rim is narrow.
    let rim = frame.transmittance.iter().filter(|t| (0.05..0.95).contains(*t)).count();
    let inside = frame.transmittance.iter().filter(|t| **t <= 0.05).count();
    assert!(rim * 4 < inside, "{rim} of {inside}");
    assert_eq!(half_extent(&render(&one([0.3; 3], 0.15), &settings)), [0.0; 2], "too faint");
}

#[test]
fn points_are_dots_of_one_size() {
    let settings = RenderSettings { shape: Shape::Point, ..RenderSettings::default() };
    for scale in [1e-4, 0.05, 0.7] {
        for opacity in [0.01, 0.95] {
            let frame = render(&one([scale; 3], opacity), &settings);
            let [x, y] = half_extent(&frame);
            assert!((x - POINT_RADIUS_PX).abs() <= 0.6 && x == y, "{scale} {opacity}: {x} {y}");
        }
    }
}

#[test]
fn shapes_that_make_no_sense_are_refused() {
    let camera = camera();
    let mut renderer = renderer();
    renderer.upload(&one([0.3; 3], 0.5)).expect("uploaded");
    for scale_modifier in [-1.0, f32::NAN, f32::INFINITY] {
        let settings = RenderSettings { scale_modifier, ..RenderSettings::default() };
        let error = renderer.render(&camera, &settings).expect_err("refused");
        assert!(error.to_string().starts_with("scale_modifier: is "), "{error}");
    }
    let gradient = vec![[1.0; 3]; 128 * 96];
    let settings = RenderSettings { shape: Shape::Point, ..RenderSettings::default() };
    let error = renderer.gradients(&camera, &settings, &gradient, None).expect_err("refused");
    assert!(error.to_string().contains("as they are"), "{error}");
}

#[test]
fn small_ellipsoids_have_no_holes() {
    let settings = RenderSettings { shape: Shape::Ellipsoid, ..RenderSettings::default() };
    for (k, scale) in [0.0002, 0.005, 0.02, 0.05].into_iter().cycle().take(32).enumerate() {
        let mut ellipsoid = one([scale; 3], 0.9);
        // Different positions within tiles and between pixels.
        let [x, y] = [0.013 * k as f32 - 0.2, 0.3 - 0.017 * k as f32];
        ellipsoid.means[0] = [x, y, 4.0];
        let frame = render(&ellipsoid, &settings);
        let camera = camera();
        let middle = [camera.fx * x / 4.0 + camera.cx - 0.5, camera.fy * y / 4.0 + camera.cy - 0.5];
        let sigma = (camera.fx * scale / 4.0).hypot(0.3f32.sqrt());
        // A tenth less, because of the rim.
        let radius = 0.9 * ELLIPSOID_SIGMAS * sigma;
        for (index, transmittance) in frame.transmittance.iter().enumerate() {
            let [column, row] = [index as u32 % frame.width, index as u32 / frame.width];
            let distance = (column as f32 - middle[0]).hypot(row as f32 - middle[1]);
            let place = format!("{k}: {scale}, pixel {column}, {row}");
            assert!(distance > radius || *transmittance < 0.5, "{place}: {transmittance}");
        }
    }
}
