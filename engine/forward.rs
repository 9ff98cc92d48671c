//! The forward pass: project → count → scan → duplicate → sort → ranges → blend.
//!
//! It follows the paper's pipeline, with two differences that change the cost but not the picture. First, the visible Gaussians
//! are sorted by depth before they are duplicated to (tile, Gaussian) instances. Only the instances' tile bits then remain to
//! be sorted, and the order is that of the 64-bit (tile | depth) key. Second, a Gaussian touches a tile only if the ellipse
//! where alpha reaches 1/255 meets it.

mod batches;
mod blending;
mod camera_block;
mod filter_3d;
mod inputs;
mod instances;
mod motion;
mod settings;
mod views;

pub(crate) use batches::LEAST_SCENES;
pub(crate) use blending::record_passes;
pub use blending::{BlendVariant, Blending};
pub(crate) use camera_block::CUT_OUT_BYTES;
use camera_block::arguments;
pub(crate) use camera_block::block_of;
pub(crate) use camera_block::range_arguments;
pub use camera_block::{POSE_BYTES, pose_of};
pub use filter_3d::Filter3d;
pub(crate) use inputs::Parameters;
pub use inputs::{Auxiliary, Before, MotionBuffers, PickBuffers, Seen};
pub use inputs::{Batch, FrameInputs, PlacedScene, SceneBuffers};
pub use settings::{Dropout, Extent, JacobianLimit, RenderSettings};
pub use settings::{ELLIPSOID_SIGMAS, POINT_RADIUS_PX, Shape};
pub use settings::{MAX_TINT, SceneSettings, Selection};

use crate::error::Result;
use crate::kernels::constants as c;
use crate::kernels::forward::{
    compact, count, cull, cull_scenes, duplicate_with_tiles, project, project_scenes, ranges, screen_motion,
    write_indirect_args, write_visible_ranges,
};
use crate::plan::{FrameBuffers, GaussianRange, LaunchSizes, blocks};
use crate::scan::{Scan, ScanBuffers, Workgroups};
use crate::sort::{RadixSort, SortBuffers, Values};
use crate::vk::{Context, Kernel, KernelSet, Recorder};

/// The kernels of the forward pass.
pub struct Forward {
    context: Context,
    pub(crate) sizes: LaunchSizes,
    scan: Scan,
    sort: RadixSort,
    cull: KernelSet<cull::Interface>,
    cull_scenes: KernelSet<cull_scenes::Interface>,
    compact: Kernel<compact::Interface>,
    write_indirect_args: Kernel<write_indirect_args::Interface>,
    write_visible_ranges: Kernel<write_visible_ranges::Interface>,
    project: KernelSet<project::Interface>,
    project_scenes: KernelSet<project_scenes::Interface>,
    count: Kernel<count::Interface>,
    /// For frames without and with backward.
    duplicate: [Kernel<duplicate_with_tiles::Interface>; 2],
    ranges: [Kernel<ranges::Interface>; 2],
    blend: blending::Blend,
    screen_motion: KernelSet<screen_motion::Interface>,
}

impl Forward {
    /// Builds the kernels that every frame needs.
    ///
    /// # Errors
    /// When the device refuses a pipeline.
    pub fn new(context: &Context) -> Result<Self> {
        let limits = context.limits();
        let sizes = LaunchSizes::new(limits);
        let (workgroup_size, subgroup_size) = (sizes.elementwise_workgroup, limits.subgroup_size);
        let duplicate = |for_backward| {
            let spec = duplicate_with_tiles::Spec {
                workgroup_size,
                subgroup_size,
                items: sizes.duplicate_items,
                for_backward,
            };
            Kernel::new(context, &spec)
        };
        let ranges = |for_backward| Kernel::new(context, &ranges::Spec { workgroup_size, for_backward });
        Ok(Self {
            context: context.clone(),
            sizes,
            scan: Scan::new(context)?,
            sort: RadixSort::new(context)?,
            cull: KernelSet::default(),
            cull_scenes: KernelSet::default(),
            // Compaction blocks are the culling blocks.
            compact: Kernel::new(
                context,
                &compact::Spec { workgroup_size, subgroup_size, block: workgroup_size },
            )?,
            write_indirect_args: Kernel::new(context, &write_indirect_args::Spec::default())?,
            write_visible_ranges: Kernel::new(context, &write_visible_ranges::Spec { workgroup_size })?,
            project: KernelSet::default(),
            project_scenes: KernelSet::default(),
            count: Kernel::new(
                context,
                &count::Spec { workgroup_size: sizes.scan_workgroup, subgroup_size, items: sizes.scan_items },
            )?,
            duplicate: [duplicate(false)?, duplicate(true)?],
            ranges: [ranges(false)?, ranges(true)?],
            blend: blending::Blend::new(limits),
            screen_motion: KernelSet::default(),
        })
    }

    /// Builds the missing variants for an SH degree, with or without inverse depth.
    ///
    /// # Errors
    /// When the device refuses a pipeline.
    pub fn prepare(&mut self, sh_degree: u32, inverse_depth: bool) -> Result<()> {
        self.prepare_variant(sh_degree, BlendVariant { inverse_depth, ..BlendVariant::default() })
    }

