//! Every size, capacity and block count of a frame, as pure arithmetic on the device's limits.
//!
//! A buffer has one element per Gaussian, per visible Gaussian, per instance (one (tile, Gaussian) pair), per
//! tile or per pixel. Only the device knows how many Gaussians are visible and how many instances a frame
//! has, so the sizes here are capacities. Buffers of visible Gaussians have the capacity of all Gaussians.

mod grids;
mod launch_sizes;
mod sorting;
mod strips;

pub use crate::tuning::SortMethod;
pub use grids::check_grids;
pub use launch_sizes::LaunchSizes;
pub use strips::{STRIP_ROWS, Strips};

use launch_sizes::ELEMENTWISE_WORKGROUP;

use crate::error::{Error, Result};
use crate::kernels::blocks::CameraBlock;
use crate::kernels::constants::{
    ARGUMENTS_COUNT, GRADIENT_PLANES, PLANE_ROW, PLANE_SH, SH_PLANES_0, SH_PLANES_1, SH_PLANES_2,
    SH_PLANES_3, SPLAT_PLANES, STATE_WORDS, TILE_SIZE,
};
use crate::vk::{Buffer, Limits, PLACEMENT_ALIGNMENT, pack};
use std::ops::Range;

/// `ceil(n / d)`.
pub const fn blocks(n: u64, d: u64) -> u64 {
    n.div_ceil(d)
}

/// Planes of parameters of a Gaussian with SH up to `sh_degree`: three of geometry, the rest SH.
pub const fn parameter_planes(sh_degree: u32) -> u32 {
    PLANE_SH
        + match sh_degree {
            0 => SH_PLANES_0,
            1 => SH_PLANES_1,
            2 => SH_PLANES_2,
            _ => SH_PLANES_3,
        }
}

/// The group of planes that lie together with `plane`: the geometry, or one SH degree.
pub(crate) fn plane_group(plane: u32) -> Range<u32> {
    const ENDS: [u32; 5] = [
        PLANE_SH,
        PLANE_SH + SH_PLANES_0,
        PLANE_SH + SH_PLANES_1,
        PLANE_SH + SH_PLANES_2,
        PLANE_SH + SH_PLANES_3,
    ];
    match ENDS.iter().position(|&end| plane < end) {
        Some(0) => 0..PLANE_SH,
        Some(group) => ENDS[group - 1]..ENDS[group],
        None => unreachable!("no Gaussian has a plane {plane}"),
    }
}

/// A range of Gaussians whose parameter planes lie in one buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GaussianRange {
    /// Index of the buffer.
    pub chunk: usize,
    /// Index of the range's first Gaussian in the scene.
    pub first: u32,
    /// Number of Gaussians in the range.
    pub count: u32,
}

/// How the parameters of up to `capacity` Gaussians are split into buffers that fit a binding.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ScenePlan {
    /// Capacity in Gaussians.
    pub capacity: u32,
    /// Stored SH degree.
    pub sh_degree: u32,
    /// vec4 planes per Gaussian.
    pub planes: u32,
    /// Gaussians per chunk. A multiple of every block size.
    pub chunk_gaussians: u32,
    /// Number of chunks.
    pub chunks: u32,
}

impl ScenePlan {
    /// Plans for `capacity` Gaussians with SH up to `sh_degree`.
    ///
    /// # Errors
    /// [`Error::TooLarge`] when the count exceeds what 30 bits can index.
    pub fn new(limits: &Limits, capacity: u32, sh_degree: u32) -> Result<Self> {
        const MAX_GAUSSIANS: u32 = 1 << 30;
        if capacity > MAX_GAUSSIANS {
            return Err(Error::TooLarge {
                what: "the scene".into(),
                needed: capacity.into(),
                unit: "Gaussians",
                limit: MAX_GAUSSIANS.into(),
                limit_name: "30-bit indices",
            });
        }
        let planes = parameter_planes(sh_degree);
        let align = u64::from(ELEMENTWISE_WORKGROUP);
        let bytes_per_gaussian = u64::from(planes) * 16;
        let largest =
            limits.max_storage_buffer_range.min(limits.max_allocation_bytes) / bytes_per_gaussian / align;
        let wanted = blocks(u64::from(capacity).max(1), align);
        let chunk_gaussians = wanted.min(largest.max(1)) * align;
        let chunks = to_u32(blocks(u64::from(capacity).max(1), chunk_gaussians))?;
        Ok(Self { capacity, sh_degree, planes, chunk_gaussians: to_u32(chunk_gaussians)?, chunks })
    }

