//! Culling: flags the visible Gaussians of all scenes and compacts them, in their order. It runs the same projection as
//! [`Project`](super::project::Project), for the visibility only.

use super::scan::{DeviceCount, Scan};
use crate::error::Result;
use crate::frame::{Batch, FrameInputs, FrameVariant, LaunchSizes, ShStorage};
use crate::kernels::constants as c;
use crate::kernels::forward::{compact, cull, cull_scenes};
use crate::vk::{Context, Kernel, KernelSet, Recorder};

pub(crate) struct Cull {
    sizes: LaunchSizes,
    subgroup_size: u32,
    max_workgroups_per_axis: u32,
    scene: KernelSet<cull::Interface>,
    batch: KernelSet<cull_scenes::Interface>,
    compact: Kernel<compact::Interface>,
}

impl Cull {
    pub fn new(context: &Context) -> Result<Self> {
        let limits = context.limits();
        let sizes = LaunchSizes::new(limits);
        let (workgroup_size, subgroup_size) = (sizes.elementwise_workgroup, limits.subgroup_size);
        // Compaction blocks are the culling blocks.
        let compact = compact::Spec { workgroup_size, subgroup_size, block: workgroup_size };
        Ok(Self {
            sizes,
            subgroup_size,
            max_workgroups_per_axis: limits.max_workgroups_per_axis,
            scene: KernelSet::default(),
            batch: KernelSet::default(),
            compact: Kernel::new(context, &compact)?,
        })
    }

    /// Builds the missing kernels of a variant; `batches`: also that of batches.
    pub fn prepare(&mut self, context: &Context, variant: FrameVariant, batches: bool) -> Result<()> {
        self.scene.prepare(context, self.spec(variant))?;
        if batches {
            self.batch.prepare(context, self.batch_spec(variant))?;
        }
        Ok(())
    }

    fn spec(&self, variant: FrameVariant) -> cull::Spec {
        let FrameVariant { filter_3d, dropout, tinted, cut_outs, projection, shutter, shared_order, .. } =
            variant;
        let (workgroup_size, subgroup_size) = (self.sizes.elementwise_workgroup, self.subgroup_size);
        cull::Spec {
            workgroup_size,
            subgroup_size,
            filter_3d,
            dropout,
            tinted,
            cut_outs,
            projection: projection as u32,
            lenses: variant.has_lens(),
            shared_order,
            shutter,
        }
    }

    fn batch_spec(&self, variant: FrameVariant) -> cull_scenes::Spec {
        let FrameVariant { filter_3d, tinted, cut_outs, projection, shutter, shared_order, .. } = variant;
        let (workgroup_size, subgroup_size) = (self.sizes.elementwise_workgroup, self.subgroup_size);
        cull_scenes::Spec {
            workgroup_size,
            subgroup_size,
            filter_3d,
            tinted,
            cut_outs,
            projection: projection as u32,
            lenses: variant.has_lens(),
            shared_order,
            shutter,
        }
    }

    /// Records the flags of a view's visible Gaussians. With a shared order, each view after the first adds its visible
    /// Gaussians to those of earlier views. A barrier precedes each dispatch, also the first.
    pub fn record_flags(&self, r: &mut Recorder, inputs: &FrameInputs) {
        let f = inputs.buffers;
        let [extent, antialias] = inputs.settings.modes();
        let [shutter_turn, shutter_shift, shutter_rows] = inputs.camera.shutter_words();
        let of_frame = FrameVariant { shared_order: inputs.view > Some(0), ..inputs.variant() };
        for batch in inputs.batches.list {
            r.barrier();
            self.record_batch_flags(r, inputs, batch, of_frame);
        }
        for part in inputs.parts() {
            let variant = of_frame.of_scene(ShStorage::F32, part.settings);
            let Some(kernel) = r.kernel(&self.scene, &self.spec(variant)) else { return };
            let push = cull::Push {
                first: part.first_in_frame,
                count: part.count,
                chunk_gaussians: part.scene.plan.chunk_gaussians,
                extent,
                antialias,
                first_cut_out: part.first_cut_out,
                cut_out_count: part.settings.cut_out_count(),
                flag_count: part.flags,
                shutter_turn,
                shutter_shift,
                shutter_rows,
            };
            let bind = cull::Bind {
                parameters: &part.scene.chunks[part.chunk],
                visible_flags: &f.visible_flags,
                block_counts: &f.visible_blocks,
                // Without cut-outs the kernel does not read this binding. With cut-outs, `record` has checked the buffer.
                cut_outs: inputs.cut_outs.unwrap_or(&part.scene.chunks[part.chunk]),
                camera_block: &f.camera_block(part.block),
            };
            r.barrier();
            r.dispatch(kernel, &bind, &push, self.sizes.groups(part.flags));
        }
    }

