//! Gradients of camera poses: finite differences prove the twin, the twin proves the device. Displaced poses are
//! recovered in training and by alignment.

mod optimisation;

use ashsplat::vk::{Context, ContextOptions, LimitsOverride};
use ashsplat::{Gaussians, RenderSettings, Renderer};

use crate::common::blending::assert_alike;
use crate::common::compare::elementwise;
use crate::common::engine::{self, camera, derivatives, settings};
use crate::common::gpu::Gpu;
use crate::common::options;
use crate::common::scenes::{Random, small_scene, small_view};
use crate::common::tiles::is_unstable;
use crate::gradients::{decisions, linear_loss, random_weights};
use crate::reference::blend_backward::PixelGradient;
use crate::reference::pipeline::{backward, pixels_of, render, tile_of};
use crate::reference::pose_step::moved;
use crate::reference::types::{Extent, Gaussian, Splat, View};

/// The view at exp(δ^) T.
pub fn moved_view(view: &View, delta: [f64; 6]) -> View {
    let (camera_from_world, translation) = moved(delta, (&view.camera_from_world, view.translation));
    View { camera_from_world, translation, ..view.clone() }
}

fn along(axis: usize, by: f64) -> [f64; 6] {
    let mut delta = [0.0; 6];
    delta[axis] = by;
    delta
}

/// Compares all six derivatives with central differences. Returns the number compared.
fn compare_with_differences(view: &View, seed: u64) -> usize {
    let mut random = Random::new(seed);
    let scene = small_scene(&mut random, 6, 16);
    let weights = random_weights(&mut random, view);
    let pose = backward(&scene, view, &render(&scene, view), &weights).pose;
    let step = 1e-6;
    let comparable = |axis: &usize| {
        let at = |by| decisions(&scene, &moved_view(view, along(*axis, by)));
        at(step) == at(-step)
    };
    let largest = pose.iter().fold(0.0, |most: f64, x| most.max(x.abs()));
    let mut compared = 0;
    for axis in (0..6).filter(comparable) {
        let at = |by| linear_loss(&scene, &moved_view(view, along(axis, by)), &weights);
        let difference = (at(step) - at(-step)) / (2.0 * step);
        let error = (difference - pose[axis]).abs();
        assert!(
            error <= 1e-6 * largest + 2e-6 * pose[axis].abs(),
            "seed {seed}, axis {axis}: {:.9e}, by differences {difference:.9e}",
            pose[axis]
        );
        compared += 1;
    }
    compared
}

#[test]
fn poses_of_the_twin_agree_with_finite_differences() {
    for extent in [Extent::Exact, Extent::Reference] {
        for antialias in [false, true] {
            let view = View { extent, antialias, ..small_view([40, 24]) };
            let compared: usize = (0..10).map(|seed| compare_with_differences(&view, seed)).sum();
            assert!(compared > 20, "only {compared} of 60 derivatives could be compared");
        }
    }
    // A narrow view of a wide scene: many centres beyond the limits of the linearisation.
    for symmetric_limit in [false, true] {
        let view =
            View { symmetric_limit, focal_px: [60.0, 55.0], center_px: [9.0, 6.5], ..small_view([20, 12]) };
        let compared: usize = (10..20).map(|seed| compare_with_differences(&view, seed)).sum();
        assert!(compared > 20, "only {compared} of 60 derivatives could be compared");
    }
}

/// Weights at stable pixels, rounded to float32; zero at pixels whose decisions depend on rounding.
fn stable_weights(random: &mut Random, scene: &[Gaussian], view: &View) -> Vec<PixelGradient> {
    let frame = render(scene, view);
    let mut weights = random_weights(random, view);
    for (pixel, weight) in pixels_of(view).zip(&mut weights) {
        let list: Vec<&Splat> = frame.lists[tile_of(view, pixel)]
            .iter()
            .map(|&g| frame.splats[g as usize].as_ref().expect("listed"))
            .collect();
        if is_unstable(&list, pixel, 2e-5) {
            *weight = PixelGradient::default();
        }
        weight.color = weight.color.map(|x| f64::from(x as f32));
    }
    weights
}

fn compare_with_device(renderer: &mut Renderer, view: &View, (count, seed): (usize, u64)) {
    let mut random = Random::new(seed);
    let scene = small_scene(&mut random, count, 16);
    let weights = stable_weights(&mut random, &scene, view);
    let expected = backward(&scene, view, &render(&scene, view), &weights).pose;
    let color: Vec<[f32; 3]> = weights.iter().map(|w| w.color.map(|x| x as f32)).collect();
    let inverse_depth: Vec<f32> = weights.iter().map(|w| w.inverse_depth as f32).collect();
    renderer.upload(&engine::gaussians(&scene)).expect("upload");
    let (camera, settings) = (camera(view), settings(view));
    let mut gradients =
        || renderer.gradients_with_pose(&camera, &settings, &color, Some(&inverse_depth)).expect("gradients");
    let first = gradients();
    assert!(first == gradients(), "other bits");
    let actual = first.pose.expect("a gradient of the pose").map(f64::from);
    let largest = expected.iter().fold(0.0, |most: f64, x| most.max(x.abs()));
    elementwise("pose", &actual, &expected, 1e-4 * largest, 0.0).expect("the pose's gradient");
    // All other gradients equal those without it.
    let plain = renderer.gradients(&camera, &settings, &color, Some(&inverse_depth)).expect("gradients");
    assert!(plain.pose.is_none());
    for (a, b) in derivatives(&plain).into_iter().zip(derivatives(&first)) {
        assert_alike(renderer.context(), a, b, ("gradients beside the pose's", 1e-5));
    }
}