    /// Bytes of one chunk.
    pub fn chunk_bytes(&self) -> u64 {
        u64::from(self.chunk_gaussians) * u64::from(self.planes) * 16
    }

    /// Index, in vec4, of plane `plane` of Gaussian `index` in a chunk. The groups of planes are 0 to 2
    /// (geometry), 3, 4 and 5, 6 to 9, and 10 to 14 (one SH degree each). A group is contiguous for all
    /// Gaussians, in rows of eight Gaussians: planes `first` to `end - 1` lie at `first * chunk_gaussians +
    /// (index / 8 * (end - first) + plane - first) * 8 + index % 8`.
    ///
    /// # Panics
    /// If `plane` is not below `planes`, or `index`, which counts from the chunk's first Gaussian, is not
    /// below `chunk_gaussians`.
    pub fn place(&self, plane: u32, index: usize) -> usize {
        assert!(plane < self.planes && index < self.chunk_gaussians as usize, "{plane}, {index}: {self:?}");
        let (row, Range { start, end }) = (PLANE_ROW as usize, plane_group(plane));
        let (first, planes) = (start as usize, (end - start) as usize);
        first * self.chunk_gaussians as usize
            + (index / row * planes + plane as usize - first) * row
            + index % row
    }

    /// The chunks that `count` Gaussians occupy.
    pub fn ranges(&self, count: u32) -> impl Iterator<Item = GaussianRange> + use<> {
        let own = self.chunk_gaussians;
        (0..count.div_ceil(own)).map(move |chunk| GaussianRange {
            chunk: chunk as usize,
            first: chunk * own,
            count: (count - chunk * own).min(own),
        })
    }
}

/// Capacities of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameCapacity {
    /// Gaussians. All of them may be visible.
    pub gaussians: u32,
    /// (tile, Gaussian) instances.
    pub instances: u32,
    /// Scenes.
    pub scenes: u32,
    /// Width of the largest image, pixels.
    pub width: u32,
    /// Height of the largest image, pixels.
    pub height: u32,
    /// Passes of blending. Each handles [`LaunchSizes::entries_per_pass`] entries of a tile.
    pub blend_passes: u32,
    /// Whether the frame has the buffers of the backward pass.
    pub backward: bool,
}

/// Number of tiles of an image: (per row, rows).
pub const fn tile_grid(width: u32, height: u32) -> (u32, u32) {
    (width.div_ceil(TILE_SIZE), height.div_ceil(TILE_SIZE))
}

/// Bits of a tile index, at least one.
pub const fn tile_bits(tiles: u32) -> u32 {
    if tiles <= 2 { 1 } else { 32 - (tiles - 1).leading_zeros() }
}

/// Bytes from one scene's camera block to the next, with room for more members: a multiple of what devices
/// require of the offset of a uniform block, and far below what they allow as its size.
pub const CAMERA_BLOCK_BYTES: u64 = 512;
const _: () = assert!(
    size_of::<CameraBlock>() as u64 <= CAMERA_BLOCK_BYTES
        && CAMERA_BLOCK_BYTES.is_multiple_of(PLACEMENT_ALIGNMENT)
);

/// Bytes per element of the widest buffer per instance.
const INSTANCE_BYTES: u64 = 16;

/// First estimate of a frame's instances, at most what a binding and a grid can hold. A frame that needs more
/// overflows and is run again.
pub fn initial_instances(limits: &Limits, gaussians: u32, width: u32, height: u32) -> u32 {
    let (columns, rows) = tile_grid(width, height);
    let guess = u64::from(gaussians) * 6 + u64::from(columns) * u64::from(rows) * 16;
    guess.max(1 << 12).min(max_trained_instances(limits).into()) as u32
}

