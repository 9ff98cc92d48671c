//! Finite differences prove the twins' backward pass, the twins prove the device's.

mod terms;

use crate::common::compare::{GradientTolerance, gradient};
use crate::common::engine;
use crate::common::gpu::Gpu;
use crate::common::scenes::{Random, scalars, small_scene, small_view};
use crate::common::tiles::is_unstable;
use crate::reference::blend_backward::PixelGradient;
use crate::reference::loss_reduce;
use crate::reference::pipeline::{backward, pixels_of, render, tile_of};
use crate::reference::project::color as color_of;
use crate::reference::types::{Extent, Gaussian, Gradient, Splat, View};

/// Σ pixel · weight, a loss that is linear in the picture.
pub fn linear_loss(gaussians: &[Gaussian], view: &View, weights: &[PixelGradient]) -> f64 {
    render(gaussians, view)
        .pixels
        .iter()
        .zip(weights)
        .map(|(p, w)| {
            (0..3).map(|i| p.color[i] * w.color[i]).sum::<f64>() + p.inverse_depth * w.inverse_depth
        })
        .sum()
}

pub fn random_weights(random: &mut Random, view: &View) -> Vec<PixelGradient> {
    (0..view.pixels())
        .map(|_| PixelGradient {
            color: [random.signed(), random.signed(), random.signed()],
            inverse_depth: random.signed(),
        })
        .collect()
}

fn flat(gradient: &Gradient) -> Vec<f64> {
    let mut all = gradient.mean.to_vec();
    all.extend(gradient.quat);
    all.extend(gradient.log_scale);
    all.push(gradient.opacity_logit);
    all.extend(gradient.sh.concat());
    all
}

/// Entries blended at each pixel. If a step changes them, the picture jumps and has no derivative.
pub fn decisions(gaussians: &[Gaussian], view: &View) -> Vec<(u32, u32)> {
    render(gaussians, view).pixels.iter().map(|p| (p.blended, p.last)).collect()
}

/// Compares every derivative with central differences. Returns the number compared.
fn compare_with_differences(view: &View, seed: u64) -> usize {
    let mut random = Random::new(seed);
    let gaussians = small_scene(&mut random, 6, 16);
    let weights = random_weights(&mut random, view);
    let frame = render(&gaussians, view);
    let gradients = backward(&gaussians, view, &frame, &weights).parameters;
    let mut compared = 0;
    for (index, gradient) in gradients.iter().enumerate() {
        for (place, &derivative) in flat(gradient).iter().enumerate() {
            let step = 1e-5;
            let moved = |by: f64| {
                let mut gaussians = gaussians.clone();
                *scalars(&mut gaussians[index])[place] += by;
                gaussians
            };
            let (after, before) = (moved(step), moved(-step));
            if decisions(&after, view) != decisions(&before, view) {
                continue;
            }
            let difference =
                (linear_loss(&after, view, &weights) - linear_loss(&before, view, &weights)) / (2.0 * step);
            let error = (difference - derivative).abs();
            assert!(
                error <= 1e-6 + 2e-6 * derivative.abs(),
                "seed {seed}, Gaussian {index}, parameter {place}: {derivative:.9e}, by differences {difference:.9e}"
            );
            compared += 1;
        }
    }
    compared
}

#[test]
fn gradients_of_the_twin_agree_with_finite_differences() {
    for extent in [Extent::Exact, Extent::Reference] {
        for antialias in [false, true] {
            let view = View { extent, antialias, ..small_view([40, 24]) };
            let compared: usize = (0..3).map(|seed| compare_with_differences(&view, seed)).sum();
            assert!(compared > 400, "only {compared} derivatives could be compared");
        }
    }
}

#[test]
fn gradients_of_the_twin_through_the_jacobian_limits() {
    // A narrow view of a wide scene: many centres beyond the limits.
    for symmetric_limit in [false, true] {
        let view =
            View { symmetric_limit, focal_px: [60.0, 55.0], center_px: [9.0, 6.5], ..small_view([20, 12]) };
        let compared: usize = (10..14).map(|seed| compare_with_differences(&view, seed)).sum();
        assert!(compared > 300, "only {compared} derivatives could be compared");
    }
}

