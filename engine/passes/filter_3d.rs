//! Mip-Splatting's 3D filter (Yu et al. 2024, section 5.1): convolves each Gaussian with a filter as large as the finest detail
//! that the nearest camera resolves. A rolling shutter counts with its pose halfway, a lens that is optimised as it was given.
//!
//! The device stores a size as the fourth component of a Gaussian's log-scales; 0 is none. Culling, projection and the backward
//! pass read it if [`RenderSettings::filter_3d`](crate::RenderSettings::filter_3d) is set.

use crate::error::{Error, Result};
use crate::frame::{LaunchSizes, POSE_BYTES, SceneBuffers, array_of, pose_of, to_u32};
use crate::kernels::constants::STATE_WORDS;
use crate::kernels::forward::{filter_sizes, nearest_depths};
use crate::scene::Camera;
use crate::scene::camera::EDGE_MARGIN;
use crate::vk::{Buffer, Context, Kernel, MemoryKind, Recorder};

/// Variance of the filter, in squares of a pixel's size at the nearest depth.
const VARIANCE_PX2: f64 = 0.2;

/// Kernels of the filter, with the cameras.
pub struct Filter3d {
    sizes: LaunchSizes,
    nearest: Kernel<nearest_depths::Interface>,
    store: Kernel<filter_sizes::Interface>,
    poses: Buffer,
    bounds: Buffer,
    farthest: Buffer,
    count: u32,
    size_per_depth: f32,
}

impl Filter3d {
    /// Names and bytes of the buffers for a number of cameras.
    pub fn requests(cameras: usize) -> [(&'static str, u64); 3] {
        let cameras = cameras as u64;
        [("filter_poses", cameras * POSE_BYTES), ("filter_bounds", cameras * 16), ("farthest", 4)]
    }

    /// Builds the kernels and uploads the training cameras. `poses`: those that the device moves, [`POSE_BYTES`] per camera, in the
    /// layout of [`FrameInputs::pose`](crate::frame::FrameInputs::pose).
    ///
    /// # Errors
    /// [`Error::Argument`] without cameras, and for an orthographic one; memory or device failures.
    pub fn new(context: &Context, cameras: &[Camera], poses: Option<Buffer>) -> Result<Self> {
        let longest = cameras.iter().map(|camera| camera.fx).fold(0.0, f32::max);
        if longest <= 0.0 {
            return Err(Error::argument("cameras", "there are none, and the 3D filter follows from them"));
        }
        cameras.iter().try_for_each(Camera::check_differentiable)?;
        let requests = Self::requests(cameras.len());
        let buffers = context.allocate("filter", &requests, MemoryKind::Device)?;
        let [given_poses, bounds, farthest] = array_of(buffers);
        let given: Vec<[f32; 12]> = cameras.iter().map(pose_of).collect();
        context.upload(&given_poses, bytemuck::cast_slice(&given))?;
        let slopes: Vec<[[f32; 2]; 2]> = cameras.iter().map(shown).collect();
        context.upload(&bounds, bytemuck::cast_slice(&slopes))?;
        let sizes = LaunchSizes::new(context.limits());
        let (workgroup_size, subgroup_size) = (sizes.elementwise_workgroup, context.limits().subgroup_size);
        Ok(Self {
            nearest: Kernel::new(context, &nearest_depths::Spec { workgroup_size, subgroup_size })?,
            store: Kernel::new(context, &filter_sizes::Spec { workgroup_size })?,
            sizes,
            poses: poses.unwrap_or(given_poses),
            bounds,
            farthest,
            count: to_u32(cameras.len() as u64)?,
            size_per_depth: (VARIANCE_PX2.sqrt() / f64::from(longest)) as f32,
        })
    }

    /// Records the computation of all sizes of a scene. If `state[STATE_OVERFLOW]` is set, nothing changes.
    pub fn record(&self, r: &mut Recorder, scene: &SceneBuffers, state: &Buffer) {
        r.scope("3D filter", |r| {
            r.fill(&self.farthest, 0);
            for range in scene.plan.ranges(scene.count) {
                r.barrier();
                let bind = nearest_depths::Bind {
                    parameters: &scene.chunks[range.chunk],
                    bounds: &self.bounds,
                    state,
                    farthest: &self.farthest,
                    poses: &self.poses,
                };
                let push = nearest_depths::Push { count: range.count, cameras_count: self.count };
                r.dispatch(&self.nearest, &bind, &push, self.sizes.groups(range.count));
            }
            r.barrier();
            for range in scene.plan.ranges(scene.count) {
                let bind = filter_sizes::Bind {
                    parameters: &scene.chunks[range.chunk],
                    state,
                    farthest: &self.farthest,
                };
                let push = filter_sizes::Push { count: range.count, size_per_depth: self.size_per_depth };
                r.dispatch(&self.store, &bind, &push, self.sizes.groups(range.count));
            }
        });
    }

    /// Computes all sizes of a scene immediately.
    pub fn run(&self, context: &Context, scene: &SceneBuffers) -> Result<()> {
        let request = [("state", u64::from(STATE_WORDS) * 4)];
        let state = context.allocate("filter", &request, MemoryKind::Device)?.remove(0);
        let ran = context.run("3D filter", |r| {
            r.fill(&state, 0);
            r.barrier();
            self.record(r, scene, &state);
        });
        ran.map(drop)
    }
}

/// Limits within which a mean counts as visible: of x/z and y/z, or for fisheyes and panoramas, behind limits that exclude each
/// other, the cosine of the widest angle from the axis.
fn shown(camera: &Camera) -> [[f32; 2]; 2] {
    if let Some(slopes) = camera.shown_slopes(EDGE_MARGIN) {
        return slopes.map(|range| range.map(|slope| slope as f32));
    }
    let (rays, [width, height]) = (camera.photo_lens().rays(), [camera.width, camera.height].map(f64::from));
    let corners = [[0.0, 0.0], [width, 0.0], [0.0, height], [width, height]];
    let cosines = corners.map(|corner| rays(corner.into()).map_or(-1.0, |ray| ray.z));
    // A panorama's corners are its poles.
    let cosine = if camera.projection.has_seam() { -1.0 } else { cosines.into_iter().fold(1.0, f64::min) };
    [[1.0, -1.0], [cosine as f32, 0.0]]
}
