//! Extreme frames: very long tiles, nothing to draw, odd and large images, too little capacity.

use crate::common::engine::{settings, twins};
use crate::common::frame::unstable_pixels;
use crate::common::prelude::*;
use crate::gradients::{color_weights, narrowed};
use crate::reference::pipeline::{self, backward, render};

/// A camera at the origin that looks along z, so that depths are exact in float32.
fn axis_view(size_px: [u32; 2]) -> View {
    View {
        camera_from_world: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        translation: [0.0; 3],
        sh_degree: 0,
        ..small_view(size_px)
    }
}

/// Gaussians of about a pixel, so faint that very many blend before a pixel is opaque, all in the first tile.
fn faint_points(count: usize, view: &View) -> Vec<Gaussian> {
    let mut random = Random::new(count as u64);
    (0..count)
        .map(|_| {
            let depth = random.between(1.0, 9.0);
            let at = |random: &mut Random, axis: usize| {
                let pixel = random.between(0.5, 15.5) - view.center_px[axis];
                f64::from((pixel * depth / view.focal_px[axis]) as f32)
            };
            Gaussian {
                mean: [at(&mut random, 0), at(&mut random, 1), depth],
                quat: [1.0, 0.0, 0.0, 0.0],
                log_scale: [random.between(-9.0, -5.0); 3],
                opacity_logit: random.between(-5.2, -4.4),
                sh: vec![[0; 3].map(|_| random.signed())],
            }
        })
        .collect()
}

fn compare_picture(actual: &Frame, expected: &pipeline::Frame, unstable: &[bool]) {
    let bound = PixelTolerance { max: 1e-4, mean: 2e-6, unstable: 2e-2 };
    let color: Vec<f64> = expected.pixels.iter().flat_map(|p| p.color).collect();
    pixels("colour", &widen(&actual.color), &color, unstable, bound).expect("the picture");
    let transmittance: Vec<f64> = expected.pixels.iter().map(|p| p.transmittance).collect();
    let actual: Vec<f64> = actual.transmittance.iter().map(|&t| f64::from(t)).collect();
    pixels("transmittance", &actual, &transmittance, unstable, bound).expect("the transmittance");
}

/// Compares forward and backward with the twin. Returns the number of entries of the fullest tile.
fn check(gaussians_: &[Gaussian], view: &View) -> u32 {
    let _gpu = Gpu::new();
    let expected = render(gaussians_, view);
    let unstable = unstable_pixels(view, &expected, 2e-5);
    let mut renderer = renderer();
    renderer.upload(&gaussians(gaussians_)).expect("upload");
    let actual = renderer.render(&camera(view), &settings(view)).expect("a frame");
    compare_picture(&actual, &expected, &unstable);

    let weights = color_weights(&mut Random::new(8), &unstable);
    let (target, _) = narrowed(&weights);
    let actual_gradients =
        renderer.gradients(&camera(view), &settings(view), &target, None).expect("gradients").parameters;
    drop(renderer);
    let expected_gradients = backward(gaussians_, view, &expected, &weights).parameters;
    compare_gradients(&twins(&actual_gradients), &expected_gradients);
    actual.stats.longest_tile
}

fn compare_gradients(actual: &[Gaussian], expected: &[Gradient]) {
    let skip = vec![false; expected.len()];
    let scale = expected.iter().flat_map(|g| g.log_scale).fold(0.0_f64, |largest, d| largest.max(d.abs()));
    for (name, actual, expected) in by_parameter(actual, expected) {
        let round = name == "quaternions" && expected.iter().all(|d| d.abs() <= 1e-12 * scale);
        if round {
            // Spheres have no orientation: only rounding remains.
            assert!(actual.iter().all(|d| d.abs() <= 1e-4 * scale), "quaternions of spheres");
            continue;
        }
        let bound = GradientTolerance { relative_l2: 5e-4, max_over_max: 5e-4 };
        gradient(name, &actual, &expected, &skip, bound).expect("gradients");
    }
}

/// The last tile has more entries than lavapipe runs iterations of a loop.
#[test]
fn hard_case_tiles_of_many_entries() {
    let view = axis_view([16, 16]);
    for (count, entries) in [(310, 300), (5_100, 5_000), (70_500, 70_000)] {
        assert!(check(&faint_points(count, &view), &view) >= entries, "{count} points");
    }
}

#[test]
fn hard_case_no_gaussians() {
    let gpu = Gpu::new();
    let view = small_view([33, 18]);
    let mut renderer = loaded(gpu.context, &Gaussians { sh_degree: 1, ..Default::default() });
    let frame = renderer.render(&camera(&view), &settings(&view)).expect("a frame");
    assert!(frame.color.iter().all(|&c| c == [0.25, 0.5, 0.125]));
    assert!(frame.transmittance.iter().all(|&t| t == 1.0));
    assert_eq!((frame.stats.gaussians, frame.stats.visible, frame.stats.instances), (0, 0, 0));
    let target = vec![[1.0; 3]; frame.color.len()];
    let gradients = renderer.gradients(&camera(&view), &settings(&view), &target, None).expect("gradients");
    assert!(gradients.parameters.is_empty() && gradients.mean2d_px.is_empty());
}

