//! Settings of one scene of a frame, besides the frame's settings.

use crate::error::{Error, Result};
use crate::kernels::constants::TINTED_COLOR_MAX;
use crate::scene::{CutOut, MAX_CUT_OUTS};
use crate::vk::Buffer;

/// Settings of one scene of a frame. The default draws the scene unchanged, with the kernels of a frame without these settings.
#[derive(Clone, Copy, Debug)]
pub struct SceneSettings<'a> {
    /// True if the scene is drawn. A hidden scene takes no Gaussians of the reservation and no time on the device. It still
    /// counts as a scene, and the others keep their places in [`RecordedFrame::scenes`](crate::RecordedFrame::scenes).
    pub visible: bool,
    /// Factors of red, green and blue, each 0 to [`MAX_TINT`]. They multiply each Gaussian's colour after its spherical
    /// harmonics and their clamp at 0: display-encoded, as trained. The product is clamped to
    /// [`TINTED_COLOR_MAX`](crate::kernels::constants::TINTED_COLOR_MAX), the largest half float.
    pub tint: [f32; 3],
    /// Factor of each Gaussian's opacity after the sigmoid, 0 to 1. Other [shapes](crate::Shape) than Gaussians stay opaque. A
    /// factor of 0 hides the scene.
    pub opacity: f32,
    /// Highest evaluated SH degree, 0 to 3. `None` uses the frame's [`sh_degree`](crate::RenderSettings::sh_degree), which is
    /// also the upper limit.
    pub sh_degree: Option<u32>,
    /// Volumes that keep or remove Gaussians, in the scene's own coordinates: at most [`MAX_CUT_OUTS`].
    pub cut_outs: &'a [CutOut],
    /// Gaussians that are drawn in another colour.
    pub selection: Option<Selection<'a>>,
}

/// Gaussians of a scene that are drawn in another colour.
#[derive(Clone, Copy, Debug)]
pub struct Selection<'a> {
    /// A bit per Gaussian of the scene: bit i % 32 of word i / 32, set if selected. A host's buffer ([`Buffer::adopt`]) or the
    /// context's, with whole words for all Gaussians. The host synchronises its writes as for any buffer that compute shaders
    /// read.
    pub mask: &'a Buffer,
    /// Colour of the selection, display-encoded, 0 to [`TINTED_COLOR_MAX`] per channel.
    pub color: [f32; 3],
    /// Share of that colour, 0 to 1; the rest is the Gaussian's own colour with the tint.
    pub share: f32,
}

/// Largest factor of a [`SceneSettings::tint`].
pub const MAX_TINT: f32 = 1000.0;

impl Default for SceneSettings<'_> {
    fn default() -> Self {
        Self::USUAL
    }
}

impl<'a> SceneSettings<'a> {
    /// Draws the scene unchanged.
    pub const USUAL: Self =
        Self { visible: true, tint: [1.0; 3], opacity: 1.0, sh_degree: None, cut_outs: &[], selection: None };

    /// Checks the numbers.
    ///
    /// # Errors
    /// [`Error::Argument`] with the field's name for a tint, an opacity or a selection's colour that is NaN or out of range, an
    /// SH degree above 3, and too many cut-outs; errors of [`CutOut::check`].
    #[inline]
    pub fn check(&self) -> Result<()> {
        // Fast path for frames of thousands of scenes.
        let is_simple = self.sh_degree.is_none() & self.cut_outs.is_empty() & self.selection.is_none();
        match is_simple & self.has_possible_factors() {
            true => Ok(()),
            false => self.check_each(),
        }
    }

    /// True if the tint and the opacity are in their ranges.
    #[inline]
    fn has_possible_factors(&self) -> bool {
        let [r, g, b] = self.tint.map(|factor| (0.0..=MAX_TINT).contains(&factor));
        r & g & b & (0.0..=1.0).contains(&self.opacity)
    }

