//! Poses of the training views, optimised with the scene.

use super::checkpoint::PoseState;
use super::settings::TrainSettings;
use crate::error::{Error, Result};
use crate::frame::{FrameInputs, POSE_BYTES};
use crate::kernels::constants::STATE_WORDS;
use crate::passes::poses::{PoseBuffers, PoseGradient, PoseOptimizer, PoseStep, camera_at, pose_of};
use crate::scene::{Camera, Gaussians, NEAR_PLANE};
use crate::vk::{Buffer, Context, MemoryKind, Recorder};
use glam::Vec3;

/// Maximum number of Gaussians that [`mean_depth`] samples. It runs once per camera, and a mean needs no more.
const DEPTH_SAMPLES: usize = 1 << 16;

/// Kernels and buffers of a run that optimises poses.
pub(super) struct Poses {
    gradient: PoseGradient,
    optimizer: PoseOptimizer,
    buffers: PoseBuffers,
    /// Per view: range of its camera on the device.
    cameras: Vec<Buffer>,
}

/// Names and bytes of the buffers; empty unless the run optimises poses.
pub(super) fn requests(settings: &TrainSettings, views: usize) -> Vec<(&'static str, u64)> {
    match settings.pose_opt {
        true => PoseBuffers::requests(views as u32),
        false => Vec::new(),
    }
}

impl Poses {
    /// Starts with all cameras as given. None unless the settings optimise poses.
    pub fn new(
        context: &Context,
        settings: &TrainSettings,
        cameras: &[Camera],
        initial: &Gaussians,
    ) -> Result<Option<Self>> {
        if !settings.pose_opt {
            return Ok(None);
        }
        let buffers = context.allocate("poses", &requests(settings, cameras.len()), MemoryKind::Device)?;
        let buffers = PoseBuffers::from_allocated(buffers);
        let starts: Vec<[f32; 12]> = cameras.iter().map(pose_of).collect();
        context.upload(&buffers.starts, bytemuck::cast_slice(&starts))?;
        let depths: Vec<f32> = cameras.iter().map(|camera| mean_depth(camera, &initial.means)).collect();
        context.upload(&buffers.depths, bytemuck::cast_slice(&depths))?;
        let at = |view: usize| buffers.cameras.range(view as u64 * POSE_BYTES, POSE_BYTES);
        let poses = Self {
            gradient: PoseGradient::new(context)?,
            optimizer: PoseOptimizer::new(context)?,
            cameras: (0..cameras.len()).map(at).collect(),
            buffers,
        };
        context.run("clear poses", |r| {
            let PoseBuffers { parameters, moments, gradient, .. } = &poses.buffers;
            [parameters, moments, gradient].into_iter().for_each(|buffer| r.fill(buffer, 0));
        })?;
        poses.make_cameras(context)?;
        Ok(Some(poses))
    }

    /// Computes the cameras from the parameters. The same parameters give the same bits, here and in steps.
    fn make_cameras(&self, context: &Context) -> Result<()> {
        let state =
            context.allocate("poses", &[("state", u64::from(STATE_WORDS) * 4)], MemoryKind::Device)?;
        let made = context.run("make cameras", |r| {
            r.fill(&state[0], 0);
            r.barrier();
            self.optimizer.record(r, &self.buffers, &state[0], None);
        });
        made.map(drop)
    }

    /// See [`FrameInputs::pose`].
    pub fn camera(&self, view: usize) -> &Buffer {
        &self.cameras[view]
    }

    /// Records the gradient of a pose, and a step, after a backward pass with such a gradient. The caller places barriers before
    /// and after.
    pub fn record(&self, r: &mut Recorder, inputs: &FrameInputs, view: usize, step: &PoseStep) {
        let view = view as u32;
        r.scope("poses", |r| {
            self.gradient.record(r, inputs, &self.buffers.parameters, view, &self.buffers.gradient);
            r.barrier();
            self.optimizer.record(r, &self.buffers, &inputs.buffers.state, Some((*step, view)));
        });
    }

    /// All cameras, one after the other.
    pub fn all_cameras(&self) -> &Buffer {
        &self.buffers.cameras
    }

