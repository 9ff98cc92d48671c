//! Instances of the visible Gaussians: creation, sort by tile, and ranges of the tiles.

use super::{Forward, FrameInputs, arguments};
use crate::kernels::constants as c;
use crate::kernels::forward::{duplicate_with_tiles, ranges};
use crate::plan::{sorted_side, tile_bits, tile_grid};
use crate::scan::Workgroups;
use crate::sort::{SortBuffers, Values};
use crate::vk::Recorder;

impl Forward {
    /// Records duplicate_with_tiles: one (tile, Gaussian) instance per touched tile.
    pub(super) fn record_duplicate(&self, r: &mut Recorder, inputs: &FrameInputs) {
        let f = inputs.frame;
        let (for_backward, splats) = (inputs.capacity.backward, f.splats());
        let bind = duplicate_with_tiles::Bind {
            state: &f.state,
            order: f.depth_order(),
            instance_offsets: &f.instance_offsets,
            mean2d_extent: splats.mean2d_extent,
            footprints: splats.footprints,
            list_heads: f.list_heads(),
            list_rows: f.list_rows(),
            instance_tiles: f.instance_tiles(),
            instance_visible: f.instance_visible(for_backward),
            first_instances: &f.first_instances,
        };
        let (tiles_per_row, tile_rows) = tile_grid(inputs.camera.width, inputs.camera.height);
        let (extent, splat_stride) = (inputs.settings.extent_word(), splats.stride);
        let push = duplicate_with_tiles::Push { extent, tiles_per_row, tile_rows, splat_stride };
        let at = arguments(f, c::ARGUMENTS_INSTANCES_EXPAND);
        r.dispatch_indirect(&self.duplicate[usize::from(for_backward)], &bind, &push, &at);
        r.barrier();
    }

    /// Records the sort of the instances by tile. It is stable, so each tile keeps the depth order. The values are the instance
    /// indices before the tile sort, or without backward the visible Gaussians.
    pub(super) fn record_tile_sort(&self, r: &mut Recorder, inputs: &FrameInputs) {
        let f = inputs.frame;
        let (columns, rows) = tile_grid(inputs.camera.width, inputs.camera.height);
        let buffers = SortBuffers {
            counts: &f.state,
            count_index: c::STATE_INSTANCES,
            keys: f.tile_sort_keys(),
            values: f.tile_sort_values(),
            histogram: &f.histogram,
            digit_totals: &f.digit_totals,
        };
        let at = arguments(f, c::ARGUMENTS_INSTANCES_SORT);
        let bits = tile_bits(columns * rows);
        let values = if inputs.capacity.backward { Values::Positions } else { Values::Given };
        let side = self.sort.record(r, &buffers, values, bits, Workgroups::Indirect(&at));
        assert_eq!(side, sorted_side(&self.sizes, inputs.camera), "FrameBuffers::sorted_tiles is elsewhere");
        r.barrier();
    }

    /// Records the begin and end of each tile's instances.
    pub(super) fn record_ranges(&self, r: &mut Recorder, inputs: &FrameInputs) {
        let f = inputs.frame;
        let bind = ranges::Bind {
            state: &f.state,
            sorted_tiles: f.sorted_tiles(&self.sizes, inputs.camera),
            sorted_instances: f.sorted_instances(&self.sizes, inputs.camera),
            instance_visible: f.instance_visible(inputs.capacity.backward),
            tile_ranges: &f.tile_ranges,
            sorted_visible: &f.gathered_visible,
        };
        let kernel = &self.ranges[usize::from(inputs.capacity.backward)];
        r.dispatch_indirect(kernel, &bind, &ranges::Push {}, &arguments(f, c::ARGUMENTS_INSTANCES));
        r.barrier();
    }
}
