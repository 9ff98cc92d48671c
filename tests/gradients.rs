//! Finite differences prove the twins' backward pass, the twins prove the device's.

use crate::common::engine::{settings, twins};
use crate::common::frame::unstable_pixels;
use crate::common::prelude::*;
use crate::reference::blend_backward::PixelGradient;
use crate::reference::exposure::{Exposures, Matrix, expose, expose_backward};
use crate::reference::inverse_depth_l1::inverse_depth_l1;
use crate::reference::loss;
use crate::reference::pipeline::{Frame, backward, pixels_of, render, tile_of};
use crate::reference::project::color as color_of;
use crate::reference::project_backward::project_backward;
use crate::reference::regularize::regularize;
use crate::reference::sparse_depth::{self, Point, depth_sums, expected};
use crate::reference::sparse_depth_gather::{expected_depth_backward, gather};

/// Σ pixel · weight, a loss that is linear in the picture.
pub fn linear_loss(gaussians: &[Gaussian], view: &View, weights: &[PixelGradient]) -> f64 {
    let color = |a: &[f64; 3], b: &[f64; 3]| (0..3).map(|i| a[i] * b[i]).sum::<f64>();
    let frame = render(gaussians, view);
    let terms = frame.pixels.iter().zip(weights);
    terms.map(|(p, w)| color(&p.color, &w.color) + p.inverse_depth * w.inverse_depth).sum()
}

pub fn random_weights(random: &mut Random, view: &View) -> Vec<PixelGradient> {
    (0..view.pixels())
        .map(|_| PixelGradient { color: [0; 3].map(|_| random.signed()), inverse_depth: random.signed() })
        .collect()
}

/// Random weights, zero where a decision depends on rounding; those of the colour are exact in float32.
pub fn stable_weights(random: &mut Random, view: &View, frame: &Frame) -> Vec<PixelGradient> {
    let mut weights = random_weights(random, view);
    for (weight, unstable) in weights.iter_mut().zip(unstable_pixels(view, frame, 2e-5)) {
        if unstable {
            *weight = PixelGradient::default();
        }
        weight.color = weight.color.map(|x| f64::from(x as f32));
    }
    weights
}

pub fn color_weights(random: &mut Random, unstable: &[bool]) -> Vec<PixelGradient> {
    let mut color = |unstable| if unstable { [0.0; 3] } else { [0; 3].map(|_| random.signed()) };
    let weight = |&unstable| PixelGradient { color: color(unstable), inverse_depth: 0.0 };
    unstable.iter().map(weight).collect()
}

/// Weights of colour and inverse depth for the device.
pub fn narrowed(weights: &[PixelGradient]) -> (Vec<[f32; 3]>, Vec<f32>) {
    weights.iter().map(|w| (w.color.map(|x| x as f32), w.inverse_depth as f32)).unzip()
}

/// A narrow view of a wide scene: many centres beyond the limits of the linearisation.
pub fn narrow_view(symmetric_limit: bool) -> View {
    View { symmetric_limit, focal_px: [60.0, 55.0], center_px: [9.0, 6.5], ..small_view([20, 12]) }
}

/// Entries blended at each pixel. If a step changes them, the picture jumps and has no derivative.
pub fn decisions(gaussians: &[Gaussian], view: &View) -> Vec<(u32, u32)> {
    render(gaussians, view).pixels.iter().map(|p| (p.blended, p.last)).collect()
}

/// Compares derivatives of a value with respect to some numbers with central differences. `at` returns the value with one
/// number moved, and decisions that must stay the same for a derivative to exist. Returns how many were compared.
pub fn compare_with_differences<T: PartialEq>(
    what: &str,
    derivatives: &[f64],
    step: f64,
    bound: impl Fn(f64) -> f64,
    at: impl Fn(usize, f64) -> (f64, T),
) -> usize {
    let mut compared = 0;
    for (place, &derivative) in derivatives.iter().enumerate() {
        let ((after, same), (before, as_before)) = (at(place, step), at(place, -step));
        if same != as_before {
            continue;
        }
        let difference = (after - before) / (2.0 * step);
        assert!(
            (difference - derivative).abs() <= bound(derivative),
            "{what}, number {place}: {derivative:.9e}, by differences {difference:.9e}"
        );
        compared += 1;
    }
    compared
}

