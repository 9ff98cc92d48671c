//! Trials of the twins: they must match the vectors up to the rounding of stored float32.

use super::rendering::{DOUBLE, Gradients, Picture, judge_gradients, judge_picture, only_finite};
use super::sets::RenderingSet;
use super::{Outcome, SetFile};
use crate::common::compare::{elementwise, equal};
use crate::reference::pipeline::{Frame, FrameGradient, backward, render};
use crate::reference::types::Extent;
use libtest_mimic::Trial;

pub fn trials(set: &SetFile) -> Vec<Trial> {
    let trial = |extent| {
        let (file, suffix) = (set.clone(), if extent == Extent::Exact { "exact_" } else { "" });
        Trial::test(format!("golden_twin_{suffix}{}", set.name), move || check(&file, extent))
    };
    set.extents().map(trial).collect()
}

fn check(file: &SetFile, extent: Extent) -> Outcome {
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
    let gradient = backward(&set.gaussians, &view, &frame, &set.image_gradient(extent));
    Ok(judge_gradients(&file.name, &set, extent, &gradients(&gradient), DOUBLE)?)
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
fn judge_counts(set: &RenderingSet, extent: Extent, frame: &Frame) -> Outcome {
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

fn judge_splats(set: &RenderingSet, frame: &Frame) -> Outcome {
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
