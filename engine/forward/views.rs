//! Order of a frame's stages, also for several views that share some of them.
//!
//! The kernels compute z of a Gaussian by the same arithmetic on the same numbers. So cameras whose rows of z are equal to the
//! bit, like those of a pair of eyes, give it the same depth. Focal lengths, sizes and the other axes may differ. Gaussians
//! that at least one view shows are compacted and sorted once. Each view then finds its own Gaussians in the order of a
//! separate sort: by depth, then by index. The others touch none of its tiles.

use super::{Forward, FrameInputs, camera_block, inputs};
use crate::kernels::constants as c;
use crate::vk::Recorder;

impl Forward {
    /// Records a frame. [`Forward::prepare`] must have been called for its variants. Ends without a barrier.
    ///
    /// # Panics
    /// If these variants are missing, if the buffer of cut-outs is too small, and for a tint, an opacity or a selection before
    /// a backward pass.
    pub fn record(&self, r: &mut Recorder, inputs: &FrameInputs) {
        self.record_first(r, 1, |_| *inputs);
    }

    /// Records the first of `views` views with one order. They show the same scenes in the same poses and settings, and their
    /// cameras give each Gaussian the same depth to the bit. `view` returns each view by its index, with [`FrameInputs::view`].
    /// [`Forward::record_next`] records the others. Ends without a barrier.
    ///
    /// # Panics
    /// Same as [`Forward::record`], and if the buffer of camera blocks is too small for all views.
    pub fn record_first<'a>(&self, r: &mut Recorder, views: u32, view: impl Fn(u32) -> FrameInputs<'a>) {
        let inputs = &view(0);
        inputs.assert_differentiable();
        let f = inputs.frame;
        r.scope("clear", |r| {
            (0..views).for_each(|number| camera_block::record_blocks(r, &view(number)));
            camera_block::record_cut_outs(r, inputs);
            inputs::record_firsts(r, inputs);
            let overflow = 4 * u64::from(c::STATE_OVERFLOW);
            match inputs.keeps_overflow {
                false => r.fill(&f.state, 0),
                true => {
                    r.fill(&f.state.range(0, overflow), 0);
                    r.fill(&f.state.range(overflow + 4, f.state.bytes() - overflow - 4), 0);
                }
            }
            r.fill(&f.tile_ranges, 0);
        });
        r.scope("cull", |r| {
            (0..views).for_each(|number| self.record_flags(r, &view(number)));
            self.record_compaction(r, inputs);
        });
        r.scope("project", |r| self.record_project(r, inputs));
        r.scope("depth sort", |r| self.record_depth_sort(r, f));
        self.record_picture(r, inputs);
    }

    /// Records a further view with the order of the first, in the same buffers, after a barrier. Ends without a barrier.
    ///
    /// # Panics
    /// Same as [`Forward::record`].
    pub fn record_next(&self, r: &mut Recorder, inputs: &FrameInputs) {
        let f = inputs.frame;
        r.scope("clear", |r| {
            inputs::record_firsts(r, inputs);
            // Clears all counts but those of the visible Gaussians.
            let counts = 4 * u64::from(c::STATE_INSTANCES_NEEDED);
            r.fill(&f.state.range(counts, f.state.bytes() - counts), 0);
            r.fill(&f.tile_ranges, 0);
            r.barrier();
        });
        r.scope("project", |r| self.record_project(r, inputs));
        self.record_picture(r, inputs);
    }

    /// Records the stages from the order to the pixels.
    fn record_picture(&self, r: &mut Recorder, inputs: &FrameInputs) {
        r.scope("count", |r| self.record_count(r, inputs));
        r.scope("duplicate", |r| self.record_duplicate(r, inputs));
        r.scope("tile sort", |r| self.record_tile_sort(r, inputs));
        r.scope("ranges", |r| self.record_ranges(r, inputs));
        r.scope("blend", |r| self.blend.record(r, inputs, &self.sizes));
    }
}
