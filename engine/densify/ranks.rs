//! Sorts opacities, for pruning the faintest share of a set.

use super::{Selection, SelectionBuffers};
use crate::forward::SceneBuffers;
use crate::kernels::constants as c;
use crate::kernels::densify::opacity_keys;
use crate::plan::blocks;
use crate::scan::Workgroups;
use crate::sort::Values;
use crate::vk::{Buffer, Recorder};

impl Selection {
    /// Records a sort of all opacities. A barrier must precede it; it ends with one. Returns the buffer with the result: f32
    /// per Gaussian, the faintest first.
    pub fn record_opacities<'a>(
        &self,
        r: &mut Recorder,
        scene: &SceneBuffers,
        buffers: &'a SelectionBuffers,
    ) -> &'a Buffer {
        r.scope("order opacities", |r| {
            r.fill(&buffers.total(c::TOTAL_GAUSSIANS), scene.count);
            for range in scene.plan.ranges(scene.count) {
                // All chunks write the same buffer.
                if range.chunk > 0 {
                    r.barrier();
                }
                let bind =
                    opacity_keys::Bind { parameters: &scene.chunks[range.chunk], keys: &buffers.keys[0] };
                let push = opacity_keys::Push { first: range.first, count: range.count };
                let groups = blocks(range.count.into(), self.sizes.elementwise_workgroup.into());
                r.dispatch(&self.opacity_keys, &bind, &push, groups);
            }
            r.barrier();
            let elements = Workgroups::Elements(scene.count.into());
            let end = self.sort.record(r, &buffers.pairs(), Values::Positions, u32::BITS, elements);
            r.barrier();
            &buffers.keys[end]
        })
    }
}
