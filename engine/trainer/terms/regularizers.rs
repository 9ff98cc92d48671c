//! Opacity and scale regularisers (3DGS-MCMC, Kheradmand et al. 2024, section 4).

use crate::error::Result;
use crate::kernels::constants::TERM_PARTIALS;
use crate::kernels::loss::{regularize, term_reduce};
use crate::loss::{LossTerm, Targets, TermInputs};
use crate::plan::LaunchSizes;
use crate::vk::{Context, Kernel, Recorder};

/// `opacity` times the mean opacity plus `scale` times the mean scale (world units), over all Gaussians, also those out of
/// view. Sparse Adam moves only the visible ones. Reports both means.
pub struct Regularizers {
    regularize: Kernel<regularize::Interface>,
    reduce: Kernel<term_reduce::Interface>,
    opacity: f64,
    scale: f64,
}

impl Regularizers {
    /// Builds the kernels. `opacity` and `scale` are the weights.
    ///
    /// # Errors
    /// When the device refuses a pipeline.
    pub fn new(context: &Context, opacity: f64, scale: f64) -> Result<Self> {
        let subgroup_size = context.limits().subgroup_size;
        let workgroup_size = LaunchSizes::new(context.limits()).elementwise_workgroup;
        Ok(Self {
            regularize: Kernel::new(context, &regularize::Spec { workgroup_size, subgroup_size })?,
            reduce: Kernel::new(context, &term_reduce::Spec { workgroup_size, subgroup_size })?,
            opacity,
            scale,
        })
    }
}

impl LossTerm for Regularizers {
    fn name(&self) -> &'static str {
        "regularizers"
    }

    fn targets(&self) -> Targets {
        Targets { parameters: true, ..Targets::default() }
    }

    fn scratch_requests(&self, _: &[(u32, u32)]) -> Vec<(&'static str, u64)> {
        vec![("regularizer_partials", u64::from(TERM_PARTIALS) * 8)]
    }

    fn record(&self, r: &mut Recorder, inputs: &TermInputs) {
        let (scene, [partials]) = (inputs.frame.scene(), inputs.scratch) else {
            panic!("one scratch buffer of the regularisers");
        };
        let count = f64::from(scene.count.max(1));
        r.scope("regularizers", |r| {
            for range in scene.plan.ranges(scene.count) {
                if range.chunk > 0 {
                    r.barrier();
                }
                let bind = regularize::Bind {
                    parameters: &scene.chunks[range.chunk],
                    parameter_gradients: &inputs.parameter_gradients[range.chunk],
                    partials,
                };
                let push = regularize::Push {
                    count: range.count,
                    continues: u32::from(range.chunk > 0),
                    opacity_weight: (self.opacity / count) as f32,
                    scale_weight: (self.scale / (3.0 * count)) as f32,
                };
                r.dispatch(&self.regularize, &bind, &push, TERM_PARTIALS.into());
            }
            r.barrier();
            let push = term_reduce::Push {
                row: inputs.row,
                values: [scene.count as f32, 3.0 * scene.count as f32],
                weights: [self.opacity as f32, self.scale as f32],
            };
            let bind = term_reduce::Bind { partials, losses: inputs.losses };
            r.dispatch(&self.reduce, &bind, &push, 1);
        });
    }
}
