//! Trials of the twins: they must match the vectors up to the rounding of stored float32.

use libtest_mimic::Trial;

use super::rendering::{DOUBLE, Gradients, Picture, SINGLE, judge_gradients, judge_picture, only_finite};
use super::sets::RenderingSet;
use super::{
    Kind, SetFile, absgrad, antialias, budget, depth, exposure, importance, lpips, mcmc, poses, sparse_depth,
    training, trial,
};
use crate::common::compare::{elementwise, equal};
use crate::reference::blend_backward::PixelGradient;
use crate::reference::pipeline::{Frame, FrameGradient, backward, render};
use crate::reference::types::Extent;

/// The trials of one set.
pub fn trials(set: &SetFile) -> Vec<Trial> {
    let name = &set.name;
    let file = set.clone();
    match set.kind {
        Kind::Rendering => rendering_trials(set),
        Kind::Loss => vec![trial(format!("golden_twin_loss_{name}"), move || training::loss(&file.path))],
        Kind::Adam => vec![trial(format!("golden_twin_adam_{name}"), move || training::adam(&file.path))],
        Kind::Rates => vec![trial(format!("golden_twin_rates_{name}"), move || training::rates(&file.path))],
        Kind::Densify => {
            vec![trial(format!("golden_twin_densify_{name}"), move || training::densify(&file.path))]
        }
        Kind::ResetOpacity => {
            vec![trial(format!("golden_twin_reset_opacity_{name}"), move || {
                training::reset_opacity(&file.path)
            })]
        }
        Kind::Train => vec![trial(format!("golden_twin_train_{name}"), move || training::train(&file.path))],
        Kind::Regularizers => {
            let noise = file.clone();
            vec![
                trial(format!("golden_twin_regularizers_{name}"), move || training::regularizers(&file.path)),
                trial(format!("golden_twin_noise_{name}"), move || mcmc::noise_of_twin(&noise.path)),
            ]
        }
        Kind::Relocation => {
            vec![trial(format!("golden_twin_relocation_{name}"), move || {
                mcmc::relocation_of_twin(&file.path)
            })]
        }
        Kind::Antialias => {
            vec![trial(format!("golden_twin_antialias_{name}"), move || antialias::of_twin(&file.path))]
        }
        Kind::Filter3d => {
            vec![trial(format!("golden_twin_filter_{name}"), move || antialias::filter_of_twin(&file.path))]
        }
        Kind::AbsoluteGradient => {
            vec![trial(format!("golden_twin_absgrad_{name}"), move || absgrad::of_twin(&file.path))]
        }
        Kind::EdgeImportance => {
            vec![trial(format!("golden_twin_importance_{name}"), move || importance::of_twin(&file.path))]
        }
        Kind::LongAxisSplit => {
            vec![trial(format!("golden_twin_long_axis_split_{name}"), move || {
                budget::split_of_twin(&file.path)
            })]
        }
        Kind::GrowthSchedule => {
            vec![trial(format!("golden_twin_growth_schedule_{name}"), move || {
                budget::schedule_of_twin(&file.path)
            })]
        }
        Kind::Exposure => {
            vec![trial(format!("golden_twin_exposure_{name}"), move || exposure::of_twin(&file.path))]
        }
        Kind::Depth => {
            let host = file.clone();
            vec![
                trial(format!("golden_twin_depth_{name}"), move || depth::of_twin(&file.path)),
                trial(format!("golden_host_depth_{name}"), move || depth::of_host(&host.path)),
            ]
        }
        Kind::SparseDepth => {
            vec![trial(format!("golden_twin_sparse_{name}"), move || sparse_depth::of_twin(&file.path))]
        }
        Kind::Lpips => vec![trial(format!("golden_twin_{name}"), move || lpips::of_twin(&file.path))],
        Kind::Poses => vec![trial(format!("golden_twin_poses_{name}"), move || poses::of_twin(&file.path))],
        Kind::Initial => vec![],
        Kind::Unknown => {
            vec![trial(format!("golden_unknown_{name}"), || Err("no test reads such a set".into()))]
        }
    }
}

