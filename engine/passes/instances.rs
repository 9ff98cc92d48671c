//! Instances, one per (tile, visible Gaussian) pair: the order by depth, their number, creation, sort by tile, and each tile's
//! range.
//!
//! The visible Gaussians are sorted by depth before they are duplicated to instances. Only the instances' tile bits then remain
//! to be sorted, stably, and the order is that of the paper's 64-bit (tile | depth) key.

use super::scan::{DeviceCount, Scan, Workgroups};
use super::sort::{RadixSort, SortBuffers, Values};
use crate::error::Result;
use crate::frame::{FrameBuffers, FrameInputs, LaunchSizes, bits_of_tiles, tile_grid};
use crate::kernels::backward::hide_tiles;
use crate::kernels::constants as c;
use crate::kernels::forward::{count, duplicate_with_tiles, ranges};
use crate::scene::Projection;
use crate::vk::{Buffer, Context, Kernel, KernelSet, Recorder};

pub(crate) struct Instances {
    sizes: LaunchSizes,
    sort: RadixSort,
    count: Kernel<count::Interface>,
    duplicate: KernelSet<duplicate_with_tiles::Interface>,
    /// Constants of `duplicate` that all frames have.
    duplicate_spec: duplicate_with_tiles::Spec,
    /// For frames that carry visible Gaussians through the tile sort, and that keep instances.
    ranges: [Kernel<ranges::Interface>; 2],
    hide: KernelSet<hide_tiles::Interface>,
}

impl Instances {
    pub fn new(context: &Context) -> Result<Self> {
        let limits = context.limits();
        let sizes = LaunchSizes::new(limits);
        let (workgroup_size, subgroup_size) = (sizes.elementwise_workgroup, limits.subgroup_size);
        let ranges = |for_backward| Kernel::new(context, &ranges::Spec { workgroup_size, for_backward });
        let count =
            count::Spec { workgroup_size: sizes.scan_workgroup, subgroup_size, items: sizes.scan_items };
        let mut instances = Self {
            sizes,
            sort: RadixSort::new(context)?,
            count: Kernel::new(context, &count)?,
            duplicate: KernelSet::default(),
            duplicate_spec: duplicate_with_tiles::Spec {
                workgroup_size,
                subgroup_size,
                items: sizes.tuning.duplicate_items,
                scan_block: sizes.scan_block,
                ..duplicate_with_tiles::Spec::default()
            },
            ranges: [ranges(false)?, ranges(true)?],
            hide: KernelSet::default(),
        };
        instances.prepare(context, Projection::Perspective)?;
        Ok(instances)
    }

    /// Builds the missing kernels for frames of a projection.
    pub fn prepare(&mut self, context: &Context, projection: Projection) -> Result<()> {
        let specs = [false, true].map(|for_backward| self.duplicate_spec(for_backward, projection));
        specs.into_iter().try_for_each(|spec| self.duplicate.prepare(context, spec))
    }

    /// Builds the kernel for masked photographs.
    pub fn prepare_hiding(&mut self, context: &Context) -> Result<()> {
        self.hide.prepare(context, self.hide_spec())
    }

    fn hide_spec(&self) -> hide_tiles::Spec {
        let (subgroup_size, strips) = (self.duplicate_spec.subgroup_size, self.sizes.strips);
        hide_tiles::Spec { workgroup_size: subgroup_size, subgroup_size, strips }
    }

    fn duplicate_spec(&self, for_backward: bool, projection: Projection) -> duplicate_with_tiles::Spec {
        duplicate_with_tiles::Spec { for_backward, lenses: projection.has_seam(), ..self.duplicate_spec }
    }

    /// Records the sort of the visible Gaussians from near to far. Equal depths keep the order of the Gaussians.
    pub fn record_depth_sort(&self, r: &mut Recorder, f: &FrameBuffers) {
        let buffers = SortBuffers {
            counts: &f.state,
            count_index: c::STATE_VISIBLE,
            keys: f.depth_sort_keys(&self.sizes),
            values: f.depth_sort_values(&self.sizes),
            histogram: &f.histogram,
            digit_totals: &f.digit_totals,
            arrivals: &f.sort_arrivals(),
        };
        let at = f.arguments_at(c::ARGUMENTS_VISIBLE_SORT);
        self.sort.record(r, &buffers, Values::Positions, c::DEPTH_KEY_BITS, Workgroups::Indirect(&at));
    }

