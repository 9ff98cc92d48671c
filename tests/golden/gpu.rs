//! Trials of the device, with tolerances for float32.

use std::path::Path;

use ashsplat::RenderSettings;
use libtest_mimic::Trial;

use super::rendering::{Gradients, Picture, SINGLE, judge_gradients, judge_picture};
use super::sets::RenderingSet;
use super::{
    Kind, SetFile, absgrad, antialias, budget, depth, exposure, gpu_training, importance, lpips, mcmc, poses,
    sparse_depth, trial,
};
use crate::common::engine::{camera, gaussians, renderer, settings, widen};
use crate::common::{assert_silent, context};
use crate::reference::types::Extent;

/// The trials of one set.
pub fn trials(set: &SetFile) -> Vec<Trial> {
    match set.kind {
        Kind::Rendering => rendering_trials(set),
        Kind::Loss => vec![of_file(set, "loss", gpu_training::loss)],
        Kind::Adam => vec![of_file(set, "adam", gpu_training::adam)],
        Kind::Rates => vec![of_file(set, "rates", gpu_training::rates)],
        Kind::Densify => vec![of_file(set, "densify", gpu_training::densify)],
        Kind::ResetOpacity => vec![of_file(set, "reset_opacity", gpu_training::reset_opacity)],
        Kind::Train => vec![of_file(set, "train", gpu_training::train)],
        Kind::Regularizers => vec![
            of_file(set, "regularizers", gpu_training::regularizers),
            of_file(set, "noise", mcmc::noise_of_device),
        ],
        Kind::Relocation => vec![of_file(set, "relocation", mcmc::relocation_of_device)],
        Kind::Antialias => vec![of_file(set, "antialias", antialias::of_device)],
        Kind::Filter3d => vec![of_file(set, "filter", antialias::filter_of_device)],
        Kind::AbsoluteGradient => vec![of_file(set, "absgrad", absgrad::of_device)],
        Kind::EdgeImportance => vec![of_file(set, "importance", importance::of_device)],
        Kind::LongAxisSplit => vec![of_file(set, "long_axis_split", budget::split_of_device)],
        Kind::GrowthSchedule => vec![of_file(set, "growth_schedule", budget::schedule_of_engine)],
        Kind::Exposure => vec![of_file(set, "exposure", exposure::of_device)],
        Kind::Depth => vec![of_file(set, "depth", depth::of_device)],
        Kind::SparseDepth => vec![of_file(set, "sparse_depth", sparse_depth::of_device)],
        Kind::Lpips => vec![of_file(set, "distance", lpips::of_device)],
        Kind::Poses => vec![of_file(set, "poses", poses::of_device)],
        Kind::Initial | Kind::Unknown => vec![],
    }
}

fn of_file(set: &SetFile, what: &str, check: fn(&Path) -> Result<(), String>) -> Trial {
    let path = set.path.clone();
    trial(format!("golden_gpu_{what}_{}", set.name), move || check(&path))
}

fn rendering_trials(set: &SetFile) -> Vec<Trial> {
    let mut trials = Vec::new();
    for extent in [Extent::Reference, Extent::Exact] {
        if extent == Extent::Exact && set.exact.is_none() {
            continue;
        }
        let suffix = if extent == Extent::Exact { "exact_" } else { "" };
        let file = set.clone();
        trials
            .push(trial(format!("golden_gpu_forward_{suffix}{}", set.name), move || forward(&file, extent)));
        let file = set.clone();
        trials.push(trial(format!("golden_gpu_gradients_{suffix}{}", set.name), move || {
            check_gradients(&file, extent)
        }));
    }
    trials
}

fn forward(file: &SetFile, extent: Extent) -> Result<(), String> {
    let set = RenderingSet::read(&file.path, file.exact.as_deref());
    let view = set.view_with(extent);
    let mut renderer = renderer();
    renderer.upload(&gaussians(&set.gaussians)).map_err(|e| e.to_string())?;
    // Both variants of the kernel: with inverse depth if the set has it.
    let inverse_depth = set.results(extent).has("inv_depth");
    let settings = RenderSettings { inverse_depth, ..settings(&view) };
    let frame = renderer.render(&camera(&view), &settings).map_err(|e| e.to_string())?;
    drop(renderer);
    judge_picture(&file.name, &set, extent, &picture(&frame), SINGLE)?;
    if extent == Extent::Reference && !super::rendering::only_finite(&file.name) {
        judge_instances(&set, frame.stats.instances)?;
    }
    assert_silent(context());
    Ok(())
}

/// The tiles touched are equal, except those of Gaussians whose rectangle depends on rounding.
fn judge_instances(set: &RenderingSet, instances: u32) -> Result<(), String> {
    let unstable = set.gaussian_flag(2);
    let touched = set.npz.values("tiles_touched");
    let expected: f64 = touched.iter().sum();
    let slack: f64 =
        touched.iter().zip(unstable).filter(|(_, unstable)| *unstable).map(|(n, _)| n + 1.0).sum();
    let off = (f64::from(instances) - expected).abs();
    if off <= slack {
        Ok(())
    } else {
        Err(format!("{instances} tiles touched, expected {expected} ± {slack}"))
    }
}

fn check_gradients(file: &SetFile, extent: Extent) -> Result<(), String> {
    let set = RenderingSet::read(&file.path, file.exact.as_deref());
    let view = set.view_with(extent);
    let (color, inverse_depth) = set.image_gradient(extent);
    let color: Vec<[f32; 3]> = color.iter().map(|c| c.map(|x| x as f32)).collect();
    let inverse_depth: Vec<f32> = inverse_depth.iter().map(|&x| x as f32).collect();
    let mut renderer = renderer();
    renderer.upload(&gaussians(&set.gaussians)).map_err(|e| e.to_string())?;
    // Both variants of the kernels: with inverse depth if it has a gradient.
    let inverse_depth = set.results(extent).has("Gd").then_some(inverse_depth);
    let settings = RenderSettings { inverse_depth: inverse_depth.is_some(), ..settings(&view) };
    let derivatives = renderer
        .gradients(&camera(&view), &settings, &color, inverse_depth.as_deref())
        .map_err(|e| e.to_string())?;
    drop(renderer);
    judge_gradients(&file.name, &set, extent, &gradients(&derivatives), SINGLE)?;
    assert_silent(context());
    Ok(())
}

/// Converts a frame of the engine for the judge.
pub(super) fn picture(frame: &ashsplat::Frame) -> Picture {
    let single = |values: &[f32]| values.iter().map(|&x| f64::from(x)).collect::<Vec<f64>>();
    Picture {
        color: widen(&frame.color),
        transmittance: single(&frame.transmittance),
        inverse_depth: frame.inverse_depth.as_deref().map(single),
    }
}

/// Converts gradients of the engine for the judge.
pub(super) fn gradients(gradients: &ashsplat::Gradients) -> Gradients {
    let parameters = &gradients.parameters;
    Gradients {
        means: widen(&parameters.means),
        quats: widen(&parameters.quats),
        log_scales: widen(&parameters.log_scales),
        opacity_logits: parameters.opacity_logits.iter().map(|&x| f64::from(x)).collect(),
        sh: widen(&parameters.sh),
        mean2d_px: Some(widen(&gradients.mean2d_px)),
        conic: None,
        opacity: None,
        color: None,
    }
}
