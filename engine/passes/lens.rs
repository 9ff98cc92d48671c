//! Gradient of a frame with respect to its camera's lens.

use crate::error::Result;
use crate::frame::{FrameInputs, LaunchSizes, first_lens_sum};
use crate::kernels::poses::lens_gradient;
use crate::vk::{Buffer, Context, Kernel, Recorder};

/// Kernel of the gradient with respect to a lens.
pub struct LensGradient {
    kernel: Kernel<lens_gradient::Interface>,
    /// Number of Gaussians per sum, which a workgroup of `project_backward` adds up.
    sum_gaussians: u32,
}

impl LensGradient {
    /// Builds the kernel.
    pub fn new(context: &Context) -> Result<Self> {
        // Every device has workgroups of 128.
        let kernel = Kernel::new(context, &lens_gradient::Spec { workgroup_size: 128 })?;
        Ok(Self { kernel, sum_gaussians: LaunchSizes::new(context.limits()).elementwise_workgroup })
    }

    /// Records the gradient after [`Backward::record`](crate::passes::backward::Backward::record) with a lens. `gradient` receives
    /// eighteen f32; [`Camera::lens_gradient`](crate::Camera::lens_gradient) converts the first sixteen.
    pub fn record(&self, r: &mut Recorder, inputs: &FrameInputs, gradient: &Buffer) {
        let lens_sums = inputs.buffers.camera_sums(inputs.capacity);
        let bind = lens_gradient::Bind { lens_sums, lens_gradient: gradient };
        let (begin, sums) =
            (3 * first_lens_sum(inputs.capacity), inputs.scene().count.div_ceil(self.sum_gaussians));
        r.dispatch(&self.kernel, &bind, &lens_gradient::Push { begin, sums }, 1);
    }
}