    /// Records the flags of a batch in a frame of this variant.
    fn record_batch_flags(
        &self,
        r: &mut Recorder,
        inputs: &FrameInputs,
        batch: &Batch,
        of_frame: FrameVariant,
    ) {
        let first = &inputs.scenes[batch.first as usize];
        let spec = self.batch_spec(of_frame.of_scene(ShStorage::F32, first.settings));
        let Some(kernel) = r.kernel(&self.batch, &spec) else { return };
        let ([extent, antialias], f) = (inputs.settings.modes(), inputs.buffers);
        let [first_block, end_block] = batch.blocks(self.sizes.elementwise_workgroup);
        let parameters = first.scene.chunks[0].whole();
        let [shutter_turn, shutter_shift, shutter_rows] = inputs.camera.shutter_words();
        let push = cull_scenes::Push {
            first_block,
            end_block,
            scenes: inputs.scenes.len() as u32,
            batch: batch.first,
            index_count: inputs.index_count(),
            extent,
            antialias,
            shutter_turn,
            shutter_shift,
            shutter_rows,
        };
        let bind = cull_scenes::Bind {
            parameters: &parameters,
            visible_flags: &f.visible_flags,
            block_counts: &f.visible_blocks,
            // Same as for a single scene.
            cut_outs: inputs.cut_outs.unwrap_or(&parameters),
            scene_blocks: &inputs.camera_blocks(),
        };
        r.dispatch(kernel, &bind, &push, (end_block - first_block).into());
    }

    /// Records the compaction of the visible Gaussians, which keep their order, and their ranges.
    pub fn record_compaction(&self, r: &mut Recorder, inputs: &FrameInputs, scan: &Scan) {
        let f = inputs.buffers;
        let (count, block) = (inputs.index_count(), self.sizes.elementwise_workgroup);
        let culled_blocks = count.div_ceil(block);
        // The scan turns the counts into offsets, in place.
        let counted = DeviceCount {
            frame: f,
            count: c::STATE_VISIBLE_NEEDED,
            capacity: inputs.capacity.visible,
            first_argument: c::ARGUMENTS_VISIBLE,
            caller_block: self.sizes.scan_block,
            keeps_overflow: inputs.keeps_overflow,
        };
        scan.record_counted_sums(r, &f.visible_blocks, Some(culled_blocks), counted);
        r.barrier();
        let scenes = inputs.scenes.len() as u32;
        // One block per subgroup.
        let groups = culled_blocks.div_ceil(block / self.subgroup_size).max(scenes.div_ceil(block));
        r.dispatch(
            &self.compact,
            &compact::Bind {
                visible_flags: &f.visible_flags,
                block_offsets: &f.visible_blocks,
                visible_list: &f.visible_list,
                visible_index: &f.visible_index,
                state: &f.state,
                visible_ranges: &f.visible_ranges,
                scene_blocks: &inputs.camera_blocks(),
            },
            &compact::Push {
                count,
                capacity: inputs.capacity.visible,
                scenes,
                max_workgroups_per_axis: self.max_workgroups_per_axis,
            },
            groups.into(),
        );
    }
}