/// Same, for a value of a scene by each parameter.
fn compare_scene<T: PartialEq>(
    what: &str,
    scene: &[Gaussian],
    gradients: &[Gradient],
    (step, bound): (f64, &dyn Fn(f64) -> f64),
    value: impl Fn(&[Gaussian]) -> (f64, T),
) -> usize {
    let of_gaussian = |(index, gradient): (usize, &Gradient)| {
        let what = format!("{what}, Gaussian {index}");
        compare_with_differences(&what, &gradient_scalars(gradient), step, bound, |place, by| {
            let mut scene = scene.to_vec();
            *scalars(&mut scene[index])[place] += by;
            value(&scene)
        })
    };
    gradients.iter().enumerate().map(of_gaussian).sum()
}

/// Compares every derivative of a linear loss by a random scene. Returns the number compared.
fn compare_frame(view: &View, seed: u64) -> usize {
    let mut random = Random::new(seed);
    let scene = small_scene(&mut random, 6, 16);
    let weights = random_weights(&mut random, view);
    let gradients = backward(&scene, view, &render(&scene, view), &weights).parameters;
    let bound = |derivative: f64| 1e-6 + 2e-6 * derivative.abs();
    let value = |scene: &[Gaussian]| (linear_loss(scene, view, &weights), decisions(scene, view));
    compare_scene(&format!("seed {seed}"), &scene, &gradients, (1e-5, &bound), value)
}

#[test]
fn gradients_of_the_twin_agree_with_finite_differences() {
    for extent in [Extent::Exact, Extent::Reference] {
        for antialias in [false, true] {
            let view = View { extent, antialias, ..small_view([40, 24]) };
            let compared: usize = (0..3).map(|seed| compare_frame(&view, seed)).sum();
            assert!(compared > 400, "only {compared} derivatives could be compared");
        }
    }
}

/// The picture with Gaussians in the order of distances, and its gradients.
fn distance_ordered(view: View) -> View {
    View { drawn: Style { distance_order: true, ..view.drawn }, ..view }
}

#[test]
fn gradients_of_the_twin_in_the_order_of_distances() {
    let view = distance_ordered(small_view([40, 24]));
    let compared: usize = (20..23).map(|seed| compare_frame(&view, seed)).sum();
    assert!(compared > 200, "only {compared} derivatives could be compared");
}

#[test]
fn gradients_of_the_twin_through_the_jacobian_limits() {
    for view in [false, true].map(narrow_view) {
        let compared: usize = (10..14).map(|seed| compare_frame(&view, seed)).sum();
        assert!(compared > 300, "only {compared} derivatives could be compared");
    }
}

#[test]
fn gradient_of_the_loss_agrees_with_finite_differences() {
    let mut random = Random::new(5);
    let (width, height) = (13, 9);
    let x: Vec<f64> = (0..width * height * 3).map(|_| random.unit()).collect();
    let y: Vec<f64> = (0..width * height * 3).map(|_| random.unit()).collect();
    let gradient = loss::loss(&x, &y, width, height).gradient;
    let each_7th: Vec<f64> = gradient.into_iter().step_by(7).collect();
    let moved = |place: usize, by: f64| {
        let mut x = x.clone();
        x[7 * place] += by;
        (loss::loss(&x, &y, width, height).loss, ())
    };
    compare_with_differences("x", &each_7th, 1e-6, |_| 1e-9, moved);
}

