//! Every size, capacity and block count of a frame, as pure arithmetic on the device's limits.
//!
//! Buffers are counted by what they are one of: per Gaussian, per visible Gaussian (as many as Gaussians), per instance
//! (one (tile, Gaussian) pair), per tile, per pixel. How many Gaussians are visible, and how many instances a frame has,
//! is known only on the device: here are capacities.

mod sorting;

pub use sorting::SortMethod;

use crate::error::{Error, Result};
use crate::kernels::constants::{
    ARGUMENTS_COUNT, GRADIENT_PLANES, PLANE_SH, SH_PLANES_0, SH_PLANES_1, SH_PLANES_2, SH_PLANES_3,
    STATE_WORDS, TILE_SIZE,
};
use crate::vk::Limits;

/// Invocations of a streaming workgroup, where the device allows it.
const STREAM_WORKGROUP: u32 = 256;
/// Columns that one invocation of the loss goes down: what it keeps of them just fits into the fastest cache.
const LOSS_SWEEP_STRIP: u32 = 8;
/// Values of one invocation of a scan: read in fours. A processor rather has fewer invocations without barriers.
const SCAN_ITEMS: [u32; 2] = [4, 256];
/// Entries of a tile blended by one pass where the driver bounds the iterations of an invocation: a loop over entries
/// costs at most 2 iterations per entry at any subgroup size from 4.
const ENTRIES_PER_LOOP_BUDGET: u32 = 2;

/// Entries of a tile blended by one dispatch at most, on any device. It bounds the work of a dispatch, so that no
/// desktop's watchdog takes it for a hang: an invocation blends so many entries, and all dispatches but these touch each
/// Gaussian, instance or pixel a constant number of times.
const MAX_ENTRIES_PER_PASS: u32 = 1 << 18;

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

/// Sizes of workgroups and blocks on a device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Blocks {
    /// Invocations of a streaming workgroup, which is also a block of culling and densification.
    pub stream: u32,
    /// How keys are sorted.
    pub sort_method: SortMethod,
    /// Invocations of a sorting workgroup.
    pub sort_workgroup: u32,
    /// Keys of one invocation of a sort.
    pub sort_items: u32,
    /// Keys of a block of a sort.
    pub sort: u32,
    /// Whether a single workgroup sorts what [`Blocks::sorts_alone`] says.
    pub sort_alone: bool,
    /// Invocations of a scan's workgroup.
    pub scan_workgroup: u32,
    /// Values of one invocation of a scan.
    pub scan_items: u32,
    /// Values of a block of a scan.
    pub scan: u32,
    /// Invocations of a tile's workgroup: one subgroup per region of a tile.
    pub tile: u32,
    /// Invocations of a tile's workgroup that blends from shared memory: at most one per pixel.
    pub tile_shared: u32,
    /// Invocations of the loss' workgroups.
    pub loss: u32,
    /// Pixels in a row of one invocation of the loss.
    pub loss_strip: u32,
    /// Invocations of the loss' workgroups where they share nothing.
    pub loss_sweep: u32,
    /// Columns of one invocation of the loss there.
    pub loss_sweep_strip: u32,
    /// Entries of a tile that one blending pass may handle.
    pub entries_per_pass: u32,
}

impl Blocks {
    /// Block sizes for a device, or those that its [`Limits::overrides`] ask for.
    pub fn new(limits: &Limits) -> Self {
        let method = if limits.is_cpu { SortMethod::Runs } else { SortMethod::Matching };
        Self::with_sort_method(limits, method)
    }

