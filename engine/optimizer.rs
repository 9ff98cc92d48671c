//! Adam over all parameters in one pass.

use crate::error::Result;
use crate::forward::{FrameInputs, SceneBuffers, block_of};
use crate::kernels::optimizer::adam;
use crate::plan::{LaunchSizes, blocks};
use crate::vk::{Buffer, Context, Kernel, Recorder};

/// Adam's constants in the reference: β₁, β₂, ε.
pub const BETA_1: f64 = 0.9;
/// See [`BETA_1`].
pub const BETA_2: f64 = 0.999;
/// See [`BETA_1`].
pub const EPSILON: f64 = 1e-15;

/// Learning rates of one step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rates {
    /// Means, world units.
    pub mean: f64,
    /// Opacity logits.
    pub opacity: f64,
    /// Quaternions.
    pub quat: f64,
    /// Log-scales.
    pub log_scale: f64,
    /// SH coefficient 0.
    pub sh_dc: f64,
    /// The other SH coefficients.
    pub sh_rest: f64,
}

/// One step of the optimiser.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// Learning rates.
    pub rates: Rates,
    /// Number of steps including this one, from 1; 0 turns off the bias correction (sparse Adam).
    pub count: u64,
    /// The same for the opacity, whose step is skipped at an opacity reset.
    pub opacity_count: u64,
}

/// First and second moments, laid out like the scene's planes.
#[derive(Clone)]
pub struct Moments {
    /// First moments, one buffer per chunk.
    pub first: Vec<Buffer>,
    /// Second moments, one buffer per chunk.
    pub second: Vec<Buffer>,
}

/// The kernels of the optimiser.
pub struct Optimizer {
    context: Context,
    sizes: LaunchSizes,
    sparse: bool,
    parameter_gradients: bool,
    moved_cameras: bool,
    adam: [Option<Kernel<adam::Interface>>; 4],
}

impl Optimizer {
    /// Prepares for a device. Sparse Adam does not change Gaussians outside the view, and corrects no bias.
    pub fn new(context: &Context, sparse: bool) -> Self {
        let sizes = LaunchSizes::new(context.limits());
        let context = context.clone();
        Self {
            context,
            sizes,
            sparse,
            parameter_gradients: false,
            moved_cameras: false,
            adam: Default::default(),
        }
    }

    /// As [`Optimizer::new`], for a loss with terms that depend on the parameters directly: their gradient is
    /// passed to [`Optimizer::record`].
    pub fn with_parameter_gradients(context: &Context, sparse: bool) -> Self {
        Self { parameter_gradients: true, ..Self::new(context, sparse) }
    }

    /// For frames whose cameras the device has moved: [`FrameInputs::pose`].
    #[must_use]
    pub fn with_moved_cameras(self) -> Self {
        Self { moved_cameras: true, ..self }
    }

    /// Builds the variant for an SH degree unless it exists.
    ///
    /// # Errors
    /// When the device refuses a pipeline.
    pub fn prepare(&mut self, sh_degree: u32) -> Result<()> {
        let slot = &mut self.adam[sh_degree as usize];
        if slot.is_none() {
            let spec = adam::Spec {
                workgroup_size: self.sizes.elementwise_workgroup,
                sh_degree,
                sparse: self.sparse,
                parameter_gradients: self.parameter_gradients,
                moved_camera: self.moved_cameras,
            };
            *slot = Some(Kernel::new(&self.context, &spec)?);
        }
        Ok(())
    }

    /// Records one step from `frame.gradients`, and from `parameter_gradients`
    /// ([`TermInputs`](crate::loss::TermInputs)) with [`Optimizer::with_parameter_gradients`]. The caller
    /// places barriers before and after.
    pub fn record(
        &self,
        r: &mut Recorder,
        inputs: &FrameInputs,
        moments: &Moments,
        parameter_gradients: &[Buffer],
        step: &Step,
    ) {
        let Some(kernel) = &self.adam[inputs.sh_degree as usize] else {
            panic!("Optimizer::prepare was not called for SH degree {}", inputs.sh_degree);
        };
        let scene: &SceneBuffers = inputs.scene;
        r.scope("adam", |r| {
            for range in scene.plan.ranges(scene.count) {
                if range.chunk > 0 {
                    r.barrier();
                }
                let parameters = &scene.chunks[range.chunk];
                let (moments_1, moments_2) = (&moments.first[range.chunk], &moments.second[range.chunk]);
                let bind = adam::Bind {
                    parameters,
                    moments_1,
                    moments_2,
                    visible_index: &inputs.frame.visible_index,
                    gradients: &inputs.frame.gradients,
                    state: &inputs.frame.state,
                    old_parameters: parameters,
                    old_moments_1: moments_1,
                    old_moments_2: moments_2,
                    // Without such terms nothing is read from it.
                    parameter_gradients: match self.parameter_gradients {
                        true => &parameter_gradients[range.chunk],
                        false => &inputs.frame.gradients,
                    },
                    camera_block: &block_of(inputs.frame, 0),
                };
                let push = push(inputs, step, range.first, range.count);
                r.dispatch(
                    kernel,
                    &bind,
                    &push,
                    blocks(range.count.into(), self.sizes.elementwise_workgroup.into()),
                );
            }
        });
    }
}

fn push(inputs: &FrameInputs, step: &Step, first: u32, count: u32) -> adam::Push {
    let correction = |beta: f64, steps: u64| match steps {
        0 => 1.0,
        steps => 1.0 - beta.powf(steps as f64),
    };
    let bias_1 = correction(BETA_1, step.count);
    let bias_1_opacity = correction(BETA_1, step.opacity_count);
    let rates = &step.rates;
    adam::Push {
        camera_position: inputs.camera.position().to_array(),
        first,
        count,
        chunk_gaussians: inputs.scene.plan.chunk_gaussians,
        gradient_stride: inputs.capacity.gaussians,
        beta_1: BETA_1 as f32,
        beta_2: BETA_2 as f32,
        one_minus_beta_1: (1.0 - BETA_1) as f32,
        one_minus_beta_2: (1.0 - BETA_2) as f32,
        epsilon: EPSILON as f32,
        rate_mean: (rates.mean / bias_1) as f32,
        rate_opacity: (rates.opacity / bias_1_opacity) as f32,
        rate_quat: (rates.quat / bias_1) as f32,
        rate_log_scale: (rates.log_scale / bias_1) as f32,
        rate_sh_dc: (rates.sh_dc / bias_1) as f32,
        rate_sh_rest: (rates.sh_rest / bias_1) as f32,
        inverse_bias_2: correction(BETA_2, step.count).sqrt().recip() as f32,
        inverse_bias_2_opacity: correction(BETA_2, step.opacity_count).sqrt().recip() as f32,
    }
}