/// Most instances that a training step's frame can have on a device, by the limits of a binding and a grid.
pub fn max_trained_instances(limits: &Limits) -> u32 {
    let axis = u64::from(limits.max_workgroups_per_axis);
    let bytes = limits.max_storage_buffer_range.min(limits.max_allocation_bytes);
    let most = (bytes / INSTANCE_BYTES).min(axis * axis * u64::from(LaunchSizes::new(limits).smallest()));
    most.clamp(1, u32::MAX.into()) as u32
}

macro_rules! frame_requests {
    ($($(#[$doc:meta])* $name:ident: $bytes:expr;)*) => {
        /// Buffers of a frame, one field each.
        #[derive(Clone)]
        pub struct FrameBuffers { $($(#[$doc])* pub $name: Buffer,)* }

        /// Names and bytes of [`FrameBuffers`], in order.
        pub fn frame_requests(capacity: &FrameCapacity, block: &LaunchSizes) -> Vec<(&'static str, u64)> {
            let sizes = FrameSizes::new(capacity, block);
            vec![$((stringify!($name), { let f: fn(&FrameSizes) -> u64 = $bytes; f(&sizes) }),)*]
        }

        impl FrameBuffers {
            /// Assigns the buffers that were allocated for [`frame_requests`], in the same order.
            pub fn from_allocated(buffers: Vec<Buffer>) -> Self {
                let mut buffers = buffers.into_iter();
                let mut next = || match buffers.next() {
                    Some(buffer) => buffer,
                    None => unreachable!("one buffer per request"),
                };
                Self { $($name: next(),)* }
            }
        }
    };
}

struct FrameSizes {
    scenes: u64,
    gaussians: u64,
    gaussian_blocks: u64,
    scan_blocks: u64,
    instances: u64,
    histogram: u64,
    digits: u64,
    tiles: u64,
    /// vec4 from the attributes of one visible Gaussian to those of the next.
    splat_stride: u64,
    /// 1 if each attribute has a buffer of its own, otherwise 0.
    apart: u64,
    /// Capacity in instances of the buffers for the backward pass; 0 without it.
    slots: u64,
    pixels: u64,
    /// Values of one plane in strips, for any image with this number of tiles; 0 without strips.
    strips: u64,
    /// 1 with backward, 0 without.
    backward: u64,
    /// 1 when very long tiles need several passes backward.
    passes: u64,
}

impl FrameSizes {
    fn new(capacity: &FrameCapacity, block: &LaunchSizes) -> Self {
        let gaussians = u64::from(capacity.gaussians);
        let instances = u64::from(capacity.instances);
        let (columns, rows) = tile_grid(capacity.width, capacity.height);
        let backward = u64::from(capacity.backward);
        let tile_bits = tile_bits(columns.saturating_mul(rows));
        let depth_sort = block.sort_histogram_words(gaussians, u32::BITS);
        // A smaller image may use longer digits in fewer passes.
        let tile_sort = (1..=tile_bits).map(|bits| block.sort_histogram_words(instances, bits)).max();
        let record = 16 * u64::from(SPLAT_PLANES);
        let together = gaussians * record <= block.max_binding_bytes;
        Self {
            scenes: capacity.scenes.into(),
            gaussians,
            gaussian_blocks: blocks(gaussians, block.elementwise_workgroup.into()),
            scan_blocks: blocks(gaussians, block.scan.into()),
            instances,
            histogram: tile_sort.map_or(depth_sort, |words| words.max(depth_sort)),
            digits: 1 << block.sort_digit_bits(),
            tiles: u64::from(columns) * u64::from(rows),
            splat_stride: if together { SPLAT_PLANES.into() } else { 1 },
            apart: u64::from(!together),
            slots: backward * instances,
            pixels: u64::from(capacity.width) * u64::from(capacity.height),
            strips: backward
                * u64::from(block.strips)
                * Strips { width: columns.saturating_mul(TILE_SIZE), height: rows.saturating_mul(TILE_SIZE) }
                    .values(),
            backward,
            passes: backward * u64::from(capacity.blend_passes > 1),
        }
    }
}

frame_requests! {
    /// Words named STATE_* in constants.glsl.
    state: |_| u64::from(STATE_WORDS) * 4;
    /// Indirect arguments, named ARGUMENTS_*.
    arguments: |_| u64::from(ARGUMENTS_COUNT) * 16;
    /// Per scene: its camera and how it is drawn, see camera_block.glsl.
    camera_blocks: |s| s.scenes * CAMERA_BLOCK_BYTES;
    /// Per range of parameters: indirect arguments, and its range of visible Gaussians. There are fewer
    /// ranges than blocks.
    visible_ranges: |s| s.gaussian_blocks.max(1) * 32;
    /// Per Gaussian: 1 if visible.
    visible_flags: |s| s.gaussians * 4;
    /// Visible Gaussians per block, then the offsets of the blocks.
    visible_blocks: |s| s.gaussian_blocks * 4;
    /// Per visible Gaussian: its Gaussian.
    visible_list: |s| s.gaussians * 4;
    /// Per Gaussian: its index among the visible ones.
    visible_index: |s| s.gaussians * 4;
    /// Per visible Gaussian: mean and half extents, px; or records of all four attributes, see
    /// [`FrameBuffers::splats`].
    splats: |s| s.gaussians * 16 * s.splat_stride;
    /// Per visible Gaussian: conic and opacity.
    conic_opacity: |s| s.apart * s.gaussians * 16;
    /// Per visible Gaussian: colour and 1/z.
    color_inverse_depth: |s| s.apart * s.gaussians * 16;
    /// Per visible Gaussian: shape of its rows of tiles, number of tiles (tile_span.glsl).
    footprints: |s| s.apart * s.gaussians * 16;
    /// Per visible Gaussian: the list of its tiles if they are few, otherwise their number (tile_list.glsl).
    tile_lists: |s| s.gaussians * 8;
    /// Per visible Gaussian: bits of its depth; sorting scratch; then per rank: first word of its list of
    /// tiles.
    depth_keys_a: |s| s.gaussians * 4;
    /// Sorting scratch; then per rank: second word of its list of tiles.
    depth_keys_b: |s| s.gaussians * 4;
    /// Per depth rank: the visible Gaussian (after an even number of sorting passes).
    order_a: |s| s.gaussians * 4;
    /// Sorting scratch.
    order_b: |s| s.gaussians * 4;
    /// Per rank: number of tiles touched.
    tiles_touched: |s| s.gaussians * 4;
    /// Per rank: first instance.
    instance_offsets: |s| s.gaussians * 4;
    /// Sums and offsets of the scan's blocks.
    scan_blocks: |s| s.scan_blocks * 4;
    /// Sorting scratch: counts per digit and block, and per digit and run.
    histogram: |s| s.histogram * 4;
    /// Sorting scratch: keys per digit.
    digit_totals: |s| s.digits * 4;
    /// Per instance: its tile; sorting scratch.
    tiles_a: |s| s.instances * 4;
    /// Sorting scratch.
    tiles_b: |s| s.instances * 4;
    /// Per sorted instance: its index before the tile sort, or without backward the visible Gaussian; sorting
    /// scratch.
    sorted_a: |s| s.instances * 4;
    /// Sorting scratch.
    sorted_b: |s| s.instances * 4;
    /// Per instance before the tile sort: the visible Gaussian.
    instance_visible: |s| s.slots * 4;
    /// Per sorted instance: the visible Gaussian.
    sorted_visible: |s| s.slots * 4;
    /// Per visible Gaussian: its first instance.
    first_instances: |s| s.backward * s.gaussians * 4;
    /// Per tile: begin and end in the sorted instances.
    tile_ranges: |s| s.tiles * 8;
    /// Per pixel: premultiplied colour without background, transmittance. In a frame with backward in strips
    /// it only carries the state between passes.
    accumulated: |s| s.pixels * 16;
    /// The composited picture as three planes in strips, if the backward pass reads strips.
    composited: |s| 3 * s.strips * 4;
    /// Per pixel: sum of weights / z.
    inverse_depth: |s| s.pixels * 4;
    /// Per pixel: 1 + list index of the last blended entry of its tile.
    last_entries: |s| s.pixels * 4;
    /// Gradient of the loss. Per pixel: dL/d(r, g, b, inverse depth); with strips, three planes of dL/d(r, g,
    /// b).
    image_gradient: |s| if s.strips > 0 { 3 * s.strips * 4 } else { s.backward * s.pixels * 16 };
    /// Per pixel: state between passes of the backward blending.
    backward_state: |s| s.passes * s.pixels * 8;
    /// Per instance before the tile sort: moments 1, dx, dy, dx dx.
    instance_gradients_a: |s| s.slots * 16;
    /// Per instance before the tile sort: moments dx dy, dy dy; d red, d green.
    instance_gradients_b: |s| s.slots * 16;
    /// Per instance before the tile sort: d blue, d inverse depth.
    instance_gradients_c: |s| s.slots * 8;
    /// Per visible Gaussian: planes named GRADIENT_*.
    gradients: |s| s.backward * s.gaussians * 16 * u64::from(GRADIENT_PLANES);
}

/// Most Gaussians that can be trained on a device: their gradients lie in one buffer.
pub fn max_trained_gaussians(limits: &Limits) -> u32 {
    let bytes = limits.max_storage_buffer_range.min(limits.max_allocation_bytes);
    (bytes / (16 * u64::from(GRADIENT_PLANES))).min(u32::MAX.into()) as u32
}

/// Bytes of all buffers of a frame, including the padding between them.
pub fn frame_bytes(capacity: &FrameCapacity, block: &LaunchSizes) -> u64 {
    let sizes: Vec<u64> = frame_requests(capacity, block).iter().map(|(_, bytes)| *bytes).collect();
    pack(&sizes, u64::MAX).map_or(u64::MAX, |packing| packing.blocks.iter().sum())
}

/// Bindings of the attributes of the visible Gaussians: see splat_record.glsl.
#[derive(Clone, Copy)]
pub struct Splats<'a> {
    /// Mean and half extents, px.
    pub mean2d_extent: &'a Buffer,
    /// Conic and opacity.
    pub conic_opacity: &'a Buffer,
    /// Colour and 1/z.
    pub color_inverse_depth: &'a Buffer,
    /// Shape of the rows of tiles, number of tiles.
    pub footprints: &'a Buffer,
    /// vec4 from one visible Gaussian to the next. With [`SPLAT_PLANES`] all four are the same buffer.
    pub stride: u32,
}

impl FrameBuffers {
    /// The blended picture that the loss and the backward pass read: [`Self::composited`] with strips,
    /// otherwise [`Self::accumulated`].
    pub fn rendered(&self, block: &LaunchSizes) -> &Buffer {
        if block.strips { &self.composited } else { &self.accumulated }
    }

    /// The attributes of the visible Gaussians.
    pub fn splats(&self) -> Splats<'_> {
        let records = &self.splats;
        if records.bytes() > self.conic_opacity.bytes() {
            return Splats {
                mean2d_extent: records,
                conic_opacity: records,
                color_inverse_depth: records,
                footprints: records,
                stride: SPLAT_PLANES,
            };
        }
        Splats {
            mean2d_extent: records,
            conic_opacity: &self.conic_opacity,
            color_inverse_depth: &self.color_inverse_depth,
            footprints: &self.footprints,
            stride: 1,
        }
    }
}

/// `n` as u32.
///
/// # Errors
/// [`Error::TooLarge`] when it does not fit.
pub fn to_u32(n: u64) -> Result<u32> {
    u32::try_from(n).map_err(|_| Error::TooLarge {
        what: "a count".into(),
        needed: n,
        unit: "elements",
        limit: u32::MAX.into(),
        limit_name: "32-bit counts",
    })
}