    /// Builds the missing kernels for an SH degree and a variant of blending.
    ///
    /// # Errors
    /// When the device refuses a pipeline.
    pub fn prepare_variant(&mut self, sh_degree: u32, variant: BlendVariant) -> Result<()> {
        self.cull.prepare(&self.context, self.cull_spec(variant))?;
        self.project.prepare(&self.context, variant.project_spec(&self.sizes, sh_degree))?;
        for spec in self.motion_specs(variant).collect::<Vec<_>>() {
            self.screen_motion.prepare(&self.context, spec)?;
        }
        self.blend.prepare(&self.context, &self.sizes, variant)
    }

    /// True if all kernels for an SH degree and a variant of blending are built.
    pub fn is_prepared(&self, sh_degree: u32, variant: BlendVariant) -> bool {
        self.project.contains(&variant.project_spec(&self.sizes, sh_degree))
            && self.cull.contains(&self.cull_spec(variant))
            && self.motion_specs(variant).all(|spec| self.screen_motion.contains(&spec))
            && self.blend.is_prepared(&self.sizes, variant)
    }

    fn cull_spec(&self, variant: BlendVariant) -> cull::Spec {
        variant.cull_spec(&self.sizes, self.context.limits().subgroup_size)
    }

    /// Sets the form of blending. Returns true if it has changed. Call it before [`Forward::prepare`].
    pub fn set_blending(&mut self, blending: Blending) -> bool {
        self.blend.choose(blending)
    }

    /// The form of blending.
    pub fn blending(&self) -> Blending {
        self.blend.blending()
    }

    /// Records culling. With a shared order, each view after the first adds its visible Gaussians to those of earlier views.
    fn record_flags(&self, r: &mut Recorder, inputs: &FrameInputs) {
        let f = inputs.frame;
        let [extent, antialias] = inputs.settings.modes();
        let of_frame = BlendVariant { shared_order: inputs.view > Some(0), ..inputs.blend_variant() };
        for (place, first) in inputs.batches() {
            let variant = of_frame.of_scene(first.settings);
            r.barrier();
            self.record_batch_flags(r, (inputs, place), first, variant);
        }
        for part in inputs.parts() {
            let variant = of_frame.of_scene(part.settings);
            let Some(kernel) = self.cull.get(r, &self.cull_spec(variant)) else { return };
            let GaussianRange { chunk, first, count } = part.range;
            let chunk_gaussians = part.scene.plan.chunk_gaussians;
            let push = cull::Push {
                first,
                count,
                chunk_gaussians,
                extent,
                antialias,
                first_cut_out: part.first_cut_out,
                cut_out_count: part.settings.cut_out_count(),
                flag_count: part.flags,
            };
            let bind = cull::Bind {
                parameters: &part.scene.chunks[chunk],
                visible_flags: &f.visible_flags,
                block_counts: f.visible_counts(),
                // Without cut-outs the kernel does not read this binding. With cut-outs, `record` has checked the buffer.
                cut_outs: inputs.cut_outs.unwrap_or(&part.scene.chunks[chunk]),
                camera_block: &block_of(f, part.block),
            };
            r.barrier();
            let workgroups = blocks(part.flags.into(), self.sizes.elementwise_workgroup.into());
            r.dispatch(kernel, &bind, &push, workgroups);
        }
        r.barrier();
    }

    /// Records the compaction of the visible Gaussians, which keep their order.
    fn record_compaction(&self, r: &mut Recorder, inputs: &FrameInputs) {
        let f = inputs.frame;
        let (count, subgroup_size) = (inputs.index_count(), self.context.limits().subgroup_size);
        let culled_blocks = count.div_ceil(self.sizes.elementwise_workgroup);
        self.scan.record_block_sums(
            r,
            f.visible_counts(),
            (0, culled_blocks),
            &f.state,
            c::STATE_VISIBLE_NEEDED,
        );
        r.barrier();
        r.dispatch(
            &self.compact,
            &compact::Bind {
                visible_flags: &f.visible_flags,
                block_offsets: f.visible_offsets(),
                visible_list: &f.visible_list,
                visible_index: &f.visible_index,
            },
            &compact::Push { count, capacity: inputs.capacity.visible },
            // One block per subgroup.
            blocks(culled_blocks.into(), (self.sizes.elementwise_workgroup / subgroup_size).into()),
        );
        let counted =
            [c::STATE_VISIBLE_NEEDED, inputs.capacity.visible, c::ARGUMENTS_VISIBLE, self.sizes.scan];
        self.record_prepare(r, f, counted);
        r.barrier();
        let scenes = inputs.scenes.len() as u32;
        r.dispatch(
            &self.write_visible_ranges,
            &write_visible_ranges::Bind {
                state: &f.state,
                block_offsets: f.visible_offsets(),
                visible_ranges: &f.visible_ranges,
                scene_blocks: &camera_block::blocks_of(inputs),
            },
            &write_visible_ranges::Push {
                scenes,
                blocks: culled_blocks,
                block_elementwise: self.sizes.elementwise_workgroup,
                max_workgroups_per_axis: self.context.limits().max_workgroups_per_axis,
            },
            blocks(scenes.into(), self.sizes.elementwise_workgroup.into()),
        );
        r.barrier();
    }

