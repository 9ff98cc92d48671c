//! Finite differences of loss terms and of stages of a frame: regularisers, inverse depths of maps and of sparse
//! points, exposures, the 3D filter, dropout. The golden vectors and the kernels' tests then prove the device.

use super::{compare_with_differences, decisions, flat};
use crate::common::scenes::{Random, scalars, small_scene, small_view};
use crate::reference::blend_backward::PixelGradient;
use crate::reference::expose::{Matrix, expose};
use crate::reference::expose_backward::expose_backward;
use crate::reference::exposure_step::Exposures;
use crate::reference::inverse_depth_l1::inverse_depth_l1;
use crate::reference::loss_reduce;
use crate::reference::pipeline::{Frame, backward, pixels_of, render, tile_of};
use crate::reference::project_backward::project_backward;
use crate::reference::regularize::regularize;
use crate::reference::sparse_depth::{self, Point, depth_sums, expected};
use crate::reference::sparse_depth_gather::{expected_depth_backward, gather};
use crate::reference::types::{Drawn, Dropout, Gaussian, Gradient, Splat, SplatGradient, View};

const STEP: f64 = 1e-6;

/// A term's loss for a scene, and the decisions that must stay the same for a derivative to exist.
type Term<'a, T> = &'a dyn Fn(&[Gaussian]) -> (f64, T);

/// Compares the derivative of a term by each parameter with central differences. Returns the number compared. Errors
/// are relative to the largest derivative.
fn compare<T: PartialEq>(scene: &[Gaussian], gradients: &[Gradient], term: Term<T>) -> usize {
    let largest = gradients.iter().flat_map(flat).fold(0.0, |most: f64, x| most.max(x.abs()));
    let mut compared = 0;
    for (index, gradient) in gradients.iter().enumerate() {
        for (place, derivative) in flat(gradient).into_iter().enumerate() {
            let at = |by: f64| {
                let mut scene = scene.to_vec();
                *scalars(&mut scene[index])[place] += by;
                term(&scene)
            };
            let ((after, same), (before, as_before)) = (at(STEP), at(-STEP));
            if same != as_before {
                continue;
            }
            let difference = (after - before) / (2.0 * STEP);
            assert!(
                (difference - derivative).abs() <= 2e-6 * largest,
                "Gaussian {index}, parameter {place}: {derivative:.9e}, by differences {difference:.9e} of {largest:.3e}"
            );
            compared += 1;
        }
    }
    compared
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
        assert_eq!(compare(&scene, &gradients.collect::<Vec<_>>(), &term), 7 * 14);
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
    let of_pixels: Vec<PixelGradient> =
        of_depths.iter().map(|&inverse_depth| PixelGradient { color: [0.0; 3], inverse_depth }).collect();
    let gradients = backward(&scene, &view, &frame, &of_pixels).parameters;
    let term = |scene: &[Gaussian]| {
        let (loss, slopes) = inverse_depth_l1(&depths(&render(scene, &view)), &map, 0.7);
        (loss, (decisions(scene, &view), slopes))
    };
    let compared = compare(&scene, &gradients, &term);
    assert!(compared > 60, "only {compared} of 84");
}

/// Pixels of a frame with their tiles and lists.
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
    let compared = compare(&scene, &gradients, &term);
    assert!(compared > 80, "only {compared} of 112");
}

/// Derivatives of the photometric loss by each element of the matrix and by the rendered picture.
#[test]
fn gradients_of_an_exposure_agree_with_finite_differences() {
    let mut random = Random::new(34);
    let (width, height) = (9, 7);
    let color = |random: &mut Random| [0; 3].map(|_| random.unit());
    let picture: Vec<[f64; 3]> = (0..width * height).map(|_| color(&mut random)).collect();
    let photo: Vec<f64> = (0..3 * width * height).map(|_| random.unit()).collect();
    let matrix: Matrix = [0, 1, 2]
        .map(|row| [0, 1, 2, 3].map(|column| 0.3 * random.signed() + if row == column { 1.0 } else { 0.0 }));
    let loss = |picture: &[[f64; 3]], matrix: &Matrix| {
        loss_reduce::loss(expose(picture, matrix).as_flattened(), &photo, width, height)
    };
    let of_exposed: Vec<[f64; 3]> =
        loss(&picture, &matrix).gradient.chunks(3).map(|g| [g[0], g[1], g[2]]).collect();
    let (of_picture, of_matrix) = expose_backward(&picture, &matrix, &of_exposed);
    let difference = |at: &dyn Fn(f64) -> f64| (at(STEP) - at(-STEP)) / (2.0 * STEP);
    for (place, derivative) in of_matrix.as_flattened().iter().enumerate() {
        let by = difference(&|by| {
            let mut matrix = matrix;
            matrix.as_flattened_mut()[place] += by;
            loss(&picture, &matrix).loss
        });
        assert!((by - derivative).abs() < 1e-8, "E[{place}]: {derivative}, by differences {by}");
    }
    for place in (0..3 * width * height).step_by(5) {
        let by = difference(&|by| {
            let mut picture = picture.clone();
            picture.as_flattened_mut()[place] += by;
            loss(&picture, &matrix).loss
        });
        let derivative = of_picture.as_flattened()[place];
        assert!((by - derivative).abs() < 1e-8, "picture {place}: {derivative}, by differences {by}");
    }
}

/// The filter size is constant, about the size of the Gaussians.
#[test]
fn gradients_through_the_3d_filter_agree_with_finite_differences() {
    for antialias in [false, true] {
        let view = View { filter_3d: 0.2, antialias, ..small_view([24, 16]) };
        let compared: usize = (40..42).map(|seed| compare_with_differences(&view, seed)).sum();
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
        for (matrix, first) in values.iter().zip(&exposures.first) {
            for place in 0..12 {
                let at = |by: f64| {
                    let mut moved = *matrix;
                    moved.as_flattened_mut()[place] += by;
                    penalty(&moved)
                };
                let by = (at(STEP) - at(-STEP)) / (2.0 * STEP);
                // The first moment after the first step is a tenth of the gradient.
                let derivative = first.as_flattened()[place] / 0.1;
                assert!((by - derivative).abs() < 1e-8, "E[{place}]: {derivative}, by differences {by}");
            }
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
            let drawn = Drawn { dropout: Some(dropout), ..Drawn::AS_THEY_ARE };
            compared += compare_with_differences(&View { drawn, antialias, ..small_view([24, 16]) }, seed);
        }
        assert!(compared > 400, "only {compared} derivatives could be compared");
    }
}