    /// Current cameras.
    pub fn moved(&self, context: &Context, cameras: &[Camera]) -> Result<Vec<Camera>> {
        let bytes = context.download(&self.buffers.cameras)?;
        let poses: Vec<[f32; 12]> = bytemuck::pod_collect_to_vec(&bytes);
        Ok(cameras.iter().zip(&poses).map(|(camera, pose)| camera_at(camera, pose)).collect())
    }

    pub fn state(&self, context: &Context) -> Result<PoseState> {
        let parameters = context.download(&self.buffers.parameters)?;
        let moments: Vec<[f32; 6]> = bytemuck::pod_collect_to_vec(&context.download(&self.buffers.moments)?);
        // The buffer has a minimum size.
        let depths = self.buffers.depths.range(0, 4 * self.cameras.len() as u64);
        let every_second = |first: usize| moments.iter().skip(first).step_by(2).copied().collect();
        Ok(PoseState {
            parameters: bytemuck::pod_collect_to_vec(&parameters),
            first_moments: every_second(0),
            second_moments: every_second(1),
            depths: bytemuck::pod_collect_to_vec(&context.download(&depths)?),
        })
    }

    pub fn restore(&self, context: &Context, from: &PoseState) -> Result<()> {
        if from.parameters.len() != self.cameras.len() {
            let (there, here) = (from.parameters.len(), self.cameras.len());
            let problem = format!("has the poses of {there} views, here are {here}");
            return Err(Error::argument("checkpoint", problem));
        }
        let moments: Vec<[[f32; 6]; 2]> =
            from.first_moments.iter().zip(&from.second_moments).map(|(&m, &v)| [m, v]).collect();
        context.upload(&self.buffers.parameters, bytemuck::cast_slice(&from.parameters))?;
        context.upload(&self.buffers.moments, bytemuck::cast_slice(&moments))?;
        context.upload(&self.buffers.depths, bytemuck::cast_slice(&from.depths))?;
        self.make_cameras(context)
    }
}

/// Harmonic mean of the depths of the means that a camera shows, world units; 0 if it shows none. Samples many means evenly.
pub(super) fn mean_depth(camera: &Camera, means: &[[f32; 3]]) -> f32 {
    let inverse = |&mean: &[f32; 3]| {
        let mean = Vec3::from_array(mean);
        let (_, _, depth) = camera.project(mean);
        (camera.sees(mean) && depth > NEAR_PLANE).then(|| 1.0 / f64::from(depth))
    };
    let every = means.len().div_ceil(DEPTH_SAMPLES).max(1);
    let (seen, sum) = (means.iter().step_by(every).filter_map(inverse))
        .fold((0_u32, 0.0), |(seen, sum), inverse| (seen + 1, sum + inverse));
    if seen == 0 { 0.0 } else { (f64::from(seen) / sum) as f32 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Intrinsics;

    #[test]
    fn depths_are_of_what_a_camera_sees() {
        let camera =
            Camera::look_at(Vec3::NEG_Z, Vec3::ZERO, Vec3::NEG_Y, Intrinsics::from_fov_x(0.7, 40, 30));
        let near = [0.0, 0.0, 1.0];
        let far = [0.1, -0.1, 5.0];
        assert_eq!(mean_depth(&camera, &[near]), 2.0);
        // 2 / (1/2 + 1/6).
        assert!((mean_depth(&camera, &[near, far]) - 3.0).abs() < 1e-6);
        let out_of_view = [[0.0, 0.0, -3.0], [0.0, 0.0, -0.9], [9.0, 0.0, 1.0], [0.0, f32::NAN, 1.0]];
        assert_eq!(mean_depth(&camera, &out_of_view), 0.0);
        assert_eq!(mean_depth(&camera, &[&out_of_view[..], &[near]].concat()), 2.0);
        assert_eq!(mean_depth(&camera, &[]), 0.0);
        // Three times the sample limit: every third is read.
        let many: Vec<[f32; 3]> =
            (0..3 * DEPTH_SAMPLES).map(|i| if i % 3 == 0 { near } else { far }).collect();
        assert_eq!(mean_depth(&camera, &many), 2.0);
    }
}
