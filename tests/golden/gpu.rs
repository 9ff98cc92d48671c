//! Trials of the device, with tolerances for float32.

use super::rendering::{Gradients, Picture, judge_gradients, judge_picture};
use super::sets::RenderingSet;
use super::{Outcome, SetFile};
use crate::common::engine::settings;
use crate::common::prelude::*;
use libtest_mimic::Trial;

/// The trials of a rendering: picture and gradients of each extent.
pub fn trials(set: &SetFile) -> Vec<Trial> {
    let trial = |what: &str, extent: Extent, check: fn(&SetFile, Extent) -> Outcome| {
        let (file, suffix) = (set.clone(), if extent == Extent::Exact { "exact_" } else { "" });
        Trial::test(format!("golden_gpu_{what}_{suffix}{}", set.name), move || check(&file, extent))
    };
    let both = |extent| [trial("forward", extent, forward), trial("gradients", extent, check_gradients)];
    set.extents().flat_map(both).collect()
}

fn forward(file: &SetFile, extent: Extent) -> Outcome {
    let set = RenderingSet::read(&file.path, file.exact.as_deref());
    let view = set.view_with(extent);
    let mut renderer = renderer();
    renderer.upload(&gaussians(&set.gaussians))?;
    // Both variants of the kernel: with inverse depth if the set has it.
    let inverse_depth = set.results(extent).has("inv_depth");
    let settings = RenderSettings { inverse_depth, ..settings(&view) };
    let frame = renderer.render(&camera(&view), &settings)?;
    drop(renderer);
    judge_picture(&file.name, &set, extent, &picture(&frame))?;
    if extent == Extent::Reference && !super::rendering::only_finite(&file.name) {
        judge_instances(&set, frame.stats.instances)?;
    }
    assert_silent(context());
    Ok(())
}

/// The tiles touched are equal, except those of Gaussians whose rectangle depends on rounding.
fn judge_instances(set: &RenderingSet, instances: u32) -> Outcome {
    let unstable = set.gaussian_flag(2);
    let touched = set.npz.values("tiles_touched");
    let expected: f64 = touched.iter().sum();
    let slack: f64 =
        touched.iter().zip(unstable).filter(|(_, unstable)| *unstable).map(|(n, _)| n + 1.0).sum();
    let off = (f64::from(instances) - expected).abs();
    if off <= slack {
        Ok(())
    } else {
        Err(format!("{instances} tiles touched, expected {expected} ± {slack}").into())
    }
}

fn check_gradients(file: &SetFile, extent: Extent) -> Outcome {
    let set = RenderingSet::read(&file.path, file.exact.as_deref());
    let view = set.view_with(extent);
    let pixels = set.image_gradient(extent);
    let color: Vec<[f32; 3]> = pixels.iter().map(|d| d.color.map(|x| x as f32)).collect();
    let inverse_depth: Vec<f32> = pixels.iter().map(|d| d.inverse_depth as f32).collect();
    let mut renderer = renderer();
    renderer.upload(&gaussians(&set.gaussians))?;
    // Both variants of the kernels: with inverse depth if it has a gradient.
    let inverse_depth = set.results(extent).has("Gd").then_some(inverse_depth);
    let settings = RenderSettings { inverse_depth: inverse_depth.is_some(), ..settings(&view) };
    let derivatives = renderer.gradients(&camera(&view), &settings, &color, inverse_depth.as_deref())?;
    drop(renderer);
    judge_gradients(&file.name, &set, extent, &gradients(&derivatives))?;
    assert_silent(context());
    Ok(())
}

pub(super) fn picture(frame: &ashsplat::Frame) -> Picture {
    let single = |values: &[f32]| values.iter().map(|&x| f64::from(x)).collect::<Vec<f64>>();
    Picture {
        color: widen(&frame.color),
        transmittance: single(&frame.transmittance),
        inverse_depth: frame.inverse_depth.as_deref().map(single),
    }
}

pub(super) fn gradients(gradients: &ashsplat::Gradients) -> Gradients {
    let parameters = &gradients.parameters;
    Gradients {
        means: widen(&parameters.means),
        quats: widen(&parameters.quats),
        log_scales: widen(&parameters.log_scales),
        opacity_logits: parameters.opacity_logits.iter().map(|&x| f64::from(x)).collect(),
        sh: widen(&parameters.sh),
        mean2d_px: widen(&gradients.mean2d_px),
    }
}
