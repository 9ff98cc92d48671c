//! Adam over all parameters in one pass.

use crate::error::Result;
use crate::frame::{FrameInputs, FrameVariant, GaussianRange, LaunchSizes, ScenePlan, ShStorage};
use crate::kernels::optimizer::adam;
use crate::vk::{Buffer, Context, KernelSet, Recorder};

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
    /// SH coefficients from 1 on.
    pub sh_rest: f64,
}

/// One step of the optimiser.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// Learning rates.
    pub rates: Rates,
    /// Number of steps including this one, counted from 1; 0 turns off the bias correction (sparse Adam).
    pub count: u64,
    /// Same as `count`, but for the opacity, whose step is skipped at an opacity reset.
    pub opacity_count: u64,
    /// Key of the random numbers that round packed moments, with the iteration.
    pub seed: u32,
    /// See `seed`.
    pub iteration: u32,
}

/// First and second moments of a scene's parameters.
#[derive(Clone)]
pub struct Moments {
    /// True if the moments are packed: see packed_moments.glsl.
    pub packed: bool,
    /// Plan of a set.
    pub plan: ScenePlan,
    /// The first and the second moments, or one set of packed ones; each one buffer per chunk.
    pub sets: Vec<Vec<Buffer>>,
}

impl Moments {
    /// Plan and number of the sets for a scene's plan.
    pub fn sets_of(scene: &ScenePlan, packed: bool) -> (ScenePlan, usize) {
        if packed { (scene.halved(), 1) } else { (*scene, 2) }
    }

    /// Buffers of the first and the second moments of a chunk. They are the same for packed moments.
    pub fn chunk(&self, chunk: usize) -> [&Buffer; 2] {
        [&self.sets[0][chunk], &self.sets[self.sets.len() - 1][chunk]]
    }
}

/// Form of the optimiser's kernel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct OptimizerForm {
    /// The moments are packed.
    pub packed: bool,
    /// Sparse Adam: does not change Gaussians out of view, and corrects no bias.
    pub sparse: bool,
    /// The loss has terms that depend on the parameters directly. [`Optimizer::record`] receives their gradient.
    pub parameter_gradients: bool,
    /// The device moves the cameras of frames: [`FrameInputs::pose`].
    pub moved_cameras: bool,
}

/// Kernels of the optimiser.
pub struct Optimizer {
    context: Context,
    sizes: LaunchSizes,
    form: OptimizerForm,
    adam: KernelSet<adam::Interface>,
}

impl Optimizer {
    /// Creates an instance without kernels.
    pub fn new(context: &Context, form: OptimizerForm) -> Self {
        let sizes = LaunchSizes::new(context.limits());
        Self { context: context.clone(), sizes, form, adam: KernelSet::default() }
    }

    /// Builds the kernel for an SH degree and a variant of frames if it is missing.
    pub fn prepare(&mut self, sh_degree: u32, variant: FrameVariant) -> Result<()> {
        self.adam.prepare(&self.context, self.adam_spec(sh_degree, variant))
    }

    fn adam_spec(&self, sh_degree: u32, variant: FrameVariant) -> adam::Spec {
        let OptimizerForm { packed, sparse, parameter_gradients, moved_cameras: moved_camera } = self.form;
        let (workgroup_size, sh_loops) = (self.sizes.elementwise_workgroup, self.sizes.tuning.sh_loops);
        let (projection, lenses) = variant.direction_form();
        adam::Spec {
            workgroup_size,
            sh_degree,
            packed,
            half_sh: variant.sh_storage == ShStorage::Half,
            sparse,
            parameter_gradients,
            moved_camera,
            sh_loops,
            projection,
            lenses,
        }
    }

    /// Records one step from `inputs.buffers.gradients`, and from `parameter_gradients` ([`TermInputs`](crate::passes::loss::TermInputs))
    /// with [`OptimizerForm::parameter_gradients`].
    pub fn record(
        &self,
        r: &mut Recorder,
        inputs: &FrameInputs,
        moments: &Moments,
        parameter_gradients: &[Buffer],
        step: &Step,
    ) {
        let spec = self.adam_spec(inputs.sh_degree(), inputs.trained_variant());
        let Some(kernel) = r.kernel(&self.adam, &spec) else { return };
        let f = inputs.buffers;
        r.scope("adam", |r| {
            inputs.scene().record_chunks(r, |r, range, parameters| {
                let [moments_1, moments_2] = moments.chunk(range.chunk);
                let bind = adam::Bind {
                    parameters,
                    moments_1,
                    moments_2,
                    visible_index: &f.visible_index,
                    gradients: &f.gradients,
                    state: &f.state,
                    old_parameters: parameters,
                    old_moments_1: moments_1,
                    old_moments_2: moments_2,
                    // Without such terms the kernel does not read this binding.
                    parameter_gradients: match self.form.parameter_gradients {
                        true => &parameter_gradients[range.chunk],
                        false => &f.gradients,
                    },
                    camera_block: &f.camera_block(0),
                };
                let push = push(inputs, step, &range);
                r.dispatch(kernel, &bind, &push, self.sizes.groups(range.count));
            });
        });
    }
}

fn push(inputs: &FrameInputs, step: &Step, range: &GaussianRange) -> adam::Push {
    let correction = |beta: f64, steps: u64| match steps {
        0 => 1.0,
        steps => 1.0 - beta.powf(steps as f64),
    };
    let bias_1 = correction(BETA_1, step.count);
    let bias_1_opacity = correction(BETA_1, step.opacity_count);
    let rates = &step.rates;
    let [shutter_turn, shutter_shift, shutter_rows] = inputs.camera.shutter_words();
    adam::Push {
        camera_position: inputs.camera.position().to_array(),
        first: range.first,
        count: range.count,
        chunk_gaussians: inputs.scene().plan.chunk_gaussians,
        gradient_stride: inputs.capacity.visible,
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
        seed: step.seed,
        iteration: step.iteration,
        shutter_turn,
        shutter_shift,
        shutter_rows,
    }
}