    /// Records the lists of tiles of the visible Gaussians in depth order, the place of their instances, and the number of instances.
    pub fn record_count(&self, r: &mut Recorder, inputs: &FrameInputs, scan: &Scan) {
        let f = inputs.buffers;
        let bind = count::Bind {
            state: &f.state,
            order: &f.depth_order,
            tile_lists: &f.tile_lists,
            list_heads: &f.list_heads,
            list_rows: &f.list_rows,
            block_instances: &f.block_instances,
            block_sums: &f.instance_blocks,
        };
        let at = f.arguments_at(c::ARGUMENTS_VISIBLE_SCAN);
        r.dispatch_indirect(&self.count, &bind, &count::Push {}, &at);
        r.barrier();
        let counted = DeviceCount {
            frame: f,
            count: c::STATE_INSTANCES_NEEDED,
            capacity: inputs.capacity.instances,
            first_argument: c::ARGUMENTS_INSTANCES,
            caller_block: self.sizes.elementwise_workgroup * self.sizes.tuning.duplicate_items,
            keeps_overflow: true,
        };
        scan.record_counted_sums(r, &f.instance_blocks, None, counted);
    }

    /// Records duplicate_with_tiles: one (tile, Gaussian) instance per touched tile.
    pub fn record_duplicate(&self, r: &mut Recorder, inputs: &FrameInputs) {
        let f = inputs.buffers;
        let (keeps_instances, splats) = (inputs.keeps_instances(), f.splats());
        let values = f.tile_sort_values(&self.sizes, inputs.camera);
        let bind = duplicate_with_tiles::Bind {
            state: &f.state,
            order: &f.depth_order,
            block_instances: &f.block_instances,
            block_offsets: &f.instance_blocks,
            mean2d_extent: splats.mean2d_extent,
            footprints: splats.footprints,
            list_heads: &f.list_heads,
            list_rows: &f.list_rows,
            instance_tiles: f.tile_sort_keys(&self.sizes, inputs.camera)[0],
            instance_visible: if keeps_instances { &f.instance_visible } else { values[0] },
            first_instances: &f.first_instances,
        };
        let (tiles_per_row, tile_rows) = tile_grid(inputs.camera.width, inputs.camera.height);
        let (extent, splat_stride) = (inputs.settings.extent_word(), splats.stride);
        let (image_width, whole_width) = (inputs.camera.width, inputs.camera.whole().width);
        let push = duplicate_with_tiles::Push {
            extent,
            tiles_per_row,
            tile_rows,
            splat_stride,
            image_width,
            whole_width,
        };
        let spec = self.duplicate_spec(keeps_instances, inputs.camera.projection);
        let Some(kernel) = r.kernel(&self.duplicate, &spec) else { return };
        r.dispatch_indirect(kernel, &bind, &push, &f.arguments_at(c::ARGUMENTS_INSTANCES_EXPAND));
    }

    /// Records the sort of the instances by tile. It is stable, so each tile keeps the depth order. The values are the instance
    /// indices before the tile sort, or without backward the visible Gaussians.
    pub fn record_tile_sort(&self, r: &mut Recorder, inputs: &FrameInputs) {
        let f = inputs.buffers;
        let buffers = SortBuffers {
            counts: &f.state,
            count_index: c::STATE_INSTANCES,
            keys: f.tile_sort_keys(&self.sizes, inputs.camera),
            values: f.tile_sort_values(&self.sizes, inputs.camera),
            histogram: &f.histogram,
            digit_totals: &f.digit_totals,
            arrivals: &f.sort_arrivals(),
        };
        let at = f.arguments_at(c::ARGUMENTS_INSTANCES_SORT);
        let bits = bits_of_tiles(inputs.camera);
        let values = if inputs.keeps_instances() { Values::Positions } else { Values::Given };
        self.sort.record(r, &buffers, values, bits, Workgroups::Indirect(&at));
    }

    /// Records the begin and end of each tile's instances.
    pub fn record_ranges(&self, r: &mut Recorder, inputs: &FrameInputs) {
        let f = inputs.buffers;
        let keeps_instances = inputs.keeps_instances();
        let bind = ranges::Bind {
            state: &f.state,
            sorted_tiles: &f.sorted_tiles,
            sorted_instances: &f.sorted_instances,
            // The kernel does not read this binding without backward.
            instance_visible: if keeps_instances { &f.instance_visible } else { &f.sorted_instances },
            tile_ranges: &f.tile_ranges,
            sorted_visible: &f.gathered_visible,
        };
        let kernel = &self.ranges[usize::from(keeps_instances)];
        r.dispatch_indirect(kernel, &bind, &ranges::Push {}, &f.arguments_at(c::ARGUMENTS_INSTANCES));
    }

    /// Records that the tiles in which a photograph's mask hides every pixel have no instances. The picture there is the
    /// background.
    pub fn record_hiding(&self, r: &mut Recorder, inputs: &FrameInputs, photo: &Buffer) {
        let bind = hide_tiles::Bind { photo, tile_ranges: &inputs.buffers.tile_ranges };
        let (image_width, image_height) = (inputs.camera.width, inputs.camera.height);
        let (tiles_per_row, tile_rows) = tile_grid(image_width, image_height);
        let tile_count = tiles_per_row * tile_rows;
        let push = hide_tiles::Push { image_width, image_height, tiles_per_row, tile_count };
        let Some(kernel) = r.kernel(&self.hide, &self.hide_spec()) else { return };
        r.dispatch(kernel, &bind, &push, tile_count.into());
    }
}