    /// The same with a given kind of sort.
    pub fn with_sort_method(limits: &Limits, sort_method: SortMethod) -> Self {
        // Blocks nest in each other and in tiles, so that only powers of two will do.
        let size = |folder: &str, constant: &str, usual: u32| {
            let asked = limits.overridden(folder, constant).unwrap_or(usual).max(1);
            1 << asked.ilog2()
        };
        let stream =
            limits.workgroup_size(size("", "WORKGROUP_SIZE", STREAM_WORKGROUP).min(STREAM_WORKGROUP));
        let (sort_workgroup, sort_items) = sorting::shape(limits, sort_method, stream, size);
        let scan_items = size("scan", "ITEMS", SCAN_ITEMS[usize::from(limits.is_cpu)]).max(4);
        let scan_workgroup = limits.workgroup_size(size(
            "scan",
            "WORKGROUP_SIZE",
            if limits.is_cpu { limits.subgroup_size } else { stream },
        ));
        let regions = if limits.subgroup_size <= 64 { 4 } else { 2 };
        Self {
            stream,
            sort_method,
            sort_workgroup,
            sort_items,
            sort: sort_workgroup * sort_items,
            sort_alone: sort_method == SortMethod::Runs,
            scan_workgroup,
            scan_items,
            scan: scan_workgroup * scan_items,
            tile: regions * limits.subgroup_size,
            // A power of two divides the tile's pixels; subgroup sizes and limits are powers of two.
            tile_shared: stream.min(TILE_SIZE * TILE_SIZE),
            loss: limits.workgroup_size(size(
                "loss",
                "WORKGROUP_SIZE",
                if limits.is_cpu { 64 } else { STREAM_WORKGROUP },
            )),
            // Wide enough to fill a GPU's workgroup; a processor rather reads less.
            loss_strip: size("loss", "STRIP", if limits.is_cpu { 4 } else { 2 }).min(TILE_SIZE),
            // Few and long invocations: small workgroups spread them evenly.
            loss_sweep: limits.workgroup_size(size("loss", "WORKGROUP_SIZE", limits.subgroup_size)),
            loss_sweep_strip: size("loss", "STRIP", LOSS_SWEEP_STRIP),
            entries_per_pass: limits
                .max_loop_iterations
                .map_or(MAX_ENTRIES_PER_PASS, |n| n / ENTRIES_PER_LOOP_BUDGET)
                .min(MAX_ENTRIES_PER_PASS),
        }
    }
}

impl Blocks {
    /// Elements of the smallest block over which there are dispatches.
    fn smallest(&self) -> u32 {
        self.stream.min(self.sort).min(self.scan)
    }
}

/// A range of Gaussians whose parameter planes lie in one buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GaussianRange {
    /// Which buffer.
    pub chunk: usize,
    /// Index of its first Gaussian.
    pub first: u32,
    /// How many Gaussians of the scene lie in it.
    pub count: u32,
}

/// How the parameters of up to `capacity` Gaussians are cut into buffers that a binding may cover.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ScenePlan {
    /// Gaussians that fit.
    pub capacity: u32,
    /// Stored SH degree.
    pub sh_degree: u32,
    /// vec4 planes per Gaussian.
    pub planes: u32,
    /// Gaussians of one chunk: the stride of its planes. A multiple of every block size.
    pub stride: u32,
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
        let align = u64::from(STREAM_WORKGROUP);
        let bytes_per_gaussian = u64::from(planes) * 16;
        let largest =
            limits.max_storage_buffer_range.min(limits.max_allocation_bytes) / bytes_per_gaussian / align;
        let wanted = blocks(u64::from(capacity).max(1), align);
        let stride = wanted.min(largest.max(1)) * align;
        let chunks = blocks(u64::from(capacity).max(1), stride);
        Ok(Self { capacity, sh_degree, planes, stride: to_u32(stride)?, chunks: to_u32(chunks)? })
    }

    /// Bytes of one chunk.
    pub fn chunk_bytes(&self) -> u64 {
        u64::from(self.stride) * u64::from(self.planes) * 16
    }

    /// The chunks that `count` Gaussians occupy.
    pub fn ranges(&self, count: u32) -> impl Iterator<Item = GaussianRange> + use<> {
        let stride = self.stride;
        (0..count.div_ceil(stride)).map(move |chunk| GaussianRange {
            chunk: chunk as usize,
            first: chunk * stride,
            count: (count - chunk * stride).min(stride),
        })
    }
}

/// Capacities of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameCapacity {
    /// Gaussians, all of which may be visible.
    pub gaussians: u32,
    /// (tile, Gaussian) instances.
    pub instances: u32,
    /// Width of the largest image, pixels.
    pub width: u32,
    /// Height of the largest image, pixels.
    pub height: u32,
    /// Passes of blending: each handles [`Blocks::entries_per_pass`] entries of a tile.
    pub blend_passes: u32,
    /// With what backward needs.
    pub backward: bool,
}

/// Tiles of an image: (per row, rows).
pub const fn tile_grid(width: u32, height: u32) -> (u32, u32) {
    (width.div_ceil(TILE_SIZE), height.div_ceil(TILE_SIZE))
}

