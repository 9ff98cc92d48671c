//! How one scene of a frame is drawn, beside the frame's settings.

use crate::error::{Error, Result};

/// How one scene of a frame is drawn. The default draws it as it is, with the kernels of a frame without any of this.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SceneSettings {
    /// Whether it is drawn. A scene that is not takes no work and no room, and the others keep their places in
    /// [`RecordedFrame::scenes`](crate::RecordedFrame::scenes).
    pub visible: bool,
    /// Factors of red, green and blue, each 0 to [`MAX_TINT`]. They multiply the colour of each Gaussian after its spherical
    /// harmonics and their clamp at 0: display-encoded, as trained. The product is at most
    /// [`TINTED_COLOR_MAX`](crate::kernels::constants::TINTED_COLOR_MAX), the largest half float.
    pub tint: [f32; 3],
    /// Factor of each Gaussian's opacity after the sigmoid, 0 to 1. Other [shapes](crate::Shape) than Gaussians stay opaque. At
    /// 0 nothing is drawn, as where the scene is not visible.
    pub opacity: f32,
    /// Highest evaluated SH degree, 0 to 3: lower degrees alone. `None` for the frame's
    /// [`sh_degree`](crate::RenderSettings::sh_degree), which is never exceeded.
    pub sh_degree: Option<u32>,
}

/// Largest factor of a [`SceneSettings::tint`].
pub const MAX_TINT: f32 = 1000.0;

impl Default for SceneSettings {
    fn default() -> Self {
        Self { visible: true, tint: [1.0; 3], opacity: 1.0, sh_degree: None }
    }
}

impl SceneSettings {
    /// Checks the numbers.
    ///
    /// # Errors
    /// [`Error::Argument`] with the field's name for a tint or an opacity out of range or no number, and an SH degree above 3.
    pub fn check(&self) -> Result<()> {
        if !self.tint.iter().all(|factor| (0.0..=MAX_TINT).contains(factor)) {
            let problem = format!("{:?}, each factor may be 0 to {MAX_TINT}", self.tint);
            return Err(Error::argument("tint", problem));
        }
        if !(0.0..=1.0).contains(&self.opacity) {
            return Err(Error::argument("opacity", format!("{} is not between 0 and 1", self.opacity)));
        }
        match self.sh_degree {
            Some(degree) if degree > 3 => {
                Err(Error::argument("sh_degree", format!("{degree}, it may be 0 to 3")))
            }
            _ => Ok(()),
        }
    }

    /// Whether anything is drawn.
    pub fn draws(&self) -> bool {
        self.visible && self.opacity > 0.0
    }

    /// Whether colours or opacities of what is drawn are multiplied.
    pub fn is_tinted(&self) -> bool {
        self.draws() && (self.tint != [1.0; 3] || self.opacity != 1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn senseless_settings_are_refused_by_name() {
        let usual = SceneSettings::default();
        assert!(usual.check().is_ok() && usual.draws() && !usual.is_tinted());
        let bad = [
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
        let most = SceneSettings { tint: [0.0, MAX_TINT, 1.0], sh_degree: Some(0), ..usual };
        assert!(most.check().is_ok() && most.draws() && most.is_tinted());
        for hidden in [SceneSettings { visible: false, ..most }, SceneSettings { opacity: 0.0, ..most }] {
            assert!(hidden.check().is_ok() && !hidden.draws() && !hidden.is_tinted());
        }
    }
}
