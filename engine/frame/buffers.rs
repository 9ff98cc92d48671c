//! Buffers of a frame: their contents, their bytes, and the passes between which they live. Buffers that never live at the same
//! time share memory ([`pack`]).

use super::{FrameCapacity, LaunchSizes, PictureCapacity, SORT_ARRIVAL_BYTES, blocks, tile_bits, tile_grid};
use crate::error::{Error, Result};
use crate::kernels::blocks::CameraBlock;
use crate::kernels::constants::{
    ARGUMENTS_COUNT, CAMERA_BLOCK_WORDS, DEPTH_KEY_BITS, GRADIENT_PLANES, LENS_SUMS, PLANE_ROW, SPLAT_PLANES,
    STATE_WORDS,
};
use crate::scene::Camera;
use crate::vk::{Buffer, Life, Limits, PLACEMENT_ALIGNMENT, pack};

/// Bytes from one scene's camera block to the next. It leaves space for more members, meets the required offset alignment
/// of uniform blocks, and is far below their size limit. It is no larger because a frame of thousands of scenes writes as
/// many blocks.
pub const CAMERA_BLOCK_BYTES: u64 = CAMERA_BLOCK_WORDS as u64 * 4;
const _: () = assert!(
    (size_of::<CameraBlock>() as u64) < CAMERA_BLOCK_BYTES
        && CAMERA_BLOCK_BYTES.is_multiple_of(PLACEMENT_ALIGNMENT)
);