fn compare_with_device(view: &View, seed: u64) {
    let _gpu = Gpu::new();
    let mut random = Random::new(seed);
    let scene = small_scene(&mut random, 150, 16);
    let frame = render(&scene, view);
    let weights = stable_weights(&mut random, view, &frame);
    let expected = backward(&scene, view, &frame, &weights).parameters;
    let (color, inverse_depth) = narrowed(&weights);
    let mut renderer = renderer();
    renderer.upload(&gaussians(&scene)).expect("upload");
    let actual = renderer.gradients(&camera(view), &settings(view), &color, Some(&inverse_depth));
    drop(renderer);
    let actual = twins(&actual.expect("gradients").parameters);
    let none = vec![false; scene.len()];
    // A colour of nearly 0 may be clamped or not.
    let near_clamp: Vec<bool> =
        scene.iter().map(|g| color_of(g, view).1.iter().any(|c| c.abs() < 1e-5)).collect();
    for (name, actual, expected) in by_parameter(&actual, &expected) {
        let bound = if name == "quaternions" { 5e-4 } else { 1e-4 };
        let skip = if ["means", "SH"].contains(&name) { &near_clamp } else { &none };
        let tolerance = GradientTolerance { relative_l2: bound, max_over_max: 2.0 * bound };
        gradient(name, &actual, &expected, skip, tolerance).expect("gradients of the device");
    }
}

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

/// Also compares the pictures of the device and of the twin. The order changes both.
#[test]
fn gradients_of_the_device_in_the_order_of_distances() {
    let usual = small_view([90, 60]);
    let view = distance_ordered(usual.clone());
    compare_with_device(&view, 9);
    let _gpu = Gpu::new();
    let scene = small_scene(&mut Random::new(9), 150, 16);
    let frame = render(&scene, &view);
    assert_ne!(frame.lists, render(&scene, &usual).lists);
    let mut renderer = renderer();
    renderer.upload(&gaussians(&scene)).expect("upload");
    let drawn = renderer.render(&camera(&view), &settings(&view)).expect("a frame");
    let stable = unstable_pixels(&view, &frame, 1e-4);
    for (index, (actual, expected)) in drawn.color.iter().zip(&frame.pixels).enumerate() {
        let close = (0..3).all(|c| (f64::from(actual[c]) - expected.color[c]).abs() < 1e-4);
        assert!(close || stable[index], "pixel {index}: {actual:?}, {:?}", expected.color);
    }
}

#[test]
fn gradients_of_the_device_through_the_jacobian_limits() {
    for view in [false, true].map(narrow_view) {
        compare_with_device(&view, 7);
    }
}

// ---- loss terms and stages of a frame: the golden vectors and the kernels' tests then prove the device ------------

const STEP: f64 = 1e-6;

fn compare<T: PartialEq>(
    scene: &[Gaussian],
    gradients: &[Gradient],
    term: impl Fn(&[Gaussian]) -> (f64, T),
) -> usize {
    let largest = gradients.iter().flat_map(gradient_scalars).fold(0.0, |max: f64, x| max.max(x.abs()));
    compare_scene("a term", scene, gradients, (STEP, &|_| 2e-6 * largest), term)
}

#[test]
fn gradients_of_the_regularisers_agree_with_finite_differences() {
    let scene = small_scene(&mut Random::new(31), 7, 1);
    for weights in [[1.0, 0.0], [0.0, 1.0], [0.3, 0.7]] {
        let gradients = regularize(&scene, weights).gradients.into_iter().map(|of| Gradient {
            log_scale: of.log_scale,
            opacity_logit: of.opacity_logit,
            sh: of.sh,
            ..Gradient::default()
        });
        let count = scene.len() as f64;
        let term = |scene: &[Gaussian]| {
            let sums = regularize(scene, weights);
            (weights[0] * sums.opacity / count + weights[1] * sums.scale / (3.0 * count), ())
        };
        assert_eq!(compare(&scene, &gradients.collect::<Vec<_>>(), term), 7 * 14);
    }
}

