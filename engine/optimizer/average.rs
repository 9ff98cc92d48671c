//! Mean of the parameters over the last steps of a run.

use crate::error::Result;
use crate::forward::SceneBuffers;
use crate::kernels::constants::PLANE_ROW;
use crate::kernels::optimizer::average;
use crate::plan::{LaunchSizes, blocks, plane_group};
use crate::vk::{Buffer, Context, Kernel, Recorder};

/// Bytes of a vec4.
const TEXEL_BYTES: u64 = 16;

/// Work on the means of parameters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MeanStep {
    /// Adds the parameters to the means; the number of steps includes this one. Step 1 starts the means.
    Adds(u32),
    /// Replaces the parameters by the means.
    Ends,
}

/// Kernel of the averaging.
pub struct Averaging {
    sizes: LaunchSizes,
    kernel: Kernel<average::Interface>,
}

impl Averaging {
    /// Builds the kernel.
    ///
    /// # Errors
    /// When the device refuses the pipeline.
    pub fn new(context: &Context) -> Result<Self> {
        let sizes = LaunchSizes::new(context.limits());
        let spec = average::Spec { workgroup_size: sizes.elementwise_workgroup };
        Ok(Self { kernel: Kernel::new(context, &spec)?, sizes })
    }

    /// Records the step for a scene's parameters. `means` have the same layout, one buffer per chunk. If `state` has an
    /// overflow, nothing changes. The caller places barriers before and after.
    pub fn record_scene(
        &self,
        r: &mut Recorder,
        scene: &SceneBuffers,
        (means, state): (&[Buffer], &Buffer),
        step: MeanStep,
    ) {
        r.scope("average", |r| {
            for range in scene.plan.ranges(scene.count) {
                let rows = range.count.div_ceil(PLANE_ROW) * PLANE_ROW;
                let mut plane = 0;
                while plane < scene.plan.planes {
                    let group = plane_group(plane);
                    plane = group.end;
                    let first = u64::from(group.start) * u64::from(scene.plan.chunk_gaussians);
                    let bytes = u64::from(group.end - group.start) * u64::from(rows) * TEXEL_BYTES;
                    let part = |chunks: &[Buffer]| chunks[range.chunk].range(first * TEXEL_BYTES, bytes);
                    self.dispatch(r, [&part(&scene.chunks), &part(means), state], step);
                }
            }
        });
    }

    /// Same as [`Averaging::record_scene`], but for whole buffers of vec4.
    pub fn record(&self, r: &mut Recorder, [values, means, state]: [&Buffer; 3], step: MeanStep) {
        r.scope("average", |r| self.dispatch(r, [values, means, state], step));
    }

    fn dispatch(&self, r: &mut Recorder, [values, means, state]: [&Buffer; 3], step: MeanStep) {
        let push = average::Push {
            count: (values.bytes() / TEXEL_BYTES) as u32,
            weight: match step {
                MeanStep::Adds(steps) => 1.0 / steps as f32,
                MeanStep::Ends => 0.0,
            },
            ends: (step == MeanStep::Ends).into(),
        };
        let groups = blocks(push.count.into(), self.sizes.elementwise_workgroup.into());
        r.dispatch(&self.kernel, &average::Bind { values, means, state }, &push, groups);
    }
}
