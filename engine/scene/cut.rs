//! Selection of the Gaussians of a scene to show or keep: by opacity, density and a box.

use glam::Vec3;

use super::gaussians::Gaussians;
use super::points::Bounds;
use crate::error::{Error, Result};

/// Limits that remove Gaussians. The default removes none.
///
/// Files are cut on the host ([`CutLimits::keeps`]), frames on the device
/// ([`RenderSettings::cut`](crate::RenderSettings::cut)).
/// Both compare the same numbers in the same way, so both keep the same Gaussians.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Cut {
    /// Minimum opacity, 0 to 1.
    pub min_opacity: f32,
    /// Box that contains the remaining means; sides may be infinite.
    pub bounds: Option<Bounds>,
    /// Minimum [`density`](Gaussians::log_density), per world unit; 0 for no limit. Floaters are faint for their size: fog has
    /// at most a hundredth of a trained scene's median density.
    pub min_density: f32,
}

/// Limits of a cut for comparisons with raw parameters, all finite.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CutLimits {
    /// Lower corner of the box.
    pub low: Vec3,
    /// Upper corner of the box.
    pub high: Vec3,
    /// Minimum opacity before the sigmoid.
    pub opacity_logit: f32,
    /// Minimum logarithm of the density.
    pub log_density: f32,
}

/// Tolerance for the rounding of opacities, which files store in eight bits or as logits.
const LOGIT_SLACK: f64 = 1e-5;
/// Largest limit of the opacity: greater ones are 1 in float32.
const MAX_OPACITY: f64 = 1.0 - 1.0 / (1 << 25) as f64;

impl Cut {
    /// Refuses an opacity that is not between 0 and 1, a density that is negative or not finite, and a box with NaN sides.
    pub fn check(&self) -> Result<()> {
        let Self { min_opacity, min_density, bounds } = self;
        if !(0.0..=1.0).contains(min_opacity) {
            return Err(Error::argument("min_opacity", format!("{min_opacity} is not between 0 and 1")));
        }
        if !(min_density.is_finite() && *min_density >= 0.0) {
            let problem = format!("{min_density} is not 0 or more");
            return Err(Error::argument("min_density", problem));
        }
        if bounds.is_some_and(|Bounds { min, max }| min.is_nan() || max.is_nan()) {
            return Err(Error::argument("bounds", "has sides that are no numbers"));
        }
        Ok(())
    }

    /// Returns the limits to compare with.
    pub fn limits(&self) -> CutLimits {
        // Infinite sides become finite, because a device may not support infinities.
        let finite = |v: f32| v.clamp(f32::MIN, f32::MAX);
        let side = |v: Vec3| Vec3::from_array(v.to_array().map(finite));
        let bounds = self.bounds.unwrap_or(Bounds { min: Vec3::MIN, max: Vec3::MAX });
        let opacity = f64::from(self.min_opacity).min(MAX_OPACITY);
        CutLimits {
            low: side(bounds.min),
            high: side(bounds.max),
            opacity_logit: finite(((opacity / (1.0 - opacity)).ln() - LOGIT_SLACK) as f32),
            log_density: finite(f64::from(self.min_density).ln() as f32),
        }
    }
}

impl CutLimits {
    /// True if a Gaussian stays.
    pub fn keeps(&self, gaussians: &Gaussians, index: usize) -> bool {
        let mean = Vec3::from_array(gaussians.means[index]);
        mean.cmpge(self.low).all()
            && mean.cmple(self.high).all()
            && gaussians.opacity_logits[index] >= self.opacity_logit
            && gaussians.log_density(index) >= self.log_density
    }
}

impl Gaussians {
    /// Logarithm of a Gaussian's density: `opacity / (1 − opacity)` per largest standard deviation in world units. For faint
    /// Gaussians the numerator is near the optical depth. It is the difference of two stored parameters.
    pub fn log_density(&self, index: usize) -> f32 {
        let [x, y, z] = self.log_scales[index];
        self.opacity_logits[index] - x.max(y).max(z)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// (mean's x, opacity, largest standard deviation) of each Gaussian.
    fn scene(rows: &[(f32, f32, f32)]) -> Gaussians {
        let count = rows.len();
        Gaussians {
            sh_degree: 0,
            means: rows.iter().map(|row| [row.0, 0.0, 0.0]).collect(),
            quats: vec![[1.0, 0.0, 0.0, 0.0]; count],
            log_scales: rows.iter().map(|row| [row.2.ln() - 1.0, row.2.ln(), -9.0]).collect(),
            opacity_logits: rows.iter().map(|row| (row.1 / (1.0 - row.1)).ln()).collect(),
            sh: vec![[0.0; 3]; count],
        }
    }

    fn kept(cut: &Cut, scene: &Gaussians) -> Vec<usize> {
        let limits = cut.limits();
        (0..scene.len()).filter(|&index| limits.keeps(scene, index)).collect()
    }

    #[test]
    fn each_limit_leaves_out_its_own() {
        let scene = scene(&[(0.0, 0.9, 0.1), (0.0, 0.02, 5.0), (0.0, 0.02, 0.01), (7.0, 0.9, 0.1)]);
        let none = Cut::default();
        assert_eq!(kept(&none, &scene), [0, 1, 2, 3]);
        assert_eq!(kept(&Cut { min_opacity: 0.1, ..none }, &scene), [0, 3]);
        // Fog is faint for its size. An equally faint but small Gaussian is not fog.
        assert_eq!(kept(&Cut { min_density: 0.1, ..none }, &scene), [0, 2, 3]);
        let bounds = Some(Bounds { min: Vec3::splat(f32::NEG_INFINITY), max: Vec3::new(1.0, 0.0, 3.0) });
        assert_eq!(kept(&Cut { bounds, ..none }, &scene), [0, 1, 2]);
    }

    #[test]
    fn what_has_the_least_opacity_stays() {
        for step in 1..255 {
            let opacity = step as f32 / 255.0;
            let scene = scene(&[(0.0, opacity, 1.0), (0.0, opacity * 0.999, 1.0)]);
            assert_eq!(kept(&Cut { min_opacity: opacity, ..Cut::default() }, &scene), [0], "{step}");
        }
        let mut all = scene(&[(0.0, 0.5, 1.0); 3]);
        all.opacity_logits = vec![f32::MAX, 18.0, 16.0];
        assert_eq!(kept(&Cut { min_opacity: 1.0, ..Cut::default() }, &all), [0, 1]);
    }

    #[test]
    fn senseless_cuts_are_refused() {
        let none = Cut::default();
        assert!(none.check().is_ok());
        let odd = Some(Bounds { min: Vec3::NAN, max: Vec3::ONE });
        for cut in [
            Cut { min_opacity: 1.1, ..none },
            Cut { min_opacity: f32::NAN, ..none },
            Cut { min_density: -1.0, ..none },
            Cut { min_density: f32::INFINITY, ..none },
            Cut { bounds: odd, ..none },
        ] {
            assert!(cut.check().is_err(), "{cut:?}");
        }
    }
}