/// Bits that a tile index needs, at least one.
pub const fn tile_bits(tiles: u32) -> u32 {
    if tiles <= 2 { 1 } else { 32 - (tiles - 1).leading_zeros() }
}

/// Bytes of the widest buffer per instance.
const INSTANCE_BYTES: u64 = 16;

/// A first guess at the instances of a frame, never more than a binding or a grid can hold; a frame that needs more says so and
/// is run again.
pub fn initial_instances(limits: &Limits, gaussians: u32, width: u32, height: u32) -> u32 {
    let (columns, rows) = tile_grid(width, height);
    let guess = u64::from(gaussians) * 6 + u64::from(columns) * u64::from(rows) * 16;
    let axis = u64::from(limits.max_workgroups_per_axis);
    let most = (limits.max_storage_buffer_range.min(limits.max_allocation_bytes) / INSTANCE_BYTES)
        .min(axis * axis * u64::from(Blocks::new(limits).smallest()))
        .max(1);
    guess.max(1 << 12).min(most).min(u64::from(u32::MAX)) as u32
}

macro_rules! frame_requests {
    ($($(#[$doc:meta])* $name:ident: $bytes:expr;)*) => {
        /// Buffers of a frame, one field each.
        #[derive(Clone)]
        pub struct FrameBuffers { $($(#[$doc])* pub $name: crate::vk::Buffer,)* }

        /// Names and bytes of [`FrameBuffers`], in order.
        pub fn frame_requests(capacity: &FrameCapacity, block: &Blocks) -> Vec<(&'static str, u64)> {
            let sizes = FrameSizes::new(capacity, block);
            vec![$((stringify!($name), { let f: fn(&FrameSizes) -> u64 = $bytes; f(&sizes) }),)*]
        }

        impl FrameBuffers {
            /// Names the buffers that were allocated for [`frame_requests`], in the same order.
            pub fn from_allocated(buffers: Vec<crate::vk::Buffer>) -> Self {
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
    gaussians: u64,
    gaussian_blocks: u64,
    scan_blocks: u64,
    instances: u64,
    histogram: u64,
    digits: u64,
    tiles: u64,
    pixels: u64,
    /// 1 with backward, 0 without.
    backward: u64,
    /// 1 when very long tiles need several passes backward.
    passes: u64,
}

impl FrameSizes {
    fn new(capacity: &FrameCapacity, block: &Blocks) -> Self {
        let gaussians = u64::from(capacity.gaussians);
        let instances = u64::from(capacity.instances);
        let (columns, rows) = tile_grid(capacity.width, capacity.height);
        let backward = u64::from(capacity.backward);
        let tile_bits = tile_bits(columns.saturating_mul(rows));
        let depth_sort = block.sort_histogram_words(gaussians, u32::BITS);
        // A smaller image may have longer digits, in fewer passes.
        let tile_sort = (1..=tile_bits).map(|bits| block.sort_histogram_words(instances, bits)).max();
        Self {
            gaussians,
            gaussian_blocks: blocks(gaussians, block.stream.into()),
            scan_blocks: blocks(gaussians, block.scan.into()),
            instances,
            histogram: tile_sort.map_or(depth_sort, |words| words.max(depth_sort)),
            digits: 1 << block.sort_digit_bits(),
            tiles: u64::from(columns) * u64::from(rows),
            pixels: u64::from(capacity.width) * u64::from(capacity.height),
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
    /// Per Gaussian: 1 if visible.
    visible_flags: |s| s.gaussians * 4;
    /// Visible Gaussians per block, then the blocks' offsets.
    visible_blocks: |s| s.gaussian_blocks * 4;
    /// Per visible: its Gaussian.
    visible_list: |s| s.gaussians * 4;
    /// Per Gaussian: its place among the visible.
    visible_index: |s| s.gaussians * 4;
    /// Per visible: mean and half extents, px.
    mean2d_extent: |s| s.gaussians * 16;
    /// Per visible: conic and opacity.
    conic_opacity: |s| s.gaussians * 16;
    /// Per visible: colour and 1/z.
    color_inverse_depth: |s| s.gaussians * 16;
    /// Per visible: tiles, radius, number of tiles.
    footprints: |s| s.gaussians * 16;
    /// Per visible: bits of its depth; sorting scratch.
    depth_keys_a: |s| s.gaussians * 4;
    /// Sorting scratch.
    depth_keys_b: |s| s.gaussians * 4;
    /// Per rank in depth: the visible Gaussian (after an even number of sorting passes).
    order_a: |s| s.gaussians * 4;
    /// Sorting scratch.
    order_b: |s| s.gaussians * 4;
    /// Per rank: tiles touched.
    tile_counts: |s| s.gaussians * 4;
    /// Per rank: first instance.
    instance_offsets: |s| s.gaussians * 4;
    /// Sums and offsets of the scan's blocks.
    scan_blocks: |s| s.scan_blocks * 4;
    /// Sorting scratch: digit by block, and by run.
    histogram: |s| s.histogram * 4;
    /// Sorting scratch: keys per digit.
    digit_totals: |s| s.digits * 4;
    /// Per instance: tile; sorting scratch.
    tiles_a: |s| s.instances * 4;
    /// Sorting scratch.
    tiles_b: |s| s.instances * 4;
    /// Per sorted instance: its slot; sorting scratch.
    slots_a: |s| s.instances * 4;
    /// Sorting scratch.
    slots_b: |s| s.instances * 4;
    /// Per slot: the visible Gaussian.
    instance_visible: |s| s.instances * 4;
    /// Per sorted instance: the visible Gaussian.
    sorted_visible: |s| s.instances * 4;
    /// Per visible: its first slot.
    slot_begins: |s| s.gaussians * 4;
    /// Per tile: begin and end in the sorted instances.
    tile_ranges: |s| s.tiles * 8;
    /// Per pixel: premultiplied colour without background, transmittance.
    accumulated: |s| s.pixels * 16;
    /// Per pixel: sum of weights / z.
    inverse_depth: |s| s.pixels * 4;
    /// Per pixel: 1 + place of the last blended entry in its tile's list.
    last_entries: |s| s.pixels * 4;
    /// Per pixel: dL/d(r, g, b, inverse depth).
    image_gradient: |s| s.backward * s.pixels * 16;
    /// Per pixel: state between passes of the blending's backward.
    running: |s| s.passes * s.pixels * 8;
    /// Per slot: moments 1, dx, dy, dx dx.
    sums_a: |s| s.backward * s.instances * 16;
    /// Per slot: moments dx dy, dy dy; d red, d green.
    sums_b: |s| s.backward * s.instances * 16;
    /// Per slot: d blue, d inverse depth.
    sums_c: |s| s.backward * s.instances * 8;
    /// Per visible, planes named GRADIENT_*.
    gradients: |s| s.backward * s.gaussians * 16 * u64::from(GRADIENT_PLANES);
}

/// Checks that every dispatch of a frame of this capacity fits a grid of workgroups: indirect ones are not checked by
/// anybody else.
///
/// # Errors
/// [`Error::TooLarge`] with the number of workgroups.
pub fn check_grids(limits: &Limits, capacity: &FrameCapacity, block: &Blocks) -> Result<()> {
    let smallest = block.smallest();
    let (columns, rows) = tile_grid(capacity.width, capacity.height);
    let axis = u64::from(limits.max_workgroups_per_axis);
    let elements = u64::from(capacity.gaussians.max(capacity.instances));
    let checks = [
        (blocks(elements, smallest.into()), axis * axis),
        (u64::from(columns) * u64::from(rows), axis * axis),
        // The loss has a grid of tiles.
        (u64::from(columns.max(rows).max(3)) * u64::from(capacity.backward), axis),
    ];
    match checks.iter().find(|(needed, limit)| needed > limit) {
        None => Ok(()),
        Some(&(needed, limit)) => Err(Error::TooLarge {
            what: format!(
                "a frame of {}x{} pixels, {} Gaussians and {} instances",
                capacity.width, capacity.height, capacity.gaussians, capacity.instances
            ),
            needed,
            unit: "workgroups",
            limit,
            limit_name: "maxComputeWorkGroupCount",
        }),
    }
}

/// Bytes of all buffers of a frame.
pub fn frame_bytes(capacity: &FrameCapacity, block: &Blocks) -> u64 {
    frame_requests(capacity, block).iter().map(|(_, bytes)| bytes).sum()
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
