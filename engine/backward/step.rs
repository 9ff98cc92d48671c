//! The backward pass of the projection with Adam's step in it: gradients that nobody else needs are not stored, and
//! parameters are read once.

use super::{Backward, BackwardVariant, LANE_INSTANCES, Statistics, Sums};
use crate::error::Result;
use crate::forward::{FrameInputs, block_of, range_arguments};
use crate::kernels::backward::project_adam;
use crate::optimizer::{self, Moments, Step};
use crate::vk::{Buffer, Kernel, KernelInterface, Limits, Recorder};

impl Backward {
    /// Whether [`Backward::record_with_step`] has a kernel on such a device: it binds 17 buffers.
    pub fn can_step(limits: &Limits) -> bool {
        project_adam::Interface::BINDINGS.len() <= limits.max_push_descriptors as usize
    }

    /// As [`Backward::prepare`], for [`Backward::record_with_step`].
    ///
    /// # Errors
    /// When the device refuses a pipeline.
    pub fn prepare_with_step(&mut self, sh_degree: u32, variant: BackwardVariant) -> Result<()> {
        self.prepare_blend(Sums::Gradients, variant)?;
        let BackwardVariant { filter_3d, own_dilation, dropout, z_record, .. } = variant;
        let built = &mut self.project_adam[variant.of_splats()][sh_degree as usize];
        if built.is_none() {
            let spec = project_adam::Spec {
                workgroup_size: self.sizes.elementwise_workgroup,
                subgroup_size: self.context.limits().heavy_subgroup_size,
                sh_degree,
                lane_instances: LANE_INSTANCES,
                filter_3d,
                own_dilation,
                dropout,
                z_record,
                sh_loops: self.sizes.sh_loops,
            };
            *built = Some(Kernel::new(&self.context, &spec)?);
        }
        Ok(())
    }

    /// As [`Backward::record`], with Adam's step on the visible Gaussians in place of `frame.gradients`: the same
    /// bits as [`Optimizer::record`](crate::optimizer::Optimizer::record) gives, on a device that contracts no
    /// products in one kernel only. The others are left to
    /// [`Optimizer::record_unseen`](crate::optimizer::Optimizer::record_unseen). Without absolute statistics.
    pub fn record_with_step(
        &self,
        r: &mut Recorder,
        inputs: &FrameInputs,
        image_gradient: &Buffer,
        statistics: Statistics,
        (moments, step): (&Moments, &Step),
    ) {
        r.scope("blend backward", |r| self.record_blend(r, inputs, image_gradient, Sums::Gradients));
        r.barrier();
        r.scope("project backward and adam", |r| {
            self.record_project_adam(r, inputs, statistics, (moments, step));
        });
    }

    fn record_project_adam(
        &self,
        r: &mut Recorder,
        inputs: &FrameInputs,
        statistics: Statistics,
        (moments, step): (&Moments, &Step),
    ) {
        let f = inputs.frame;
        let of_splats = &self.project_adam[BackwardVariant::of(inputs.settings).of_splats()];
        let Some(kernel) = &of_splats[inputs.sh_degree as usize] else {
            panic!("Backward::prepare_with_step was not called for SH degree {}", inputs.sh_degree);
        };
        for range in inputs.scene.plan.ranges(inputs.scene.count) {
            if range.chunk > 0 {
                r.barrier();
            }
            let adam = optimizer::push(inputs, step, range.first, range.count);
            let push = project_adam::Push {
                first: range.first,
                chunk_gaussians: inputs.scene.plan.chunk_gaussians,
                antialias: inputs.settings.antialias_bits(),
                splat_stride: f.splats().stride,
                gradient_stride: inputs.capacity.visible,
                accumulate: statistics.accumulate.into(),
                push_camera_position: adam.camera_position,
                beta_1: adam.beta_1,
                beta_2: adam.beta_2,
                one_minus_beta_1: adam.one_minus_beta_1,
                one_minus_beta_2: adam.one_minus_beta_2,
                epsilon: adam.epsilon,
                rate_mean: adam.rate_mean,
                rate_opacity: adam.rate_opacity,
                rate_quat: adam.rate_quat,
                rate_log_scale: adam.rate_log_scale,
                rate_sh_dc: adam.rate_sh_dc,
                rate_sh_rest: adam.rate_sh_rest,
                inverse_bias_2: adam.inverse_bias_2,
                inverse_bias_2_opacity: adam.inverse_bias_2_opacity,
            };
            let parameters = &inputs.scene.chunks[range.chunk];
            let (moments_1, moments_2) = (&moments.first[range.chunk], &moments.second[range.chunk]);
            let bind = project_adam::Bind {
                parameters,
                state: &f.state,
                visible_ranges: &f.visible_ranges,
                visible_list: &f.visible_list,
                footprints: f.splats().footprints,
                first_instances: &f.first_instances,
                conic_opacity: f.splats().conic_opacity,
                instance_gradients_a: &f.instance_gradients_a,
                instance_gradients_b: &f.instance_gradients_b,
                instance_gradients_c: &f.instance_gradients_c,
                statistics: statistics.buffer,
                new_parameters: parameters,
                moments_1,
                moments_2,
                old_moments_1: moments_1,
                old_moments_2: moments_2,
                camera_block: &block_of(f, 0),
            };
            r.dispatch_indirect(kernel, &bind, &push, &range_arguments(f, &self.sizes, range));
        }
    }
}