fn rendering_trials(set: &SetFile) -> Vec<Trial> {
    let mut trials = Vec::new();
    if set.name == MUTATED {
        let file = set.clone();
        trials.push(trial("golden_judge_rejects_mutations".to_owned(), move || rejects_mutations(&file)));
    }
    for extent in [Extent::Reference, Extent::Exact] {
        if extent == Extent::Exact && set.exact.is_none() {
            continue;
        }
        let suffix = if extent == Extent::Exact { "exact_" } else { "" };
        let file = set.clone();
        trials.push(trial(format!("golden_twin_{suffix}{}", set.name), move || check(&file, extent)));
    }
    trials
}

fn check(file: &SetFile, extent: Extent) -> Result<(), String> {
    let set = RenderingSet::read(&file.path, file.exact.as_deref());
    let view = set.view_with(extent);
    let frame = render(&set.gaussians, &view);
    judge_picture(&file.name, &set, extent, &picture(&frame), DOUBLE)?;
    if !only_finite(&file.name) {
        judge_counts(&set, extent, &frame)?;
        if extent == Extent::Reference {
            judge_splats(&set, &frame)?;
        }
    }
    let (color, inverse_depth) = set.image_gradient(extent);
    let d_pixels: Vec<PixelGradient> = color
        .into_iter()
        .zip(inverse_depth)
        .map(|(color, inverse_depth)| PixelGradient { color, inverse_depth })
        .collect();
    let gradient = backward(&set.gaussians, &view, &frame, &d_pixels);
    judge_gradients(&file.name, &set, extent, &gradients(&gradient), DOUBLE)
}

/// Set whose results are mutated to prove that the judge can fail.
const MUTATED: &str = "s07_offcentre_edge";

/// Judges the twin's correct result, then copies with single faults, with the float32 tolerances.
fn rejects_mutations(file: &SetFile) -> Result<(), String> {
    let set = RenderingSet::read(&file.path, file.exact.as_deref());
    let extent = Extent::Reference;
    let view = set.view_with(extent);
    let frame = render(&set.gaussians, &view);
    let d_pixels: Vec<PixelGradient> = set
        .image_gradient(extent)
        .0
        .into_iter()
        .map(|color| PixelGradient { color, inverse_depth: 0.0 })
        .collect();
    let gradient = backward(&set.gaussians, &view, &frame, &d_pixels);
    let accepts_picture = |mutate: &dyn Fn(&mut Picture)| {
        let mut picture = picture(&frame);
        mutate(&mut picture);
        judge_picture(&file.name, &set, extent, &picture, SINGLE).is_ok()
    };
    let accepts_gradients = |mutate: &dyn Fn(&mut Gradients)| {
        let mut gradients = gradients(&gradient);
        mutate(&mut gradients);
        judge_gradients(&file.name, &set, extent, &gradients, SINGLE).is_ok()
    };
    let [a, b] = [0, 1].map(|nth| {
        let lit = gradient.parameters.iter().enumerate().filter(|(_, g)| g.opacity_logit.abs() > 1e-3);
        lit.map(|(index, _)| index).nth(nth).expect("the set has many visible Gaussians")
    });
    let verdicts = [
        ("the right picture", accepts_picture(&|_| ()), true),
        ("one value off by 1e-3", accepts_picture(&|p| p.color[600] += 1e-3), false),
        ("NaN", accepts_picture(&|p| p.color[600] = f64::NAN), false),
        ("transmittance off by 1e-3", accepts_picture(&|p| p.transmittance[600] -= 1e-3), false),
        ("a row shifted", accepts_picture(&|p| p.color[53 * 3 * 15..53 * 3 * 20].rotate_right(3)), false),
        ("the right gradients", accepts_gradients(&|_| ()), true),
        ("means scaled", accepts_gradients(&|g| g.means.iter_mut().for_each(|x| *x *= 1.001)), false),
        ("SH scaled", accepts_gradients(&|g| g.sh.iter_mut().for_each(|x| *x *= 1.001)), false),
        ("the sign of one opacity", accepts_gradients(&|g| g.opacity_logits[a] *= -1.0), false),
        ("two Gaussians swapped", accepts_gradients(&|g| g.opacity_logits.swap(a, b)), false),
        ("NaN in a quaternion", accepts_gradients(&|g| g.quats[4 * a] = f64::NAN), false),
    ];
    match verdicts.iter().find(|(_, accepted, right)| accepted != right) {
        Some((what, accepted, _)) => Err(format!("{what}: accepted = {accepted}")),
        None => Ok(()),
    }
}

