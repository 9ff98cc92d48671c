//! The kernels of poses with their buffers.

use super::gpu::Gpu;
use ashsplat::kernels::constants::STATE_OVERFLOW;
use ashsplat::kernels::poses::{pose_gradient, pose_step};

/// Runs `poses/pose_gradient`: returns g and dL/dξ.
pub fn pose_gradient(gpu: &Gpu, sums: &[[f32; 6]], parameters: &[[f32; 6]], image: u32) -> [[f64; 6]; 2] {
    let (workgroup_size, subgroup_size) = (gpu.workgroup(64), gpu.subgroup());
    let gradient = gpu.untouched::<[f32; 6]>("pose_gradient", 2);
    let bind = pose_gradient::Bind {
        pose_sums: &gpu.buffer("pose_sums", sums),
        pose_parameters: &gpu.buffer("pose_parameters", parameters),
        pose_gradient: &gradient,
    };
    let push = pose_gradient::Push { sums: sums.len() as u32, image };
    let spec = pose_gradient::Spec { workgroup_size, subgroup_size };
    gpu.dispatch::<pose_gradient::Interface>(&spec, &bind, &push, 1);
    let [g, d_xi] = gpu.read::<[[f32; 6]; 2]>(&gradient, 1)[0];
    [g.map(f64::from), d_xi.map(f64::from)]
}

#[derive(Clone, Debug, PartialEq)]
pub struct Poses {
    /// ξ of each image.
    pub parameters: Vec<[f32; 6]>,
    /// First and second moments of each image.
    pub moments: Vec<[[f32; 6]; 2]>,
    /// Rotation by rows and translation of each image, without ξ.
    pub starts: Vec<[f32; 12]>,
    /// Same, but with ξ.
    pub cameras: Vec<[f32; 12]>,
    /// Depth of the point about which a step turns each camera; 0 for none.
    pub depths: Vec<f32>,
}

/// One step: image, its dL/dξ, rate, count from 1.
pub type Step = (u32, [f32; 6], f64, u32);

/// Runs `poses/pose_step`; without a step it updates only the cameras.
pub fn pose_step(gpu: &Gpu, poses: &Poses, step: Option<Step>, overflow: u32) -> Poses {
    let spec = pose_step::Spec { workgroup_size: gpu.workgroup(64) };
    let kernel = gpu.kernel::<pose_step::Interface>(&spec);
    let images = poses.parameters.len();
    let (seen, gradient, rate, count) = step.unwrap_or((0, [f32::NAN; 6], 1.0, 1));
    let (parameters, moments) =
        (gpu.buffer("pose_parameters", &poses.parameters), gpu.buffer("pose_moments", &poses.moments));
    let cameras = gpu.buffer("pose_cameras", &poses.cameras);
    let bind = pose_step::Bind {
        // The first half has another meaning.
        pose_gradient: &gpu.buffer("pose_gradient", &[[f32::NAN; 6], gradient]),
        pose_starts: &gpu.buffer("pose_starts", &poses.starts),
        pose_parameters: &parameters,
        pose_moments: &moments,
        pose_cameras: &cameras,
        state: &gpu.frame_state(&[(STATE_OVERFLOW, overflow)]),
        pose_depths: &gpu.buffer("pose_depths", &poses.depths),
    };
    let correction = |beta: f64| 1.0 - beta.powi(count as i32);
    let push = pose_step::Push {
        images: images as u32,
        seen,
        makes_step: step.is_some().into(),
        rate: (rate / correction(0.9)) as f32,
        inverse_bias_2: correction(0.999).sqrt().recip() as f32,
        weight_decay: 1e-6,
    };
    gpu.run(|r| r.dispatch(&kernel, &bind, &push, images as u64 / u64::from(spec.workgroup_size) + 1));
    Poses {
        parameters: gpu.read(&parameters, images),
        moments: gpu.read(&moments, images),
        starts: poses.starts.clone(),
        depths: poses.depths.clone(),
        cameras: gpu.read(&cameras, images),
    }
}
