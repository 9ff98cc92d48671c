//! The photometric term: (1 - λ) L1 + λ (1 - SSIM).

use super::{Loss, LossInputs, LossTerm, PhotoFormat, PixelLayout, Targets, TermInputs};
use crate::error::Result;
use crate::vk::{Context, Recorder};

/// L1 and D-SSIM against the view's photograph (Kerbl et al. 2023, equation 7). Reports L1 and SSIM.
pub struct Photometric {
    plain: Loss,
    /// For photographs with masks.
    masked: Option<Loss>,
    lambda_dssim: f32,
}

impl Photometric {
    /// Builds the kernels; `any_masked`: also those for photographs with masks.
    ///
    /// # Errors
    /// When the device refuses a pipeline.
    pub fn new(context: &Context, any_masked: bool, lambda_dssim: f32) -> Result<Self> {
        let masked = any_masked.then(|| Loss::new(context, PhotoFormat::MaskedRgba8)).transpose()?;
        Ok(Self { plain: Loss::new(context, PhotoFormat::Rgba8)?, masked, lambda_dssim })
    }
}

impl LossTerm for Photometric {
    fn name(&self) -> &'static str {
        "photometric"
    }

    fn targets(&self) -> Targets {
        Targets { picture: Some(PixelLayout::Native), ..Targets::default() }
    }

    fn scratch_requests(&self, sizes: &[(u32, u32)]) -> Vec<(&'static str, u64)> {
        self.plain.scratch_requests(sizes.iter().copied())
    }

    fn record(&self, r: &mut Recorder, inputs: &TermInputs) {
        let loss = self.masked.as_ref().filter(|_| inputs.photo_is_masked).unwrap_or(&self.plain);
        let camera = inputs.frame.camera;
        loss.record(
            r,
            &LossInputs {
                rendered: inputs.picture,
                photo: inputs.photo,
                scratch: inputs.scratch,
                losses: inputs.losses,
                row: inputs.row,
                image_gradient: inputs.image_gradient,
                width: camera.width,
                height: camera.height,
                background: inputs.frame.settings.background,
                lambda_dssim: self.lambda_dssim,
                weight: camera.share_of_whole() as f32,
            },
        );
    }
}