    /// `counted`: index of the count, its capacity, index of the first argument, block size of the third argument.
    fn record_prepare(&self, r: &mut Recorder, f: &FrameBuffers, counted: [u32; 4]) {
        let [count_index, capacity, first_argument, block_third] = counted;
        r.dispatch(
            &self.write_indirect_args,
            &write_indirect_args::Bind { state: &f.state, arguments: &f.arguments },
            &write_indirect_args::Push {
                count_index,
                capacity,
                first_argument,
                block_elementwise: self.sizes.elementwise_workgroup,
                block_sort: self.sizes.sort,
                block_third,
                max_workgroups_per_axis: self.context.limits().max_workgroups_per_axis,
            },
            1,
        );
    }

    /// Records the screen-space attributes of the visible Gaussians, and their motions if a host wants them.
    fn record_project(&self, r: &mut Recorder, inputs: &FrameInputs) {
        let f = inputs.frame;
        let (splats, [extent, antialias]) = (f.splats(), inputs.settings.modes());
        let mut is_first = true;
        for (place, first) in inputs.batches() {
            if !std::mem::take(&mut is_first) {
                r.barrier();
            }
            let variant = inputs.blend_variant().of_scene(first.settings);
            self.record_batch_project(r, (inputs, place), first, variant);
        }
        for part in inputs.parts() {
            let variant = inputs.blend_variant().of_scene(part.settings);
            let spec = variant.project_spec(&self.sizes, part.sh_degree);
            let Some(kernel) = self.project.get(r, &spec) else { return };
            let range = part.range;
            let push = project::Push {
                first: range.first,
                chunk_gaussians: part.scene.plan.chunk_gaussians,
                extent,
                antialias,
                splat_stride: splats.stride,
                first_of_scene: part.first_of_scene,
            };
            let bind = project::Bind {
                parameters: &part.scene.chunks[range.chunk],
                visible_ranges: &f.visible_ranges,
                visible_list: &f.visible_list,
                mean2d_extent: splats.mean2d_extent,
                conic_opacity: splats.conic_opacity,
                color_inverse_depth: splats.color_inverse_depth,
                depth_keys: f.depth_keys(),
                footprints: splats.footprints,
                tile_lists: f.tile_lists(),
                // Without a selection the kernel does not read this binding.
                selection: part.settings.mask().unwrap_or(&f.visible_list),
                camera_block: &block_of(f, part.block),
            };
            if !std::mem::take(&mut is_first) {
                r.barrier();
            }
            r.dispatch_indirect(kernel, &bind, &push, &range_arguments(f, &self.sizes, range));
            self.record_screen_motion(r, inputs, &part);
        }
        r.barrier();
    }

    /// Records the sort of the visible Gaussians from near to far. Equal depths keep the order of the Gaussians.
    fn record_depth_sort(&self, r: &mut Recorder, f: &FrameBuffers) {
        let buffers = SortBuffers {
            counts: &f.state,
            count_index: c::STATE_VISIBLE,
            keys: f.depth_sort_keys(),
            values: f.depth_sort_values(),
            histogram: &f.histogram,
            digit_totals: &f.digit_totals,
        };
        let at = arguments(f, c::ARGUMENTS_VISIBLE_SORT);
        self.sort.record(r, &buffers, Values::Positions, u32::BITS, Workgroups::Indirect(&at));
        r.barrier();
    }

    /// Records the tile counts of the visible Gaussians in depth order, their prefix sums, and the number of instances. The
    /// lists of tiles overwrite the sorted depths, which are no longer needed.
    fn record_count(&self, r: &mut Recorder, inputs: &FrameInputs) {
        let f = inputs.frame;
        let bind = count::Bind {
            state: &f.state,
            order: f.depth_order(),
            tile_lists: f.tile_lists(),
            tiles_touched: &f.tiles_touched,
            list_heads: f.list_heads(),
            list_rows: f.list_rows(),
            block_sums: &f.scan_blocks,
        };
        let at = arguments(f, c::ARGUMENTS_VISIBLE_SCAN);
        r.dispatch_indirect(&self.count, &bind, &count::Push {}, &at);
        r.barrier();
        let buffers = ScanBuffers {
            counts: &f.state,
            count_index: c::STATE_VISIBLE,
            total_index: c::STATE_INSTANCES_NEEDED,
            values: &f.tiles_touched,
            prefix: &f.instance_offsets,
            block_sums: &f.scan_blocks,
        };
        self.scan.record_from_block_sums(r, &buffers, Workgroups::Indirect(&at));
        r.barrier();
        let (capacity, block) =
            (inputs.capacity.instances, self.sizes.elementwise_workgroup * self.sizes.duplicate_items);
        self.record_prepare(r, f, [c::STATE_INSTANCES_NEEDED, capacity, c::ARGUMENTS_INSTANCES, block]);
        r.barrier();
    }
}
