//! Density control within a box: masks the statistics of Gaussians outside.

use crate::error::Result;
use crate::forward::SceneBuffers;
use crate::kernels::densify::mask_outside;
use crate::plan::{LaunchSizes, blocks};
use crate::scene::{Bounds, Cut, CutLimits};
use crate::vk::{Buffer, Context, Kernel, Recorder};

/// Kernel that masks statistics outside a box.
pub struct MaskOutside {
    sizes: LaunchSizes,
    mask: Kernel<mask_outside::Interface>,
    core: CutLimits,
    absolute: bool,
}

impl MaskOutside {
    /// Builds the kernel for a box, whose sides may be infinite; `absolute`: it masks both statistics.
    ///
    /// # Errors
    /// When the device refuses a pipeline.
    pub fn new(context: &Context, core: Bounds, absolute: bool) -> Result<Self> {
        let sizes = LaunchSizes::new(context.limits());
        let mask = mask_outside::Spec { workgroup_size: sizes.elementwise_workgroup, absolute };
        let core = Cut { bounds: Some(core), ..Cut::default() }.limits();
        Ok(Self { mask: Kernel::new(context, &mask)?, sizes, core, absolute })
    }

    /// Records the mask, which sets the sums of Gaussians with means outside the box below every threshold. The sums lie in
    /// `statistics` (vec2 per Gaussian: sum of norms, number of views) and in `absolute` (f32 per Gaussian). Ends without a
    /// barrier.
    ///
    /// # Panics
    /// If the absolute statistic is missing although the kernel was built for it.
    pub fn record(
        &self,
        r: &mut Recorder,
        scene: &SceneBuffers,
        statistics: &Buffer,
        absolute: Option<&Buffer>,
    ) {
        assert_eq!(absolute.is_some(), self.absolute, "the statistics that it was built for");
        for range in scene.plan.ranges(scene.count) {
            if range.chunk > 0 {
                r.barrier();
            }
            let bind = mask_outside::Bind {
                parameters: &scene.chunks[range.chunk],
                statistics,
                // Without the absolute statistic the kernel does not write this binding.
                absolute_statistics: absolute.unwrap_or(statistics),
            };
            let push = mask_outside::Push {
                first: range.first,
                count: range.count,
                core_low: self.core.low.to_array(),
                core_high: self.core.high.to_array(),
            };
            let groups = blocks(range.count.into(), self.sizes.elementwise_workgroup.into());
            r.dispatch(&self.mask, &bind, &push, groups);
        }
    }
}