#[test]
fn poses_of_the_device_agree_with_the_twin() {
    let gpu = Gpu::new();
    let mut renderer = engine::renderer();
    for seed in 0..2 {
        for extent in [Extent::Exact, Extent::Reference] {
            for (antialias, sh_degree) in [(false, 3), (true, 1), (false, 0)] {
                let view = View { extent, antialias, sh_degree, ..small_view([90, 60]) };
                compare_with_device(&mut renderer, &view, (150, 100 + seed));
            }
        }
    }
    drop((renderer, gpu));
}

/// Each range of parameters adds its part.
#[test]
fn poses_of_a_scene_in_several_buffers() {
    let limits = LimitsOverride { max_storage_buffer_range: Some(100_000), ..LimitsOverride::default() };
    let context =
        Context::new(&ContextOptions { limits_override: Some(limits), ..options() }).expect("a device");
    let mut renderer = Renderer::new(&context).expect("a renderer");
    compare_with_device(&mut renderer, &small_view([60, 40]), (1200, 7));
    crate::common::assert_silent(&context);
}

#[test]
fn poses_without_anything_to_see_have_no_gradient() {
    let gpu = Gpu::new();
    let view = View { translation: [0.0, 0.0, -50.0], ..small_view([40, 30]) };
    let mut renderer = engine::renderer();
    for count in [1, 2, 9, 40] {
        let scene = engine::gaussians(&small_scene(&mut Random::new(1), count, 1));
        renderer.upload(&scene).expect("upload");
        let target = vec![[1.0; 3]; 40 * 30];
        let gradients = renderer.gradients_with_pose(&camera(&view), &settings(&view), &target, None);
        assert_eq!(gradients.expect("gradients").pose, Some([0.0; 6]));
    }
    drop((renderer, gpu));
}

/// L = Σ pixel · weight with smooth weights, by the public renderer.
fn loss(renderer: &mut Renderer, view: &View, settings: &RenderSettings, weights: &[[f32; 3]]) -> f64 {
    let frame = renderer.render(&camera(view), settings).expect("a frame");
    let terms = frame.color.iter().zip(weights);
    terms.flat_map(|(c, w)| [0, 1, 2].map(|i| f64::from(c[i]) * f64::from(w[i]))).sum()
}

/// The public renderer's pictures change as its gradient predicts, within float32 rounding and the jumps at 1/255.
#[test]
fn poses_agree_with_differences_of_pictures() {
    let gpu = Gpu::new();
    let view = small_view([160, 120]);
    let mut scene: Gaussians = engine::gaussians(&small_scene(&mut Random::new(21), 12, 16));
    // Edges at 1/255 move as well, so Gaussians are opaque. Their depths are apart, because pictures jump when the
    // order changes.
    scene.opacity_logits.iter_mut().for_each(|logit| *logit = logit.max(3.0));
    scene.means.iter_mut().zip(0..).for_each(|(mean, i)| *mean = [mean[0], mean[1], 0.3 * i as f32 - 1.8]);
    let mut renderer = engine::renderer();
    renderer.upload(&scene).expect("upload");
    let settings = RenderSettings { inverse_depth: false, ..settings(&view) };
    let weights: Vec<[f32; 3]> = pixels_of(&view)
        .map(|[x, y]| {
            let (x, y) = (x as f32 / 160.0, y as f32 / 120.0);
            [x * y, (3.0 * x).sin() * y, 1.0 - x]
        })
        .collect();
    let gradients = renderer.gradients_with_pose(&camera(&view), &settings, &weights, None);
    let pose = gradients.expect("gradients").pose.expect("a pose").map(f64::from);
    let largest = pose.iter().fold(0.0, |most: f64, x| most.max(x.abs()));
    let step = 2e-3;
    for (axis, derivative) in pose.into_iter().enumerate() {
        let mut at = |by| loss(&mut renderer, &moved_view(&view, along(axis, by)), &settings, &weights);
        let difference = (at(step) - at(-step)) / (2.0 * step);
        let error = (difference - derivative).abs() / largest;
        assert!(error < 0.02, "axis {axis}: {} by differences, {} as a gradient", difference, derivative);
    }
    drop((renderer, gpu));
}
