//! Poses of cameras: their gradient, and Adam over the poses of all images.
//!
//! The pose of an image is `T(ξ) = exp(ξ^) T₀` from world to camera, with six parameters ξ = (ν, ω). ν is a displacement in
//! world units and ω a turn in radians, both in the camera's frame ([`Twist`](crate::scene::Twist)). Frames read the cameras
//! from device memory ([`FrameInputs::pose`]), so recorded steps move them without the host.
//!
//! Steps turn a camera about a point in front of it, at the mean depth of the visible Gaussians, not about its centre. Both
//! span the same poses. But about the centre, a turn and a displacement move the picture nearly alike, and Adam, which scales
//! each parameter separately, cannot tell them apart. Park et al. 2023 ("CamP") precondition cameras for this reason.

pub use crate::frame::pose_of;

use crate::error::Result;
use crate::frame::{FrameInputs, LaunchSizes, POSE_BYTES, buffer_set};
use crate::kernels::poses::{pose_gradient, pose_step};
use crate::passes::adam::{BETA_1, BETA_2};
use crate::scene::Camera;
use crate::vk::{Buffer, Context, Kernel, Recorder};

/// Adam's ε for poses and lenses, on the host.
const POSE_EPSILON: f64 = 1e-8;
/// Weight decay of Adam over poses, added to the gradient (gsplat, `simple_trainer.py`).
pub const WEIGHT_DECAY: f64 = 1e-6;
/// Bytes of a pose's parameters ξ: six f32.
pub const PARAMETER_BYTES: u64 = 24;
/// Bytes of the gradient that [`PoseGradient::record`] writes.
pub const GRADIENT_BYTES: u64 = 48;

/// Kernel of the gradient with respect to a pose.
pub struct PoseGradient {
    kernel: Kernel<pose_gradient::Interface>,
    /// Number of Gaussians per sum, which a subgroup of `project_backward` adds up.
    sum_gaussians: u32,
}

impl PoseGradient {
    /// Builds the kernel.
    pub fn new(context: &Context) -> Result<Self> {
        let subgroup_size = context.limits().subgroup_size;
        let workgroup_size = LaunchSizes::new(context.limits()).elementwise_workgroup;
        let kernel = Kernel::new(context, &pose_gradient::Spec { workgroup_size, subgroup_size })?;
        Ok(Self { kernel, sum_gaussians: context.limits().heavy_subgroup_size })
    }

    /// Records the gradient after [`Backward::record`](crate::passes::backward::Backward::record) with a pose. `parameters` has
    /// ξ of all images, and `image` is the index of the frame's. `gradient` ([`GRADIENT_BYTES`]) receives g = dL/dδ of `exp(δ^)
    /// T` at δ = 0, then dL/dξ, each as (ν, ω).
    pub fn record(
        &self,
        r: &mut Recorder,
        inputs: &FrameInputs,
        parameters: &Buffer,
        image: u32,
        gradient: &Buffer,
    ) {
        let bind = pose_gradient::Bind {
            pose_sums: inputs.buffers.camera_sums(inputs.capacity),
            pose_parameters: parameters,
            pose_gradient: gradient,
        };
        let sums = inputs.scene().count.div_ceil(self.sum_gaussians);
        r.dispatch(&self.kernel, &bind, &pose_gradient::Push { sums, image }, 1);
    }
}

/// A step of the optimiser of poses.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseStep {
    /// Learning rate in radians. For displacements it is multiplied by the depth about which the image turns (1 if it has
    /// none).
    pub rate: f64,
    /// Number of steps including this one, counted from 1.
    pub count: u64,
}

