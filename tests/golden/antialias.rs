//! Antialiasing: size of the low-pass filter, its compensation with both gradients, and the 3D filter
//! (spec_training.md, 7).

use super::Outcome;
use super::rendering::{DOUBLE, SINGLE, judge_gradients, judge_picture};
use super::sets::{EXTENTS, RenderingSet, views};
use super::{gpu, twin};
use crate::common::engine::settings;
use crate::common::prelude::*;
use crate::reference::filter_sizes::{filter_sizes, filtered, filtered_backward, shrink};
use crate::reference::linear::sigmoid;
use crate::reference::nearest_depths::nearest_depth;
use crate::reference::pipeline::{Frame, FrameGradient, backward, render};
use crate::reference::project::intermediate;
use crate::reference::reset_opacity::reset_opacity;
use ashsplat::scene::filtered as baked;
use std::path::Path;

const NAME: &str = "antialias";

pub fn of_twin(path: &Path) -> Outcome {
    let set = RenderingSet::of_feature(path);
    for (extent, _) in EXTENTS {
        let view = set.view_with(extent);
        let (frame, gradient) = rendered(&set, &set.gaussians, &view, extent);
        judge(&set, extent, &frame, gradient)?;
    }
    check_factors(&set, &set.gaussians)
}

pub fn of_device(path: &Path) -> Outcome {
    let set = RenderingSet::of_feature(path);
    let mut renderer = renderer();
    renderer.upload(&gaussians(&set.gaussians))?;
    EXTENTS.into_iter().try_for_each(|(extent, _)| {
        let view = set.view_with(extent);
        judge_device(&mut renderer, &set, extent, &settings(&view))
    })
}

/// Filter sizes, filtered Gaussians, gradients of filtered and stored Gaussians, opacity reset.
pub fn filter_of_twin(path: &Path) -> Outcome {
    let set = RenderingSet::of_feature(path);
    let npz = &set.npz;
    let sizes = sizes_of_twin(&set);
    relative("filter", &sizes, npz.values("filter"), 2e-7)?;
    let stored = npz.values("filter");
    let drawn: Vec<Gaussian> = set.gaussians.iter().zip(stored).map(|(g, &size)| filtered(g, size)).collect();
    let log_scales: Vec<f64> = drawn.iter().flat_map(|g| g.log_scale).collect();
    let logits: Vec<f64> = drawn.iter().map(|g| g.opacity_logit).collect();
    let shrinks: Vec<f64> = set.gaussians.iter().zip(stored).map(|(g, &size)| shrink(g, size)).collect();
    elementwise("coefficient", &shrinks, npz.values("coefficient"), 1e-7, 2e-7)?;
    elementwise("fused_log_scales", &log_scales, npz.values("fused_log_scales"), 2e-7, 2e-7)?;
    elementwise("fused_opacity_logits", &logits, npz.values("fused_opacity_logits"), 2e-7, 2e-7)?;
    let reset: Vec<f64> = set
        .gaussians
        .iter()
        .zip(&shrinks)
        .map(|(g, &shrink)| reset_opacity(g.opacity_logit, shrink))
        .collect();
    elementwise("reset_opacity_logits", &reset, npz.values("reset_opacity_logits"), 2e-7, 2e-7)?;
    for (extent, _) in EXTENTS {
        let view = set.view_with(extent);
        let (frame, gradient) = rendered(&set, &drawn, &view, extent);
        if extent == Extent::Exact {
            let results = set.results(extent);
            let d_scales: Vec<f64> = gradient.parameters.iter().flat_map(|g| g.log_scale).collect();
            let d_logits: Vec<f64> = gradient.parameters.iter().map(|g| g.opacity_logit).collect();
            relative("df_log_scales", &d_scales, results.values("df_log_scales"), 1e-6)?;
            relative("df_opacity_logits", &d_logits, results.values("df_opacity_logits"), 1e-6)?;
        }
        let through = |i: usize| -> Gradient {
            let opacity = sigmoid(drawn[i].opacity_logit);
            let mut d = gradient.parameters[i].clone();
            let d_opacity = d.opacity_logit / (opacity * (1.0 - opacity));
            filtered_backward(&set.gaussians[i], stored[i], d_opacity, &mut d);
            d
        };
        let parameters: Vec<Gradient> = (0..drawn.len()).map(through).collect();
        judge(&set, extent, &frame, FrameGradient { parameters, ..gradient })?;
    }
    check_factors(&set, &drawn)
}