#[test]
fn gradient_of_the_loss_agrees_with_finite_differences() {
    let mut random = Random::new(5);
    let (width, height) = (13, 9);
    let x: Vec<f64> = (0..width * height * 3).map(|_| random.unit()).collect();
    let y: Vec<f64> = (0..width * height * 3).map(|_| random.unit()).collect();
    let gradient = loss_reduce::loss(&x, &y, width, height).gradient;
    for place in (0..x.len()).step_by(7) {
        let step = 1e-6;
        let moved = |by: f64| {
            let mut x = x.clone();
            x[place] += by;
            loss_reduce::loss(&x, &y, width, height).loss
        };
        let difference = (moved(step) - moved(-step)) / (2.0 * step);
        assert!((difference - gradient[place]).abs() <= 1e-9, "{place}: {} {difference}", gradient[place]);
    }
}

/// Gradients of random scenes on the device against the twin.
fn compare_with_device(view: &View, seed: u64) {
    let gpu = Gpu::new();
    let mut random = Random::new(seed);
    let scene = small_scene(&mut random, 150, 16);
    let frame = render(&scene, view);
    let mut weights = random_weights(&mut random, view);
    for (pixel, weight) in pixels_of(view).zip(&mut weights) {
        let list: Vec<&Splat> = frame.lists[tile_of(view, pixel)]
            .iter()
            .map(|&g| frame.splats[g as usize].as_ref().expect("listed"))
            .collect();
        if is_unstable(&list, pixel, 2e-5) {
            *weight = PixelGradient::default();
        }
        // Rounded to float32.
        weight.color = weight.color.map(|x| f64::from(x as f32));
    }
    let expected = backward(&scene, view, &frame, &weights).parameters;
    let color: Vec<[f32; 3]> = weights.iter().map(|w| w.color.map(|x| x as f32)).collect();
    let inverse_depth: Vec<f32> = weights.iter().map(|w| w.inverse_depth as f32).collect();
    let mut renderer = engine::renderer();
    renderer.upload(&engine::gaussians(&scene)).expect("upload");
    let actual = renderer
        .gradients(&engine::camera(view), &engine::settings(view), &color, Some(&inverse_depth))
        .expect("gradients");
    drop(renderer);
    let actual = engine::twins(&actual.parameters);
    let none = vec![false; scene.len()];
    // A colour of nearly 0 may be clamped or not.
    let near_clamp: Vec<bool> =
        scene.iter().map(|g| color_of(g, view).1.iter().any(|c| c.abs() < 1e-5)).collect();
    let fields: [Field; 5] = [
        ("means", |g| g.mean.to_vec(), |g| g.mean.to_vec(), &near_clamp, 1e-4),
        ("quaternions", |g| g.quat.to_vec(), |g| g.quat.to_vec(), &none, 5e-4),
        ("log-scales", |g| g.log_scale.to_vec(), |g| g.log_scale.to_vec(), &none, 1e-4),
        ("opacities", |g| vec![g.opacity_logit], |g| vec![g.opacity_logit], &none, 1e-4),
        ("SH", |g| g.sh.concat(), |g| g.sh.concat(), &near_clamp, 1e-4),
    ];
    for (name, of_actual, of_expected, skip, bound) in fields {
        let actual: Vec<f64> = actual.iter().flat_map(of_actual).collect();
        let expected: Vec<f64> = expected.iter().flat_map(of_expected).collect();
        let tolerance = GradientTolerance { relative_l2: bound, max_over_max: 2.0 * bound };
        gradient(name, &actual, &expected, skip, tolerance).expect("gradients of the device");
    }
    drop(gpu);
}

/// Name, values of the device, values of the twin, Gaussians to skip, bound.
type Field<'a> = (&'a str, fn(&Gaussian) -> Vec<f64>, fn(&Gradient) -> Vec<f64>, &'a [bool], f64);

#[test]
fn gradients_of_the_device_agree_with_the_twin() {
    for seed in 0..3 {
        for extent in [Extent::Exact, Extent::Reference] {
            for (antialias, sh_degree) in [(false, 3), (true, 1)] {
                let view = View { extent, antialias, sh_degree, ..small_view([90, 60]) };
                compare_with_device(&view, 100 + seed);
            }
        }
    }
}

#[test]
fn gradients_of_the_device_through_the_jacobian_limits() {
    for symmetric_limit in [false, true] {
        let view =
            View { symmetric_limit, focal_px: [60.0, 55.0], center_px: [9.0, 6.5], ..small_view([20, 12]) };
        compare_with_device(&view, 7);
    }
}