/// Through the whole frame, with a map that lacks depths at some pixels.
#[test]
fn gradients_of_inverse_depth_maps_agree_with_finite_differences() {
    let mut random = Random::new(32);
    let (scene, view) = (small_scene(&mut random, 6, 1), View { sh_degree: 0, ..small_view([20, 12]) });
    let map: Vec<Option<f64>> =
        (0..view.pixels()).map(|pixel| (pixel % 3 > 0).then(|| random.between(0.0, 0.3))).collect();
    let depths = |frame: &Frame| frame.pixels.iter().map(|p| p.inverse_depth).collect::<Vec<_>>();
    let frame = render(&scene, &view);
    let (_, of_depths) = inverse_depth_l1(&depths(&frame), &map, 0.7);
    let pixel = |&inverse_depth: &f64| PixelGradient { color: [0.0; 3], inverse_depth };
    let of_pixels: Vec<PixelGradient> = of_depths.iter().map(pixel).collect();
    let gradients = backward(&scene, &view, &frame, &of_pixels).parameters;
    let term = |scene: &[Gaussian]| {
        let (loss, slopes) = inverse_depth_l1(&depths(&render(scene, &view)), &map, 0.7);
        (loss, (decisions(scene, &view), slopes))
    };
    let compared = compare(&scene, &gradients, term);
    assert!(compared > 60, "only {compared} of 84");
}

fn lists<'a>(frame: &'a Frame, view: &View) -> Vec<([u32; 2], usize, Vec<&'a Splat>)> {
    let list = |tile: usize| frame.lists[tile].iter().filter_map(|&g| frame.splats[g as usize].as_ref());
    pixels_of(view).map(|pixel| (pixel, tile_of(view, pixel), list(tile_of(view, pixel)).collect())).collect()
}

/// The loss of sparse points, its signs, and dL/d(depth) per pixel.
fn of_points(frame: &Frame, view: &View, points: &[Point]) -> (f64, Vec<bool>, Vec<f64>) {
    let depths: Vec<f64> =
        lists(frame, view).iter().map(|(pixel, _, list)| expected(depth_sums(list, *pixel))).collect();
    let size = view.size_px.map(|n| n as usize);
    let (loss, each) = sparse_depth::loss(&depths, size, points, 0.7);
    let slopes: Vec<f64> = each.iter().map(|[_, slope]| *slope).collect();
    (loss, slopes.iter().map(|slope| *slope > 0.0).collect(), gather(points, &slopes, size))
}

/// Through the bilinear samples, the expected depth and the whole frame.
#[test]
fn gradients_of_sparse_points_agree_with_finite_differences() {
    let mut random = Random::new(33);
    let (scene, view) = (small_scene(&mut random, 8, 1), View { sh_degree: 0, ..small_view([20, 12]) });
    let point = |random: &mut Random| Point {
        position_px: [random.between(4.0, 16.0), random.between(2.0, 10.0)],
        inverse_z: random.between(0.1, 0.4),
    };
    let points: Vec<Point> = (0..12).map(|_| point(&mut random)).collect();
    let frame = render(&scene, &view);
    let (.., of_pixels) = of_points(&frame, &view, &points);
    let mut splats = vec![SplatGradient::default(); scene.len()];
    for ((pixel, tile, list), of_depth) in lists(&frame, &view).iter().zip(&of_pixels) {
        let mut of_list = vec![SplatGradient::default(); list.len()];
        expected_depth_backward(list, *pixel, *of_depth, &mut of_list);
        let each = frame.lists[*tile].iter().zip(&of_list);
        each.for_each(|(&gaussian, own)| splats[gaussian as usize].add(own));
    }
    let gradient = |(index, gaussian): (usize, &Gaussian)| match frame.splats[index] {
        Some(_) => project_backward(gaussian, &view, &splats[index]),
        None => Gradient { sh: vec![[0.0; 3]; gaussian.sh.len()], ..Gradient::default() },
    };
    let gradients: Vec<Gradient> = scene.iter().enumerate().map(gradient).collect();
    let term = |scene: &[Gaussian]| {
        let (loss, signs, _) = of_points(&render(scene, &view), &view, &points);
        (loss, (decisions(scene, &view), signs))
    };
    let compared = compare(&scene, &gradients, term);
    assert!(compared > 80, "only {compared} of 112");
}

fn compare_numbers(what: &str, at: &[f64], derivatives: &[f64], nth: usize, loss: impl Fn(&[f64]) -> f64) {
    let some: Vec<f64> = derivatives.iter().step_by(nth).copied().collect();
    let moved = |place: usize, by: f64| {
        let mut moved = at.to_vec();
        moved[nth * place] += by;
        (loss(&moved), ())
    };
    compare_with_differences(what, &some, STEP, |_| 1e-8, moved);
}

