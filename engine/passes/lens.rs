//! Gradient of a frame with respect to its camera's lens, and the scaling of a scene that goes with a change of focal lengths.

use crate::error::Result;
use crate::frame::{FrameInputs, LaunchSizes, SceneBuffers, first_lens_sum};
use crate::kernels::optimizer::scale_scene;
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
    /// 21 f32; [`Camera::lens_gradient`](crate::Camera::lens_gradient) converts the first sixteen, and the next three are the sum over
    /// the gradients of all means, world.
    pub fn record(&self, r: &mut Recorder, inputs: &FrameInputs, gradient: &Buffer) {
        let lens_sums = inputs.buffers.camera_sums(inputs.capacity);
        let bind = lens_gradient::Bind { lens_sums, lens_gradient: gradient };
        let (begin, sums) =
            (3 * first_lens_sum(inputs.capacity), inputs.scene().count.div_ceil(self.sum_gaussians));
        r.dispatch(&self.kernel, &bind, &lens_gradient::Push { begin, sums }, 1);
    }
}

/// Kernel that scales a scene.
pub struct SceneScaling {
    kernel: Kernel<scale_scene::Interface>,
    sizes: LaunchSizes,
}

impl SceneScaling {
    /// Builds the kernel.
    pub fn new(context: &Context) -> Result<Self> {
        let sizes = LaunchSizes::new(context.limits());
        let workgroup_size = sizes.elementwise_workgroup;
        Ok(Self { kernel: Kernel::new(context, &scale_scene::Spec { workgroup_size })?, sizes })
    }

    /// Multiplies means and scales of all Gaussians by a factor about `center` (world). Submits and waits.
    pub fn run(
        &self,
        context: &Context,
        scene: &SceneBuffers,
        center: [f32; 3],
        log_factor: f64,
    ) -> Result<()> {
        let scaled = context.run("scale scene", |r| {
            for range in scene.plan.ranges(scene.count) {
                let bind = scale_scene::Bind { parameters: &scene.chunks[range.chunk] };
                let push = scale_scene::Push {
                    count: range.count,
                    center,
                    growth: log_factor.exp_m1() as f32,
                    log_factor: log_factor as f32,
                };
                r.dispatch(&self.kernel, &bind, &push, self.sizes.groups(range.count));
            }
        });
        scaled.map(drop)
    }
}
