//! The forward pass as a list of passes: cull → project → depth sort → count → duplicate → tile sort → ranges → blend.
//!
//! It follows the paper's pipeline, with two differences that change the cost but not the picture. First, the visible Gaussians
//! are sorted by depth before they are duplicated to (tile, Gaussian) instances. Second, a Gaussian touches a tile only if the
//! ellipse where alpha reaches 1/255 meets it.
//!
//! Several views may share the first passes. The kernels compute z of a Gaussian by the same arithmetic on the same numbers. So
//! cameras whose rows of z are equal to the bit, like those of a pair of eyes, give it the same depth. Focal lengths, sizes and
//! the other axes may differ. Gaussians that at least one view shows are compacted and sorted once. Each view then finds its own
//! Gaussians in that order, by depth, then by index: a Gaussian that only another view shows gets no tiles, so the order of the
//! rest is that of a separate sort.

use crate::error::Result;
use crate::frame::{
    Blending, FrameInputs, FrameVariant, LaunchSizes, record_blocks, record_cut_outs, record_scene_firsts,
};
use crate::kernels::constants as c;
use crate::passes::blend::Blend;
use crate::passes::cull::Cull;
use crate::passes::instances::Instances;
use crate::passes::project::Project;
use crate::passes::scan::Scan;
use crate::vk::{Context, Recorder};

/// The passes of a frame.
pub struct Forward {
    context: Context,
    pub(crate) sizes: LaunchSizes,
    scan: Scan,
    cull: Cull,
    project: Project,
    instances: Instances,
    blend: Blend,
}

impl Forward {
    /// Builds the kernels that every frame needs.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self {
            context: context.clone(),
            sizes: LaunchSizes::new(context.limits()),
            scan: Scan::new(context)?,
            cull: Cull::new(context)?,
            project: Project::new(context),
            instances: Instances::new(context)?,
            blend: Blend::new(context.limits()),
        })
    }

    /// Builds the missing kernels for an SH degree and a variant.
    pub fn prepare(&mut self, sh_degree: u32, variant: FrameVariant) -> Result<()> {
        self.prepare_scenes(sh_degree, variant, false)?;
        self.prepare_blend(variant)
    }

    /// Builds the missing kernels of blending for a variant.
    pub(crate) fn prepare_blend(&mut self, variant: FrameVariant) -> Result<()> {
        self.instances.prepare(&self.context, variant.projection)?;
        self.blend.prepare(&self.context, &self.sizes, variant)
    }

    /// Builds the kernel that frames with [`FrameInputs::hidden_by`] need.
    pub(crate) fn prepare_hiding(&mut self) -> Result<()> {
        self.instances.prepare_hiding(&self.context)
    }

    /// Builds the missing kernels of culling and projection for an SH degree and a variant. `batches`: also those of
    /// batches, if a batch may have the variant.
    pub(crate) fn prepare_scenes(
        &mut self,
        sh_degree: u32,
        variant: FrameVariant,
        batches: bool,
    ) -> Result<()> {
        let batches = batches && variant.may_be_batched();
        self.cull.prepare(&self.context, variant, batches)?;
        self.project.prepare(&self.context, sh_degree, variant, batches)
    }

    /// Sets the form of blending. Returns true if it has changed. Call it before [`Forward::prepare`].
    pub fn set_blending(&mut self, blending: Blending) -> bool {
        std::mem::replace(&mut self.blend.blending, blending) != blending
    }

    /// The form of blending.
    pub fn blending(&self) -> Blending {
        self.blend.blending
    }

    /// Records a frame. [`Forward::prepare`] must have been called for its variants. Ends without a barrier.
    ///
    /// # Panics
    /// If these variants are missing, if the buffer of cut-outs is too small, and for a tint, an opacity or a selection before
    /// a backward pass.
    pub fn record(&self, r: &mut Recorder, inputs: &FrameInputs) {
        self.record_first(r, 1, |_| *inputs);
    }

    /// Records the first of several views that share one depth order. Also writes the camera blocks of all these views and culls for
    /// all of them. The views have the same scenes, poses and settings, and their cameras give every Gaussian the same depth, bit for
    /// bit. `view` returns each view by its index, with [`FrameInputs::view`]. [`Forward::record_next`] records the others. Ends
    /// without a barrier.
    ///
    /// # Panics
    /// Same as [`Forward::record`], and if the buffer of camera blocks is too small for all views.
    pub fn record_first<'a>(&self, r: &mut Recorder, views: u32, view: impl Fn(u32) -> FrameInputs<'a>) {
        let inputs = &view(0);
        inputs.assert_differentiable();
        let f = inputs.buffers;
        r.scope("clear", |r| {
            (0..views).for_each(|number| record_blocks(r, &view(number)));
            record_cut_outs(r, inputs);
            record_scene_firsts(r, inputs);
            r.fill(&f.tile_ranges, 0);
        });
        pass(r, "cull", |r| {
            for number in 0..views {
                self.cull.record_flags(r, &view(number));
                r.barrier();
            }
            self.cull.record_compaction(r, inputs, &self.scan);
        });
        pass(r, "project", |r| self.project.record(r, inputs));
        pass(r, "depth sort", |r| self.instances.record_depth_sort(r, f));
        self.record_picture(r, inputs);
    }

    /// Records a further view with the order of the first, in the same buffers, after a barrier. Ends without a barrier.
    ///
    /// # Panics
    /// Same as [`Forward::record`].
    pub fn record_next(&self, r: &mut Recorder, inputs: &FrameInputs) {
        let f = inputs.buffers;
        pass(r, "clear", |r| {
            record_scene_firsts(r, inputs);
            // Clears all counts but those of the visible Gaussians.
            let counts = 4 * u64::from(c::STATE_INSTANCES_NEEDED);
            r.fill(&f.state.range(counts, f.state.bytes() - counts), 0);
            r.fill(&f.tile_ranges, 0);
        });
        pass(r, "project", |r| self.project.record(r, inputs));
        self.record_picture(r, inputs);
    }

    /// Records the passes from the order to the pixels.
    fn record_picture(&self, r: &mut Recorder, inputs: &FrameInputs) {
        pass(r, "count", |r| self.instances.record_count(r, inputs, &self.scan));
        pass(r, "duplicate", |r| self.instances.record_duplicate(r, inputs));
        pass(r, "tile sort", |r| self.instances.record_tile_sort(r, inputs));
        pass(r, "ranges", |r| self.instances.record_ranges(r, inputs));
        if let Some(photo) = inputs.hidden_by {
            pass(r, "hide tiles", |r| self.instances.record_hiding(r, inputs, photo));
        }
        r.scope("blend", |r| self.blend.record(r, inputs, &self.sizes));
    }
}

/// Records a pass and the barrier after it.
fn pass(r: &mut Recorder, name: &'static str, record: impl FnOnce(&mut Recorder)) {
    r.scope(name, |r| {
        record(r);
        r.barrier();
    });
}