fn matrix(numbers: &[f64]) -> Matrix {
    [0, 1, 2].map(|row| [0, 1, 2, 3].map(|column| numbers[4 * row + column]))
}

/// Derivatives of the photometric loss by each element of the matrix and by the rendered picture.
#[test]
fn gradients_of_an_exposure_agree_with_finite_differences() {
    let mut random = Random::new(34);
    let (width, height) = (9, 7);
    let picture: Vec<[f64; 3]> = (0..width * height).map(|_| [0; 3].map(|_| random.unit())).collect();
    let photo: Vec<f64> = (0..3 * width * height).map(|_| random.unit()).collect();
    let own: Matrix = [0, 1, 2]
        .map(|row| [0, 1, 2, 3].map(|column| 0.3 * random.signed() + if row == column { 1.0 } else { 0.0 }));
    let loss = |picture: &[[f64; 3]], matrix: &Matrix| {
        loss::loss(expose(picture, matrix).as_flattened(), &photo, width, height)
    };
    let (of_picture, of_matrix) =
        expose_backward(&picture, &own, loss(&picture, &own).gradient.as_chunks().0);
    compare_numbers("E", own.as_flattened(), of_matrix.as_flattened(), 1, |moved| {
        loss(&picture, &matrix(moved)).loss
    });
    compare_numbers("picture", picture.as_flattened(), of_picture.as_flattened(), 5, |moved| {
        loss(moved.as_chunks().0, &own).loss
    });
}

/// The filter size is constant, about the size of the Gaussians.
#[test]
fn gradients_through_the_3d_filter_agree_with_finite_differences() {
    for antialias in [false, true] {
        let view = View { filter_3d: 0.2, antialias, ..small_view([24, 16]) };
        let compared: usize = (40..42).map(|seed| compare_frame(&view, seed)).sum();
        assert!(compared > 260, "only {compared} derivatives could be compared");
    }
}

/// The trainer's weight on exposures is twice `exposure_reg`. It is the derivative of `exposure_reg` times the sum
/// of squares: of all elements, or of all but the diagonal.
#[test]
fn gradients_of_the_weight_on_exposures_agree_with_finite_differences() {
    let mut random = Random::new(35);
    let reg = 0.3;
    for center in [false, true] {
        let mut exposures = Exposures { decay: 2.0 * reg, ..Exposures::new(2) };
        exposures.values.as_flattened_mut().as_flattened_mut().fill_with(|| random.signed());
        let values = exposures.values.clone();
        let counts = |row: usize, column: usize| !(center && row == column);
        let penalty = |of: &Matrix| -> f64 {
            let squares = (0..3).flat_map(|row| (0..4).map(move |column| (row, column)));
            reg * squares.filter(|&(i, j)| counts(i, j)).map(|(i, j)| of[i][j].powi(2)).sum::<f64>()
        };
        exposures.step(0, &[[0.0; 4]; 3], 0.01, 1, center);
        for (own, first) in values.iter().zip(&exposures.first) {
            // The first moment after the first step is a tenth of the gradient.
            let derivatives: Vec<f64> = first.as_flattened().iter().map(|moment| moment / 0.1).collect();
            compare_numbers("E", own.as_flattened(), &derivatives, 1, |moved| penalty(&matrix(moved)));
        }
    }
}

/// Dropout omits some Gaussians and raises the others' opacities, also those that the compensation of antialiasing
/// reduces.
#[test]
fn gradients_under_dropout_agree_with_finite_differences() {
    for antialias in [false, true] {
        let mut compared = 0;
        for seed in 50..53 {
            let dropout = Dropout { below: 6 << 20, seed: 7, iteration: seed as u32 };
            let left_out = (0..6).filter(|&gaussian| dropout.drops(gaussian)).count();
            assert!((1..6).contains(&left_out), "of six, {left_out} are left out");
            let drawn = Style { dropout: Some(dropout), ..Style::AS_THEY_ARE };
            compared += compare_frame(&View { drawn, antialias, ..small_view([24, 16]) }, seed);
        }
        assert!(compared > 400, "only {compared} derivatives could be compared");
    }
}