pub(super) fn picture(frame: &Frame) -> Picture {
    Picture {
        color: frame.pixels.iter().flat_map(|p| p.color).collect(),
        transmittance: frame.pixels.iter().map(|p| p.transmittance).collect(),
        inverse_depth: Some(frame.pixels.iter().map(|p| p.inverse_depth).collect()),
    }
}

pub(super) fn gradients(gradient: &FrameGradient) -> Gradients {
    let (splats, parameters) = (&gradient.splats, &gradient.parameters);
    Gradients {
        means: parameters.iter().flat_map(|g| g.mean).collect(),
        quats: parameters.iter().flat_map(|g| g.quat).collect(),
        log_scales: parameters.iter().flat_map(|g| g.log_scale).collect(),
        opacity_logits: parameters.iter().map(|g| g.opacity_logit).collect(),
        sh: parameters.iter().flat_map(|g| g.sh.concat()).collect(),
        mean2d_px: Some(splats.iter().flat_map(|g| g.mean2d_px).collect()),
        conic: Some(splats.iter().flat_map(|g| g.conic).collect()),
        opacity: Some(splats.iter().map(|g| g.opacity).collect()),
        color: Some(splats.iter().flat_map(|g| g.color).collect()),
    }
}

/// Compares the number of entries blended, and with the reference extent the place of the last, at every stable
/// pixel.
fn judge_counts(set: &RenderingSet, extent: Extent, frame: &Frame) -> Result<(), String> {
    let results = set.results(extent);
    let stable: Vec<bool> = results.flags("pix_unstable").iter().map(|unstable| !unstable).collect();
    let at_stable = |values: Vec<f64>| -> Vec<f64> {
        values.into_iter().zip(&stable).filter(|(_, stable)| **stable).map(|(value, _)| value).collect()
    };
    let blended = frame.pixels.iter().map(|p| f64::from(p.blended)).collect();
    equal("number blended", &at_stable(blended), &at_stable(results.values("n_blended").to_vec()))?;
    if extent == Extent::Reference {
        let last = frame.pixels.iter().map(|p| f64::from(p.last)).collect();
        equal("place of the last", &at_stable(last), &at_stable(results.values("n_last").to_vec()))?;
    }
    Ok(())
}

/// Compares all stored values of the splats.
fn judge_splats(set: &RenderingSet, frame: &Frame) -> Result<(), String> {
    let npz = &set.npz;
    let touched: Vec<f64> = frame.tiles_touched.iter().map(|&n| f64::from(n)).collect();
    equal("tiles touched", &touched, npz.values("tiles_touched"))?;
    let of_splats = |value: &dyn Fn(&crate::reference::types::Splat) -> Vec<f64>, width: usize| -> Vec<f64> {
        frame.splats.iter().flat_map(|s| s.as_ref().map_or_else(|| vec![0.0; width], value)).collect()
    };
    equal("radius", &of_splats(&|s| vec![f64::from(s.radius_px)], 1), npz.values("radius"))?;
    let fields: [(&str, Vec<f64>); 5] = [
        ("xy", of_splats(&|s| s.mean2d_px.to_vec(), 2)),
        ("conic", of_splats(&|s| s.conic.to_vec(), 3)),
        ("color", of_splats(&|s| s.color.to_vec(), 3)),
        ("opacity", of_splats(&|s| vec![s.opacity], 1)),
        ("cov2d", of_splats(&|s| s.cov2d.to_vec(), 3)),
    ];
    for (field, values) in fields {
        if npz.has(field) {
            elementwise(field, &values, npz.values(field), 1e-12, 3e-7)?;
        }
    }
    Ok(())
}
