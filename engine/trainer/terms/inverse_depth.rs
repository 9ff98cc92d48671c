//! The reference implementation's depth regularisation (gaussian-splatting, since October 2024).

use crate::error::Result;
use crate::kernels::constants::TERM_PARTIALS;
use crate::kernels::loss::{inverse_depth_l1, term_reduce};
use crate::loss::{LossTerm, PixelLayout, Targets, TermInputs};
use crate::plan::LaunchSizes;
use crate::trainer::settings::TrainSettings;
use crate::vk::{Context, Kernel, Recorder};

/// Mean difference of the rendered inverse depth (the sum of weights / z) from a view's map, times a weight that falls
/// log-linearly over the run. 0 for views without a map. Reports the mean difference.
pub struct InverseDepth {
    difference: Kernel<inverse_depth_l1::Interface>,
    reduce: Kernel<term_reduce::Interface>,
    settings: TrainSettings,
}

impl InverseDepth {
    /// Builds the kernels. The weights are [`TrainSettings::depth_l1_weight`].
    ///
    /// # Errors
    /// When the device refuses a pipeline.
    pub fn new(context: &Context, settings: &TrainSettings) -> Result<Self> {
        let subgroup_size = context.limits().subgroup_size;
        let sizes = LaunchSizes::new(context.limits());
        let (workgroup_size, strips) = (sizes.elementwise_workgroup, sizes.strips);
        let spec = inverse_depth_l1::Spec { workgroup_size, subgroup_size, strips };
        Ok(Self {
            difference: Kernel::new(context, &spec)?,
            reduce: Kernel::new(context, &term_reduce::Spec { workgroup_size, subgroup_size })?,
            settings: settings.clone(),
        })
    }
}

impl LossTerm for InverseDepth {
    fn name(&self) -> &'static str {
        "inverse_depth"
    }

    fn targets(&self) -> Targets {
        Targets { picture: Some(PixelLayout::Native), inverse_depth: true, ..Targets::default() }
    }

    fn scratch_requests(&self, _: &[(u32, u32)]) -> Vec<(&'static str, u64)> {
        vec![("inverse_depth_partials", u64::from(TERM_PARTIALS) * 8)]
    }

    fn record(&self, r: &mut Recorder, inputs: &TermInputs) {
        let ([partials], frame) = (inputs.scratch, inputs.frame) else {
            panic!("one scratch buffer of the inverse depth");
        };
        let Some(target_map) = inputs.inverse_depth_map else {
            return r.fill(&inputs.losses.range(16 * u64::from(inputs.row), 16), 0);
        };
        let weight = self.settings.depth_l1_weight(inputs.iteration);
        let pixels = f64::from(frame.camera.width) * f64::from(frame.camera.height);
        let share = frame.camera.share_of_whole();
        r.scope("inverse depth", |r| {
            let bind = inverse_depth_l1::Bind {
                inverse_depth: &frame.frame.inverse_depth,
                target_map,
                image_gradient: inputs.image_gradient,
                partials,
            };
            let push = inverse_depth_l1::Push {
                image_width: frame.camera.width,
                image_height: frame.camera.height,
                weight: (share * weight / pixels) as f32,
            };
            r.dispatch(&self.difference, &bind, &push, TERM_PARTIALS.into());
            r.barrier();
            let push = term_reduce::Push {
                row: inputs.row,
                values: [pixels as f32, 1.0],
                weights: [(share * weight) as f32, 0.0],
            };
            r.dispatch(&self.reduce, &term_reduce::Bind { partials, losses: inputs.losses }, &push, 1);
        });
    }
}
