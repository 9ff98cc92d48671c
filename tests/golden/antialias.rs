//! Antialiasing: size of the low-pass filter, its compensation with both gradients, and the 3D filter
//! (spec_training.md, 7).

use super::Outcome;
use super::gpu;
use super::rendering::{judge_gradients, judge_picture};
use super::sets::{EXTENTS, RenderingSet, views};
use crate::common::engine::settings;
use crate::common::prelude::*;
use ashsplat::scene::filtered as baked;
use std::path::Path;

const NAME: &str = "antialias";

pub fn check(path: &Path) -> Outcome {
    let set = RenderingSet::of_feature(path);
    let mut renderer = renderer();
    renderer.upload(&gaussians(&set.gaussians))?;
    EXTENTS.into_iter().try_for_each(|(extent, _)| {
        let view = set.view_with(extent);
        judge(&mut renderer, &set, extent, &settings(&view))
    })
}

/// Filter sizes from all cameras, pictures and gradients of the device; filtered Gaussians of the host.
pub fn filter(path: &Path) -> Outcome {
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
        judge(&mut renderer, &set, extent, &settings)?;
    }
    // The filtered Gaussians give the same picture without a filter.
    renderer.upload(&drawn)?;
    let settings = settings(&set.view_with(Extent::Exact));
    let frame = renderer.render(&camera(&set.view), &settings)?;
    drop(renderer);
    Ok(judge_picture(NAME, &set, Extent::Exact, &gpu::picture(&frame))?)
}

fn judge(renderer: &mut Renderer, set: &RenderingSet, extent: Extent, settings: &RenderSettings) -> Outcome {
    let settings = RenderSettings { inverse_depth: false, ..*settings };
    let camera = camera(&set.view);
    let frame = renderer.render(&camera, &settings)?;
    judge_picture(NAME, set, extent, &gpu::picture(&frame))?;
    let pixels = set.image_gradient(extent);
    let color: Vec<[f32; 3]> = pixels.iter().map(|d| d.color.map(|x| x as f32)).collect();
    let gradients = renderer.gradients(&camera, &settings, &color, None)?;
    judge_gradients(NAME, set, extent, &gpu::gradients(&gradients))?;
    assert_silent(context());
    Ok(())
}