/// Filter sizes from all cameras, pictures and gradients of the device; filtered Gaussians of the host.
pub fn filter_of_device(path: &Path) -> Outcome {
    let set = RenderingSet::of_feature(path);
    let npz = &set.npz;
    let cameras: Vec<_> = views(npz).iter().map(camera).collect();
    let stored = gaussians(&set.gaussians);
    let mut renderer = renderer();
    renderer.upload(&stored)?;
    renderer.compute_filters(&cameras)?;
    let sizes = renderer.filters()?;
    let wide: Vec<f64> = sizes.iter().map(|&size| f64::from(size)).collect();
    relative("filter", &wide, npz.values("filter"), 1e-6)?;
    let mut drawn = stored.clone();
    drawn.bake_filters(&sizes)?;
    let logits: Vec<f64> = drawn.opacity_logits.iter().map(|&x| f64::from(x)).collect();
    elementwise("fused_log_scales", &widen(&drawn.log_scales), npz.values("fused_log_scales"), 1e-5, 1e-5)?;
    elementwise("fused_opacity_logits", &logits, npz.values("fused_opacity_logits"), 1e-5, 1e-5)?;
    assert_eq!(baked(stored.log_scales[0], stored.opacity_logits[0], sizes[0]).0, drawn.log_scales[0]);
    for (extent, _) in EXTENTS {
        let settings = RenderSettings { filter_3d: true, ..settings(&set.view_with(extent)) };
        judge_device(&mut renderer, &set, extent, &settings)?;
    }
    // The filtered Gaussians give the same picture without a filter.
    renderer.upload(&drawn)?;
    let settings = settings(&set.view_with(Extent::Exact));
    let frame = renderer.render(&camera(&set.view), &settings)?;
    drop(renderer);
    Ok(judge_picture(NAME, &set, Extent::Exact, &gpu::picture(&frame), SINGLE)?)
}

fn sizes_of_twin(set: &RenderingSet) -> Vec<f64> {
    let cameras = views(&set.npz);
    let nearest: Vec<Option<f64>> = set.gaussians.iter().map(|g| nearest_depth(g.mean, &cameras)).collect();
    let seen: Vec<bool> = nearest.iter().map(Option::is_some).collect();
    equal("seen", &seen, &set.npz.flags("seen")).expect("the same Gaussians are seen");
    let longest = cameras.iter().map(|view| view.focal_px[0]).fold(0.0, f64::max);
    filter_sizes(&nearest, longest)
}

/// A frame, and the gradient of its pixels' sum weighted by the set's values.
fn rendered(
    set: &RenderingSet,
    gaussians: &[Gaussian],
    view: &View,
    extent: Extent,
) -> (Frame, FrameGradient) {
    let frame = render(gaussians, view);
    let gradient = backward(gaussians, view, &frame, &set.image_gradient(extent));
    (frame, gradient)
}

fn judge(set: &RenderingSet, extent: Extent, frame: &Frame, gradient: FrameGradient) -> Outcome {
    judge_picture(NAME, set, extent, &twin::picture(frame), DOUBLE)?;
    Ok(judge_gradients(NAME, set, extent, &twin::gradients(&gradient), DOUBLE)?)
}

/// Compares the filtered Gaussians' opacity factors and dilated covariances with the set's.
fn check_factors(set: &RenderingSet, drawn: &[Gaussian]) -> Outcome {
    let (expected, cov2d) = (set.npz.values("factor"), set.npz.rows::<3>("cov2d"));
    for (i, gaussian) in drawn.iter().enumerate() {
        let Some(on_the_way) = intermediate(gaussian, &set.view) else { continue };
        let [a, b, c] = on_the_way.cov2d_undilated;
        let dilation = on_the_way.dilation_px2;
        relative("factor", &[on_the_way.compensation.0], &expected[i..=i], 1e-6)?;
        relative("cov2d", &[a + dilation, b, c + dilation], &cov2d[i], 1e-6)?;
    }
    Ok(())
}

fn judge_device(
    renderer: &mut Renderer,
    set: &RenderingSet,
    extent: Extent,
    settings: &RenderSettings,
) -> Outcome {
    let settings = RenderSettings { inverse_depth: false, ..*settings };
    let camera = camera(&set.view);
    let frame = renderer.render(&camera, &settings)?;
    judge_picture(NAME, set, extent, &gpu::picture(&frame), SINGLE)?;
    let pixels = set.image_gradient(extent);
    let color: Vec<[f32; 3]> = pixels.iter().map(|d| d.color.map(|x| x as f32)).collect();
    let gradients = renderer.gradients(&camera, &settings, &color, None)?;
    judge_gradients(NAME, set, extent, &gpu::gradients(&gradients), SINGLE)?;
    assert_silent(context());
    Ok(())
}