#[test]
fn hard_case_images_of_odd_sizes() {
    for size in [[1, 1], [17, 5], [5, 17], [16, 16], [257, 3]] {
        for extent in [Extent::Exact, Extent::Reference] {
            let focal = f64::from(size[0].max(size[1]));
            let view = View { extent, focal_px: [focal; 2], ..small_view(size) };
            check(&small_scene(&mut Random::new(2), 80, 16), &view);
        }
    }
}

#[test]
fn hard_case_large_image() {
    let view = small_view([3840, 2160]);
    let mut scene = small_scene(&mut Random::new(3), 60, 4);
    for gaussian in &mut scene {
        gaussian.log_scale = gaussian.log_scale.map(|s| s - 1.5);
    }
    let gpu = Gpu::new();
    let expected = render(&scene, &view);
    let unstable = unstable_pixels(&view, &expected, 2e-5);
    let mut renderer = loaded(gpu.context, &gaussians(&scene));
    let settings = RenderSettings { inverse_depth: false, ..settings(&view) };
    let actual = renderer.render(&camera(&view), &settings).expect("a frame");
    compare_picture(&actual, &expected, &unstable);
}

/// A frame whose instances exceed the capacity runs again with more, to the same result.
#[test]
fn hard_case_overflow_then_growth() {
    let gpu = Gpu::new();
    let view = small_view([150, 90]);
    let scene = gaussians(&small_scene(&mut Random::new(4), 500, 16));
    let (camera, settings) = (camera(&view), settings(&view));
    let mut renderer = loaded(gpu.context, &scene);
    renderer.set_instance_capacity(1 << 20);
    let roomy = renderer.render(&camera, &settings).expect("a frame");
    assert_eq!(roomy.stats.retries, 0);
    let target = vec![[0.5, -1.0, 0.25]; roomy.color.len()];
    let roomy_gradients = renderer.gradients(&camera, &settings, &target, None).expect("gradients");
    for capacity in [1, 100, roomy.stats.instances - 1] {
        renderer.set_instance_capacity(capacity);
        let frame = renderer.render(&camera, &settings).expect("a frame");
        assert!(frame.stats.retries > 0, "capacity {capacity}");
        assert!(frame.color == roomy.color, "capacity {capacity}");
        assert!(frame.transmittance == roomy.transmittance, "capacity {capacity}");
        assert!(frame.inverse_depth == roomy.inverse_depth, "capacity {capacity}");
        assert_eq!(frame.stats.instances, roomy.stats.instances);
        renderer.set_instance_capacity(capacity);
        let gradients = renderer.gradients(&camera, &settings, &target, None).expect("gradients");
        assert!(gradients == roomy_gradients, "capacity {capacity}");
    }
    renderer.set_instance_capacity(roomy.stats.instances);
    assert_eq!(renderer.render(&camera, &settings).expect("a frame").stats.retries, 0);
}

/// NaN and infinite parameters do not affect the others' picture and gradients. Opacity logits of ±∞ are valid.
#[test]
fn hard_case_non_finite_parameters() {
    let _gpu = Gpu::new();
    let view = small_view([64, 48]);
    let mut scene = small_scene(&mut Random::new(9), 100, 4);
    scene[10].opacity_logit = f64::INFINITY;
    scene[20].opacity_logit = f64::NEG_INFINITY;
    let (camera, settings) = (camera(&view), settings(&view));
    let target = vec![[0.5, -1.0, 0.25]; 64 * 48];
    let mut renderer = renderer();
    renderer.upload(&gaussians(&scene)).expect("upload");
    let frame = renderer.render(&camera, &settings).expect("a frame");
    let clean = renderer.gradients(&camera, &settings, &target, None).expect("gradients").parameters;

    let spoil: [fn(&mut Gaussian); 7] = [
        |g| g.mean[0] = f64::NAN,
        |g| g.mean[2] = f64::INFINITY,
        |g| g.quat = [f64::NAN; 4],
        |g| g.quat[1] = f64::INFINITY,
        |g| g.log_scale[1] = f64::NAN,
        |g| g.log_scale = [f64::INFINITY; 3],
        |g| g.opacity_logit = f64::NAN,
    ];
    for (i, spoil) in spoil.iter().enumerate() {
        let mut spoiled = scene[i].clone();
        spoil(&mut spoiled);
        scene.push(spoiled);
    }
    renderer.upload(&gaussians(&scene)).expect("upload");
    let after = renderer.render(&camera, &settings).expect("a frame");
    assert!(frame.color == after.color && frame.transmittance == after.transmittance);
    let gradients = renderer.gradients(&camera, &settings, &target, None).expect("gradients").parameters;
    drop(renderer);
    let (clean, gradients) = (twins(&clean), twins(&gradients));
    assert!(clean == gradients[..100]);
    assert!(gradients.iter().all(|g| scalars(&mut g.clone()).iter().all(|x| x.is_finite())));
}