/// Declares buffers that are allocated together: a struct, its `requests` of names and bytes, and the assignment of the
/// allocated buffers. Each line has a field, the buffer's name if it differs, and the bytes. In a set with `lives`, a line may
/// end with the first and the last [`Pass`] of the buffer's life; without them it lives always.
macro_rules! buffer_set {
    (
        $(#[$about:meta])*
        $set_vis:vis struct $set:ident($($argument:ident: $kind:ty),*) $(with $lives:ident)? { $($sizes:tt)* }
        $(
            $(#[$doc:meta])*
            $vis:vis $field:ident $(as $name:literal)?: $bytes:expr $(, $first:ident..=$last:ident)?;
        )*
    ) => {
        $(#[$about])*
        #[derive(Clone)]
        $set_vis struct $set { $($(#[$doc])* $vis $field: $crate::vk::Buffer,)* }

        impl $set {
            /// Names and bytes of the buffers, in order.
            $set_vis fn requests($($argument: $kind),*) -> Vec<(&'static str, u64)> {
                $($sizes)*
                vec![$(($crate::frame::buffer_set!(@name $field $($name)?), $bytes),)*]
            }

            $crate::frame::buffer_set! { @lives ($($lives)?) $(($($first $last)?))* }

            /// Assigns the buffers that were allocated for the requests, in the same order.
            $set_vis fn from_allocated(buffers: Vec<$crate::vk::Buffer>) -> Self {
                let [$($field),*] = $crate::frame::array_of(buffers);
                Self { $($field),* }
            }
        }
    };
    (@lives () $($lives:tt)*) => {};
    (@lives (lives) $(($($first:ident $last:ident)?))*) => {
        /// Lives of the buffers, in order.
        pub const LIVES: &[$crate::vk::Life] = &[$($crate::frame::buffer_set!(@life $($first $last)?)),*];
    };
    (@life) => { $crate::vk::Life::ALWAYS };
    (@life $first:ident $last:ident) => {
        $crate::vk::Life { first: $crate::frame::Pass::$first as u8, last: $crate::frame::Pass::$last as u8 }
    };
    (@name $field:ident) => { stringify!($field) };
    (@name $field:ident $name:literal) => { $name };
}
pub(crate) use buffer_set;

/// Passes of a frame and of a training step, in order. Views that share one depth order run those from projection to blending in
/// turn. A frame without a backward pass ends with its blending.
#[derive(Clone, Copy)]
pub(crate) enum Pass {
    Cull,
    Project,
    DepthSort,
    Count,
    Duplicate,
    TileSort,
    Ranges,
    Blend,
    Loss,
    BlendBackward,
    ProjectBackward,
    Update,
    BetweenSteps,
}

buffer_set! {
    /// Buffers of a frame. Each is valid in the passes of its life.
    pub struct FrameBuffers(capacity: &FrameCapacity, sizes: &LaunchSizes) with lives {
        let [gaussians, visible, instances] =
            [capacity.gaussians, capacity.visible, capacity.instances].map(u64::from);
        let PictureCapacity { pixels, tiles, strip_values, .. } = capacity.pictures;
        let gaussian_blocks = blocks(gaussians, sizes.elementwise_workgroup.into());
        let depth_sort = sizes.sort_histogram_words(visible, DEPTH_KEY_BITS);
        // A smaller image may use longer digits in fewer passes.
        let tile_bits = tile_bits(tiles.min(u32::MAX.into()) as u32);
        let tile_sort = (1..=tile_bits).map(|bits| sizes.sort_histogram_words(instances, bits)).max();
        // Visible Gaussians have records of all attributes, or a buffer for each attribute.
        let record = u64::from(SPLAT_PLANES);
        let apart = u64::from(visible * 16 * record > sizes.max_binding_bytes);
        let splat_stride = if apart == 0 { record } else { 1 };
        // 1 with the buffers of the backward pass, otherwise 0.
        let backward = u64::from(capacity.backward);
        let backward_instances = backward * instances;
        let strips = backward * u64::from(sizes.strips) * strip_values;
        let [depth, last_entries, trained] =
            [capacity.depth, capacity.last_entries, capacity.trained].map(u64::from);
        let [pick, motion, surface] =
            [capacity.outputs.pick, capacity.outputs.motion, capacity.outputs.surface].map(u64::from);
    }
    /// Words named STATE_* in constants.glsl.
    pub state: u64::from(STATE_WORDS) * 4;
    /// Indirect arguments, named ARGUMENTS_*.
    pub arguments: u64::from(ARGUMENTS_COUNT) * 16;
    /// Per scene: its camera and draw settings, see camera_block.glsl.
    pub camera_blocks: u64::from(capacity.scenes) * CAMERA_BLOCK_BYTES;
    /// Per range of parameters: indirect arguments, and its range of visible Gaussians. There are fewer ranges than culling
    /// blocks.
    pub visible_ranges: gaussian_blocks.max(1) * 32;
    /// Per Gaussian: 1 if visible.
    pub visible_flags: gaussians * 4, Cull..=Cull;
    /// Per culling block: number of visible Gaussians, which the scan replaces by the index of its first one.
    pub visible_blocks: gaussian_blocks * 4;
    /// Per visible Gaussian: index of the Gaussian.
    pub visible_list: visible * 4, Cull..=ProjectBackward;
    /// Per Gaussian: its index among the visible Gaussians.
    pub visible_index: gaussians * 4, Cull..=Update;
    /// Per visible Gaussian: mean and half extents, px. Or records of all four attributes, see [`FrameBuffers::splats`].
    splats: visible * 16 * splat_stride, Project..=ProjectBackward;
    /// Per visible Gaussian: conic and opacity.
    conic_opacity: apart * visible * 16, Project..=ProjectBackward;
    /// Per visible Gaussian: colour and 1/z.
    color_inverse_depth: apart * visible * 16, Project..=ProjectBackward;
    /// Per visible Gaussian: shape of its rows of tiles, number of tiles (tile_span.glsl).
    footprints: apart * visible * 16, Project..=ProjectBackward;
    /// Per visible Gaussian: the list of its tiles if they are few, otherwise their number (tile_list.glsl).
    pub tile_lists: visible * 8, Project..=Count;
    /// [`Self::depth_sort_keys`].
    sorted_depths: visible * 4, Project..=DepthSort;
    /// [`Self::depth_sort_keys`].
    other_depths: visible * 4, Project..=DepthSort;
    /// Per depth rank: the visible Gaussian. Of views with one order, the first sorts it before the projections of the others.
    pub depth_order: visible * 4, Project..=Blend;
    /// [`Self::depth_sort_values`].
    other_order: visible * 4, DepthSort..=DepthSort;
    /// Per depth rank: first word of the Gaussian's list of tiles.
    pub list_heads: visible * 4, Count..=Duplicate;
    /// Per depth rank: second word of the list.
    pub list_rows: visible * 4, Count..=Duplicate;
    /// Per depth rank: number of instances of the earlier ranks of its block.
    pub block_instances: visible * 4, Count..=Duplicate;
    /// Per block of depth ranks: number of instances, which the scan replaces by the index of the first one.
    pub instance_blocks: blocks(visible, sizes.scan_block.into()) * 4, Count..=Duplicate;
    /// Sorting scratch: counts per digit and block, and per digit and run.
    pub histogram: tile_sort.map_or(depth_sort, |words| words.max(depth_sort)) * 4, DepthSort..=TileSort;
    /// Sorting scratch: keys per digit.
    pub digit_totals: (1 << sizes.sort_digit_bits()) * 4, DepthSort..=TileSort;
    /// Per sorted instance: its tile.
    pub sorted_tiles: instances * 4, Duplicate..=Ranges;
    /// [`Self::tile_sort_keys`].
    other_tiles: instances * 4, Duplicate..=TileSort;
    /// Per sorted instance: its index before the tile sort; without backward, the visible Gaussian.
    pub sorted_instances: instances * 4, Duplicate..=BlendBackward;
    /// [`Self::tile_sort_values`].
    other_instances: instances * 4, Duplicate..=TileSort;
    /// Per instance before the tile sort: the visible Gaussian. Without backward it is in [`Self::tile_sort_values`].
    pub instance_visible: backward_instances * 4, Duplicate..=Ranges;
    /// [`Self::sorted_visible`] with backward, gathered by the kernel that finds the ranges.
    pub gathered_visible: backward_instances * 4, Ranges..=BlendBackward;
    /// Per visible Gaussian: its first instance.
    pub first_instances: backward * visible * 4, Duplicate..=ProjectBackward;
    /// Per tile: begin and end in the sorted instances. Behind them, so that one fill clears both: [`Self::sort_arrivals`].
    pub tile_ranges: (tiles * 8).next_multiple_of(PLACEMENT_ALIGNMENT) + SORT_ARRIVAL_BYTES;
    /// Per pixel: premultiplied colour without background, transmittance. With backward in strips it is written only
    /// between passes, and with the inverse depth.
    pub accumulated: pixels * 16, Blend..=BlendBackward;
    /// The composited picture as three planes in strips, if the backward pass reads strips.
    pub composited: 3 * strips * 4, Blend..=BlendBackward;
    /// Per pixel: sum of weights / z, or of weights * z in frames with an expected or a linear depth.
    pub depth_sums: depth * pixels * 4, Blend..=BlendBackward;
    /// Per pixel: 1 + list index of the last blended entry of its tile.
    pub last_entries: (last_entries | backward) * pixels * 4, Blend..=BlendBackward;
    /// Gradient of the loss. Per pixel: dL/d(r, g, b), a word that nothing reads; with strips, three planes of dL/d(r, g, b).
    pub image_gradient: if strips > 0 { 3 * strips * 4 } else { backward * pixels * 16 }, Loss..=BlendBackward;
    /// Per pixel: state between passes of the backward blending.
    pub backward_state: backward * u64::from(capacity.blend_passes > 1) * pixels * 8, BlendBackward..=BlendBackward;
    /// Per instance before the tile sort: moments 1, dx, dy, dx dx.
    pub instance_gradients_a: backward_instances * 16, BlendBackward..=ProjectBackward;
    /// Per instance before the tile sort: moments dx dy, dy dy; d red, d green.
    pub instance_gradients_b: backward_instances * 16, BlendBackward..=ProjectBackward;
    /// Per instance before the tile sort: d blue, d inverse depth.
    pub instance_gradients_c: backward_instances * 8, BlendBackward..=ProjectBackward;
    /// [`Self::absolute_gradients`].
    instance_gradients_d: backward_instances * u64::from(capacity.absolute) * 8, BlendBackward..=ProjectBackward;
    /// Per visible Gaussian: planes named GRADIENT_*.
    pub gradients: backward * visible * 16 * u64::from(GRADIENT_PLANES), ProjectBackward..=Update;
    /// Per subgroup of visible Gaussians, indexed as subgroups of all Gaussians: sums of dL/dν and dL/dω of the camera's
    /// pose, two vec3. Behind them, from `first_lens_sum` on, per culling block of visible Gaussians: sums of the gradient of the
    /// lens. See [`Self::camera_sums`].
    pose_sums: backward * u64::from(capacity.camera_sums)
        * (u64::from(first_lens_sum(capacity)) * 12 + gaussian_blocks * LENS_SUM_BYTES), BlendBackward..=Update;
    /// Per Gaussian: a plane through which densification moves the others.
    pub moved_plane: trained * gaussians.next_multiple_of(PLANE_ROW.into()) * 16, BetweenSteps..=BetweenSteps;
    /// Per pixel: 1 + index of the picked Gaussian in its tile's list, 0 for none; bits of its weight.
    pub picks: pick * pixels * 8, Blend..=Blend;
    /// Per scene: index of its first Gaussian in the frame, for picks.
    pub scene_firsts: pick * u64::from(capacity.scenes) * 4;
    /// Per visible Gaussian: motion on the screen, px.
    pub motions: motion * visible * 8, Project..=Blend;
    /// Per pixel: sum of weights * motions, px.
    pub motion_sums: motion * pixels * 8, Blend..=Blend;
    /// Per visible Gaussian: its normal in the camera's frame; slope of its depth over the picture, as two half floats.
    pub splat_surfaces: surface * visible * 16, Project..=Blend;
    /// Per pixel: sum of weights * normals, in the camera's frame; depth of the surface, world units, 0 without one.
    pub surfaces: surface * pixels * 16, Blend..=Blend;
}

/// Declares [`Outputs`].
macro_rules! outputs {
    ($($(#[$doc:meta])* $output:ident,)*) => {
        /// Outputs of blending besides the picture (blend_auxiliary.glsl). By default there are none, and the kernels are those of a
        /// plain frame.
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
        pub struct Outputs { $($(#[$doc])* pub $output: bool,)* }

        impl Outputs {
            /// Returns the outputs with their names.
            pub(crate) fn named(self) -> impl IntoIterator<Item = (&'static str, bool)> {
                [$((stringify!($output), self.$output)),*]
            }

            /// Returns the outputs of both.
            #[must_use]
            pub fn and(self, other: Self) -> Self {
                Self { $($output: self.$output || other.$output,)* }
            }

            /// Returns every combination of these outputs.
            pub(crate) fn subsets(self) -> impl Iterator<Item = Self> {
                let mut all = vec![Self::default()];
                $(if self.$output {
                    all.extend(all.clone().into_iter().map(|outputs| Self { $output: true, ..outputs }));
                })*
                all.into_iter()
            }
        }
    };
}

outputs! {
    /// Gaussian of the largest weight per pixel.
    pick,
    /// Mean motion per pixel.
    motion,
    /// Normal and depth of the surface per pixel.
    surface,
}

impl Outputs {
    /// True if there is an output.
    pub fn any(self) -> bool {
        self != Self::default()
    }
}

/// Returns the `N` results of `N` requests.
pub(crate) fn array_of<T, const N: usize>(all: Vec<T>) -> [T; N] {
    match all.try_into() {
        Ok(all) => all,
        Err(_) => panic!("one result per request"),
    }
}

/// Bytes of the sums of a subgroup ([`FrameBuffers::pose_sums`]): two vec3. Subgroups have four lanes or more.
pub(crate) const POSE_SUM_BYTES: u64 = 24;
/// Bytes of the sums of a lens's gradient in a culling block.
pub(crate) const LENS_SUM_BYTES: u64 = 4 * LENS_SUMS as u64;

/// Place, in vec3, of the sums of a lens's gradient behind those of the pose.
pub(crate) fn first_lens_sum(capacity: &FrameCapacity) -> u32 {
    capacity.gaussians.div_ceil(4) * (POSE_SUM_BYTES / 12) as u32
}

/// Returns the bytes of requests with these lives in one block, including the padding between them.
pub(crate) fn packed_bytes(requests: &[(&'static str, u64)], lives: &[Life]) -> u64 {
    let bytes: Vec<u64> = requests.iter().map(|(_, bytes)| *bytes).collect();
    pack(&bytes, lives, u64::MAX).map_or(u64::MAX, |packing| packing.blocks.iter().sum())
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
    /// Distance, in vec4, between successive visible Gaussians. If it is [`SPLAT_PLANES`], all four are the same buffer.
    pub stride: u32,
}

impl FrameBuffers {
    /// Requests of a frame, then those of the scratch of a loss, and the lives of all.
    pub(crate) fn requests_with(
        capacity: &FrameCapacity,
        sizes: &LaunchSizes,
        loss_scratch: &[(&'static str, u64)],
    ) -> (Vec<(&'static str, u64)>, Vec<Life>) {
        let requests = [&Self::requests(capacity, sizes), loss_scratch].concat();
        let mut lives = Self::LIVES.to_vec();
        lives.resize(requests.len(), Life { first: Pass::Loss as u8, last: Pass::Loss as u8 });
        (requests, lives)
    }

    /// Camera block of a scene, by its place in the frame.
    pub(crate) fn camera_block(&self, scene: usize) -> Buffer {
        self.camera_blocks.range(scene as u64 * CAMERA_BLOCK_BYTES, CAMERA_BLOCK_BYTES)
    }

    /// Indirect arguments at this index (ARGUMENTS_*).
    pub(crate) fn arguments_at(&self, index: u32) -> Buffer {
        self.arguments.range(u64::from(index) * 16, 12)
    }

    /// Indirect arguments of a dispatch over the visible Gaussians of one parameter range, by the frame's index of its first
    /// Gaussian. Their index in `visible_ranges` is that of the range's first culling block.
    pub(crate) fn range_arguments(&self, sizes: &LaunchSizes, first_in_frame: u32) -> Buffer {
        self.visible_ranges.range(32 * u64::from(first_in_frame / sizes.elementwise_workgroup), 12)
    }

    /// [`SortBuffers::arrivals`](crate::passes::sort::SortBuffers::arrivals) of both sorts.
    pub fn sort_arrivals(&self) -> Buffer {
        self.tile_ranges.range(self.tile_ranges.bytes() - SORT_ARRIVAL_BYTES, SORT_ARRIVAL_BYTES)
    }

    /// Keys of the depth sort, alternately read and written; the first has the depths, below 2^[`DEPTH_KEY_BITS`].
    pub fn depth_sort_keys(&self, sizes: &LaunchSizes) -> [&Buffer; 2] {
        ending_in(&self.sorted_depths, &self.other_depths, sizes, DEPTH_KEY_BITS)
    }

    /// Values of the depth sort, alternately read and written. They end in [`Self::depth_order`].
    pub fn depth_sort_values(&self, sizes: &LaunchSizes) -> [&Buffer; 2] {
        ending_in(&self.depth_order, &self.other_order, sizes, DEPTH_KEY_BITS)
    }

    /// Keys of the tile sort, alternately read and written; the first has the instances' tiles. They end in
    /// [`Self::sorted_tiles`].
    pub fn tile_sort_keys(&self, sizes: &LaunchSizes, camera: &Camera) -> [&Buffer; 2] {
        ending_in(&self.sorted_tiles, &self.other_tiles, sizes, bits_of_tiles(camera))
    }

    /// Values of the tile sort, alternately read and written. They end in [`Self::sorted_instances`].
    pub fn tile_sort_values(&self, sizes: &LaunchSizes, camera: &Camera) -> [&Buffer; 2] {
        ending_in(&self.sorted_instances, &self.other_instances, sizes, bits_of_tiles(camera))
    }

    /// Per sorted instance: the visible Gaussian. Valid from the ranges on; without backward, from the tile sort on.
    pub fn sorted_visible(&self, keeps_instances: bool) -> &Buffer {
        if keeps_instances { &self.gathered_visible } else { &self.sorted_instances }
    }

    /// The blended picture that the loss and the backward pass read: [`Self::composited`] with strips,
    /// otherwise [`Self::accumulated`].
    pub fn rendered(&self, sizes: &LaunchSizes) -> &Buffer {
        if sizes.strips { &self.composited } else { &self.accumulated }
    }

    /// Per instance before the tile sort: absolute gradients of the 2D mean. Unless `absolute`, another buffer, which is
    /// bound but neither read nor written.
    pub fn absolute_gradients(&self, absolute: bool) -> &Buffer {
        if absolute { &self.instance_gradients_d } else { &self.instance_gradients_c }
    }

    /// Sums for the gradients of the camera's pose and lens. Unless the frame has them, another buffer, which is bound but neither
    /// read nor written.
    pub fn camera_sums(&self, capacity: &FrameCapacity) -> &Buffer {
        if capacity.camera_sums { &self.pose_sums } else { &self.gradients }
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

/// Checks that every dispatch of a frame of this capacity fits a grid of workgroups. Vulkan does not check
/// indirect dispatches.
///
/// # Errors
/// [`Error::TooLarge`] with the number of workgroups.
pub fn check_grids(limits: &Limits, capacity: &FrameCapacity, sizes: &LaunchSizes) -> Result<()> {
    let smallest = sizes.smallest();
    let PictureCapacity { pixels, tiles, side_tiles, .. } = capacity.pictures;
    let axis = u64::from(limits.max_workgroups_per_axis);
    let elements = u64::from(capacity.gaussians.max(capacity.instances));
    let checks = [
        (blocks(elements, smallest.into()), axis * axis),
        (tiles, axis * axis),
        // The loss has one workgroup per tile.
        (u64::from(side_tiles.max(3)) * u64::from(capacity.backward), axis),
    ];
    match checks.iter().find(|(needed, limit)| needed > limit) {
        None => Ok(()),
        Some(&(needed, limit)) => {
            let FrameCapacity { gaussians, instances, .. } = capacity;
            let what = format!("a frame of {pixels} pixels, {gaussians} Gaussians and {instances} instances");
            Err(Error::too_large(what, (needed, "workgroups"), (limit, "maxComputeWorkGroupCount")))
        }
    }
}

/// True if a device's limits allow the buffers and grids of a frame, regardless of memory.
pub fn frame_fits_device(limits: &Limits, capacity: &FrameCapacity, sizes: &LaunchSizes) -> bool {
    let max = limits.max_storage_buffer_range.min(limits.max_allocation_bytes);
    check_grids(limits, capacity, sizes).is_ok()
        && FrameBuffers::requests(capacity, sizes).iter().all(|(_, bytes)| *bytes <= max)
}

/// Bits of the tiles' indices of a camera's image.
pub(crate) fn bits_of_tiles(camera: &Camera) -> u32 {
    let (columns, rows) = tile_grid(camera.width, camera.height);
    tile_bits(columns * rows)
}

/// Two buffers in the order in which a sort of keys below 2^`key_bits` ends in `result`. The other one is then free.
fn ending_in<'a>(
    result: &'a Buffer,
    other: &'a Buffer,
    sizes: &LaunchSizes,
    key_bits: u32,
) -> [&'a Buffer; 2] {
    let mut pair = [result, other];
    pair.rotate_left(sizes.sorted_side(key_bits));
    pair
}