buffer_set! {
    /// Poses of all images on the device.
    pub struct PoseBuffers(images: u32) {
        let images = u64::from(images);
    }
    /// ξ per image: two vec3, ν and ω.
    pub parameters as "pose_parameters": images * PARAMETER_BYTES;
    /// Four vec3 per image: Adam's first moment of ν and ω, then the second.
    pub moments as "pose_moments": images * 2 * PARAMETER_BYTES;
    /// Four vec3 per image: rows of the rotation of T₀, then its translation.
    pub starts as "pose_starts": images * POSE_BYTES;
    /// Depth of the point about which each image turns in steps, world units; 0 for the camera's centre.
    pub depths as "pose_depths": images * 4;
    /// Four vec3 per image: rows of the rotation of T(ξ), then its translation, for [`FrameInputs::pose`].
    pub cameras as "pose_cameras": images * POSE_BYTES;
    /// Gradient of a pose: see [`PoseGradient::record`].
    pub gradient as "pose_gradient": GRADIENT_BYTES;
}

/// Takes a step of Adam on the host: updates the moments (m, v) and returns the change to subtract. `bias`: 1 - β₁ᵗ and 1 - β₂ᵗ.
pub(crate) fn adam_on_host(moments: [&mut f64; 2], gradient: f64, bias: [f64; 2], rate: f64) -> f64 {
    let [m, v] = moments;
    *m = BETA_1 * *m + (1.0 - BETA_1) * gradient;
    *v = BETA_2 * *v + (1.0 - BETA_2) * gradient * gradient;
    rate * (*m / bias[0]) / ((*v / bias[1]).sqrt() + POSE_EPSILON)
}

/// Moves `camera` to a pose: the inverse of [`pose_of`].
pub fn camera_at(camera: &Camera, pose: &[f32; 12]) -> Camera {
    let [a, b, c, d, e, f, g, h, i, x, y, z] = *pose;
    let rotation = glam::Mat3::from_cols_array(&[a, b, c, d, e, f, g, h, i]).transpose();
    Camera { camera_from_world: rotation, translation: glam::Vec3::new(x, y, z), ..*camera }
}

/// Kernel of Adam over poses.
pub struct PoseOptimizer {
    kernel: Kernel<pose_step::Interface>,
    workgroup: u32,
}

impl PoseOptimizer {
    /// Builds the kernel.
    pub fn new(context: &Context) -> Result<Self> {
        let workgroup = LaunchSizes::new(context.limits()).elementwise_workgroup;
        let kernel = Kernel::new(context, &pose_step::Spec { workgroup_size: workgroup })?;
        Ok(Self { kernel, workgroup })
    }

    /// Records a step with the gradient of the given image, and computes the cameras of all images. All poses are one tensor,
    /// so those of other images decay and move as well. Without `step` only the cameras are computed. If `state`
    /// ([`FrameBuffers::state`](crate::frame::FrameBuffers)) has an overflow, nothing changes.
    pub fn record(
        &self,
        r: &mut Recorder,
        buffers: &PoseBuffers,
        state: &Buffer,
        step: Option<(PoseStep, u32)>,
    ) {
        let none = PoseStep { rate: 0.0, count: 1 };
        let (PoseStep { rate, count }, seen) = step.unwrap_or((none, 0));
        let images = (buffers.parameters.bytes() / PARAMETER_BYTES) as u32;
        let push = pose_step::Push {
            images,
            seen,
            makes_step: step.is_some().into(),
            rate: (rate / (1.0 - BETA_1.powf(count as f64))) as f32,
            inverse_bias_2: (1.0 - BETA_2.powf(count as f64)).sqrt().recip() as f32,
            weight_decay: WEIGHT_DECAY as f32,
        };
        let bind = pose_step::Bind {
            pose_gradient: &buffers.gradient,
            pose_starts: &buffers.starts,
            pose_parameters: &buffers.parameters,
            pose_moments: &buffers.moments,
            pose_cameras: &buffers.cameras,
            state,
            pose_depths: &buffers.depths,
        };
        r.dispatch(&self.kernel, &bind, &push, images.div_ceil(self.workgroup).into());
    }
}
