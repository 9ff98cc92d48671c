//! Unchanging inputs of a training run.

use super::settings::TrainSettings;
use crate::forward::RenderSettings;
use crate::scene::Camera;

/// Inputs of a run, apart from the photographs.
pub(super) struct Run {
    pub settings: TrainSettings,
    /// World units.
    pub scene_extent: f32,
    /// One per view.
    pub cameras: Vec<Camera>,
    /// Lens index of each view, counted from 0 in the order of the camera ids.
    pub lenses: Vec<u32>,
    pub views_fingerprint: u64,
}

impl Run {
    /// Number of lenses.
    pub fn lens_count(&self) -> usize {
        self.lenses.iter().max().map_or(0, |&last| last as usize + 1)
    }

    /// Render settings of training, without the random background.
    pub fn render_settings(&self) -> RenderSettings {
        self.settings.render_settings()
    }
}

impl TrainSettings {
    /// Render settings of training, without the random background.
    pub fn render_settings(&self) -> RenderSettings {
        RenderSettings {
            antialias: self.antialiasing,
            antialias_detached: self.antialiasing_detached,
            dilation_px2: self.kernel_size as f32,
            filter_3d: self.filter_3d,
            background: [f32::from(u8::from(self.white_background)); 3],
            ..RenderSettings::default()
        }
    }
}