    fn check_each(&self) -> Result<()> {
        if !self.tint.iter().all(|factor| (0.0..=MAX_TINT).contains(factor)) {
            let problem = format!("{:?}, each factor may be 0 to {MAX_TINT}", self.tint);
            return Err(Error::argument("tint", problem));
        }
        if !(0.0..=1.0).contains(&self.opacity) {
            return Err(Error::argument("opacity", format!("{} is not between 0 and 1", self.opacity)));
        }
        if let Some(degree) = self.sh_degree.filter(|degree| *degree > 3) {
            return Err(Error::argument("sh_degree", format!("{degree}, it may be 0 to 3")));
        }
        if self.cut_outs.len() > MAX_CUT_OUTS {
            let problem = format!("{} of them, there may be {MAX_CUT_OUTS}", self.cut_outs.len());
            return Err(Error::argument("cut_outs", problem));
        }
        if let Some(Selection { color, share, .. }) = self.selection {
            if !color.iter().all(|channel| (0.0..=TINTED_COLOR_MAX).contains(channel)) {
                let problem = format!("{color:?}, each may be 0 to {TINTED_COLOR_MAX}");
                return Err(Error::argument("selection.color", problem));
            }
            if !(0.0..=1.0).contains(&share) {
                return Err(Error::argument("selection.share", format!("{share} is not between 0 and 1")));
            }
        }
        self.cut_outs.iter().enumerate().try_for_each(|(index, cut_out)| {
            cut_out.check().map_err(|error| error.within(format_args!("cut_outs[{index}]")))
        })
    }

    /// True if any Gaussian is drawn.
    #[inline]
    pub fn draws(&self) -> bool {
        self.visible && self.opacity > 0.0
    }

    /// Number of cut-outs, 0 if the scene is hidden.
    #[inline]
    pub fn cut_out_count(&self) -> u32 {
        if self.draws() { self.cut_outs.len() as u32 } else { 0 }
    }

    /// Mask of the selection, if it is visible.
    #[inline]
    pub fn mask(&self) -> Option<&'a Buffer> {
        self.selection
            .filter(|selection| self.draws() && selection.share > 0.0)
            .map(|selection| selection.mask)
    }

    /// Features that need kernel variants: a tint or an opacity, cut-outs, a selection.
    #[inline]
    pub(crate) fn kinds(&self) -> [bool; 3] {
        [self.is_tinted(), self.cut_out_count() > 0, self.mask().is_some()]
    }

    /// True if colours or opacities of a drawn scene are multiplied.
    #[inline]
    pub fn is_tinted(&self) -> bool {
        let [r, g, b] = self.tint;
        self.draws() && (r != 1.0 || g != 1.0 || b != 1.0 || self.opacity != 1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Inside, Pose, Volume};
    use glam::Vec3;

    #[test]
    fn senseless_settings_are_refused_by_name() {
        let usual = SceneSettings::default();
        assert!(usual.check().is_ok() && usual.draws() && !usual.is_tinted());
        let flat = Volume::Box { half_size: Vec3::new(1.0, 1.0, 0.0) };
        let good = CutOut {
            volume: Volume::Box { half_size: Vec3::ONE },
            pose: Pose::IDENTITY,
            inside: Inside::Kept,
        };
        let (degenerate, many) = ([good, CutOut { volume: flat, ..good }], [good; MAX_CUT_OUTS + 1]);
        let bad = [
            (
                SceneSettings { cut_outs: &degenerate, ..usual },
                "cut_outs[1].volume: a size of [1.0, 1.0, 0.0]",
            ),
            (SceneSettings { cut_outs: &many, ..usual }, "cut_outs: 17 of them, there may be 16"),
            (SceneSettings { tint: [1.0, f32::NAN, 1.0], ..usual }, "tint: [1.0, NaN, 1.0]"),
            (SceneSettings { tint: [-0.1, 1.0, 1.0], ..usual }, "tint: "),
            (SceneSettings { tint: [1.0, 1.0, f32::INFINITY], ..usual }, "tint: "),
            (SceneSettings { opacity: f32::NAN, ..usual }, "opacity: NaN is not between 0 and 1"),
            (SceneSettings { opacity: -0.5, ..usual }, "opacity: -0.5"),
            (SceneSettings { opacity: 1.001, ..usual }, "opacity: 1.001"),
            (SceneSettings { sh_degree: Some(4), ..usual }, "sh_degree: 4, it may be 0 to 3"),
        ];
        for (settings, expected) in bad {
            let error = settings.check().map_or_else(|error| error.to_string(), |()| "accepted".into());
            assert!(error.contains(expected), "{error}");
        }
        let most =
            SceneSettings { tint: [0.0, MAX_TINT, 1.0], sh_degree: Some(0), cut_outs: &many[1..], ..usual };
        assert!(most.check().is_ok() && most.draws() && most.is_tinted() && most.cut_out_count() == 16);
        for hidden in [SceneSettings { visible: false, ..most }, SceneSettings { opacity: 0.0, ..most }] {
            assert!(
                hidden.check().is_ok()
                    && !hidden.draws()
                    && !hidden.is_tinted()
                    && hidden.cut_out_count() == 0
            );
        }
    }
}
