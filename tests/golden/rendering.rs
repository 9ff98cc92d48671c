//! Checks of a renderer's picture and gradients on a rendering set.

use super::sets::RenderingSet;
use crate::common::compare::{GradientTolerance, PixelTolerance, gradient, pixels};
use crate::reference::types::Extent;

pub struct Picture {
    /// rgb interleaved.
    pub color: Vec<f64>,
    /// Transmittance left.
    pub transmittance: Vec<f64>,
    /// Σ α T / z.
    pub inverse_depth: Option<Vec<f64>>,
}

/// Flattened gradients.
pub struct Gradients {
    pub means: Vec<f64>,
    pub quats: Vec<f64>,
    pub log_scales: Vec<f64>,
    pub opacity_logits: Vec<f64>,
    pub sh: Vec<f64>,
    pub mean2d_px: Vec<f64>,
}

#[derive(Clone, Copy)]
pub struct Tolerance {
    pub image: PixelTolerance,
    pub transmittance: PixelTolerance,
    pub gradient: GradientTolerance,
    /// Tolerance of the quaternions of needles.
    pub quats: GradientTolerance,
}

/// Tolerances of float32 implementations.
pub const SINGLE: Tolerance = Tolerance {
    image: PixelTolerance { max: 5e-5, mean: 1e-6, unstable: 2e-2 },
    transmittance: PixelTolerance { max: 5e-5, mean: 5e-5, unstable: 2e-2 },
    gradient: GradientTolerance { relative_l2: 1e-4, max_over_max: 2e-4 },
    quats: GradientTolerance { relative_l2: 5e-4, max_over_max: 5e-4 },
};

/// True for a set that is checked only for finiteness, because its 2-D determinant cancels in float32.
pub fn only_finite(set: &str) -> bool {
    set == "s11_needle"
}

pub fn judge_picture(
    name: &str,
    set: &RenderingSet,
    extent: Extent,
    picture: &Picture,
) -> Result<(), String> {
    if only_finite(name) {
        return all_finite("image", &picture.color);
    }
    let results = set.results(extent);
    let unstable = results.flags("pix_unstable");
    pixels("image", &picture.color, results.values("image"), &unstable, SINGLE.image)?;
    pixels(
        "transmittance",
        &picture.transmittance,
        results.values("final_T"),
        &unstable,
        SINGLE.transmittance,
    )?;
    if let Some(inverse_depth) = picture.inverse_depth.as_ref().filter(|_| results.has("inv_depth")) {
        // The bound scales with the largest value. Unstable pixels have none: an extra entry that changes the colour
        // by 0.02 changes the inverse depth near the near plane five times as much.
        let largest = results.values("inv_depth").iter().copied().fold(1.0, f64::max);
        let PixelTolerance { max, mean, .. } = SINGLE.image;
        let bound = PixelTolerance { max: max * largest, mean: mean * largest, unstable: f64::INFINITY };
        pixels("inverse depth", inverse_depth, results.values("inv_depth"), &unstable, bound)?;
    }
    Ok(())
}

/// Name, values, Gaussians to skip, bounds.
type Field<'a> = (&'a str, &'a [f64], &'a [bool], GradientTolerance);

pub fn judge_gradients(
    name: &str,
    set: &RenderingSet,
    extent: Extent,
    actual: &Gradients,
) -> Result<(), String> {
    let results = set.results(extent);
    let count = set.gaussians.len();
    let none = vec![false; count];
    let clamp = set.gaussian_flag(4);
    let saturated: Vec<bool> = set.gaussians.iter().map(|g| g.opacity_logit.abs() > 16.0).collect();
    let size = set.view.size_px.map(|n| f64::from(n) / 2.0);
    let ndc: Vec<f64> = actual.mean2d_px.chunks(2).flat_map(|d| [d[0] * size[0], d[1] * size[1]]).collect();
    let fields: [Field; 7] = [
        ("means", &actual.means, &none, SINGLE.gradient),
        ("quats", &actual.quats, &none, SINGLE.quats),
        ("log_scales", &actual.log_scales, &none, SINGLE.gradient),
        ("opacity_logits", &actual.opacity_logits, &saturated, SINGLE.gradient),
        ("sh", &actual.sh, &clamp, SINGLE.gradient),
        ("xy_pix", &actual.mean2d_px, &none, SINGLE.gradient),
        ("xy_ndc", &ndc, &none, SINGLE.gradient),
    ];
    for (field, values, skip, tolerance) in fields {
        let Some(expected) = expected_gradient(set, extent, field) else { continue };
        if only_finite(name) {
            all_finite(field, values)?;
            continue;
        }
        let expected_values = results.values(&expected);
        if field == "quats" && expected_values.iter().all(|&d| d == 0.0) {
            zero_quats(values, &actual.log_scales, tolerance)?;
            continue;
        }
        gradient(&format!("d_{field}"), values, expected_values, skip, tolerance)?;
    }
    Ok(())
}

/// Name of the field with the exact derivative: `dx_*`, or `d_*` if both are equal. INRIA's intermediate gradients
/// differ where the clamp at 0.99 acts. They are used only if the exact derivative of the opacity equals INRIA's, so
/// nothing is clamped.
fn expected_gradient(set: &RenderingSet, extent: Extent, field: &str) -> Option<String> {
    let results = set.results(extent);
    let (exact, inria) = (format!("dx_{field}"), format!("d_{field}"));
    if results.has(&exact) {
        return Some(exact);
    }
    let same_derivative = ["opacity_logits", "means"].iter().all(|name| {
        let (exact, inria) = (format!("dx_{name}"), format!("d_{name}"));
        !results.has(&exact) || (results.has(&inria) && results.values(&exact) == results.values(&inria))
    });
    let stored_only_when_different =
        ["means", "quats", "log_scales", "opacity_logits", "sh"].contains(&field);
    (results.has(&inria) && (stored_only_when_different || same_derivative)).then_some(inria)
}

/// Isotropic Gaussians have no orientation, but cancellation leaves rounding errors. The gradient of the log-scales
/// bounds them.
fn zero_quats(quats: &[f64], log_scales: &[f64], tolerance: GradientTolerance) -> Result<(), String> {
    let largest = |values: &[f64]| values.iter().fold(0.0_f64, |largest, x| largest.max(x.abs()));
    let within = largest(quats) <= tolerance.max_over_max * largest(log_scales);
    if within { Ok(()) } else { Err(format!("d_quats of isotropic Gaussians: {:.3e}", largest(quats))) }
}

fn all_finite(what: &str, values: &[f64]) -> Result<(), String> {
    match values.iter().position(|x| !x.is_finite()) {
        Some(i) => Err(format!("{what}: value {i} is {}", values[i])),
        None => Ok(()),
    }
}
