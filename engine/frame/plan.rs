//! Sizes, capacities and block counts of a frame, as pure arithmetic on the device's limits.
//!
//! A buffer has one element per Gaussian, per visible Gaussian, per instance (one (tile, Gaussian) pair), per tile or per
//! pixel. Only the device knows the numbers of visible Gaussians and instances of a frame, so the sizes here are
//! capacities.

use super::launch_sizes::blocks;
use super::tuning::ELEMENTWISE_WORKGROUP;
use super::{LaunchSizes, Outputs, Strips};
use crate::error::{Error, Result};
use crate::kernels::constants::{
    GRADIENT_PLANES, PLANE_ROW, PLANE_SH, SH_PLANES_0, SH_PLANES_1, SH_PLANES_2, SH_PLANES_3, TILE_SIZE,
};
use crate::scene::Camera;
use crate::vk::Limits;
use std::ops::Range;

/// Number of parameter planes of a Gaussian with SH up to `sh_degree`: three of geometry, the rest SH.
pub const fn parameter_planes(sh_degree: u32) -> u32 {
    PLANE_SH
        + match sh_degree {
            0 => SH_PLANES_0,
            1 => SH_PLANES_1,
            2 => SH_PLANES_2,
            _ => SH_PLANES_3,
        }
}

/// Storage of a scene's SH coefficients on the device.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "lowercase"))]
pub enum ShStorage {
    /// A float32 each: 192 bytes per Gaussian of SH degree 3.
    #[default]
    F32,
    /// A half each: 96 bytes. Rounded to the nearest by uploads, up or down at random by training, which takes packed moments then.
    Half,
    /// A byte each, but floats for the base colour: 64 bytes. A byte is a number of steps: of 1/128, as in SPZ files, where all of the
    /// Gaussian's coefficients are multiples of it, and not both 1 and -1 among them, otherwise of a step of its own. Only for drawing.
    Bytes,
}

impl ShStorage {
    /// Number of parameter planes of a Gaussian with SH up to `sh_degree`.
    pub const fn planes(self, sh_degree: u32) -> u32 {
        match self {
            Self::F32 => parameter_planes(sh_degree),
            // Two planes in one.
            Self::Half => PLANE_SH + (parameter_planes(sh_degree) - PLANE_SH).div_ceil(2),
            Self::Bytes => PLANE_SH + 1 + sh_degree,
        }
    }
}

/// Returns the planes stored together with `plane`: the geometry, or one SH degree.
fn group_of(plane: u32, planes_up_to: impl Fn(u32) -> u32) -> Range<u32> {
    match (0..=3).find(|&degree| plane < planes_up_to(degree)) {
        _ if plane < PLANE_SH => 0..PLANE_SH,
        Some(0) => PLANE_SH..planes_up_to(0),
        Some(degree) => planes_up_to(degree - 1)..planes_up_to(degree),
        None => unreachable!("no Gaussian has a plane {plane}"),
    }
}

/// Range of Gaussians whose parameter planes are in one buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GaussianRange {
    /// Index of the buffer.
    pub chunk: usize,
    /// Index of the range's first Gaussian in the scene.
    pub first: u32,
    /// Number of Gaussians in the range.
    pub count: u32,
}

/// Split of the parameters of up to `capacity` Gaussians into buffers that fit a binding.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ScenePlan {
    /// Capacity in Gaussians.
    pub capacity: u32,
    /// Stored SH degree.
    pub sh_degree: u32,
    /// Storage of SH coefficients. [`Renderer`](crate::Renderer) differentiates only floats.
    pub sh_storage: ShStorage,
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
    /// [`Error::TooLarge`] when the count exceeds 30-bit indices.
    pub fn new(limits: &Limits, capacity: u32, sh_degree: u32, sh_storage: ShStorage) -> Result<Self> {
        const MAX_GAUSSIANS: u32 = 1 << 30;
        if capacity > MAX_GAUSSIANS {
            let limit = (MAX_GAUSSIANS.into(), "30-bit indices");
            return Err(Error::too_large("the scene", (capacity.into(), "Gaussians"), limit));
        }
        let planes = sh_storage.planes(sh_degree);
        let align = u64::from(ELEMENTWISE_WORKGROUP);
        let bytes_per_gaussian = u64::from(planes) * 16;
        let largest =
            limits.max_storage_buffer_range.min(limits.max_allocation_bytes) / bytes_per_gaussian / align;
        // All chunks have one size, so that the last one wastes little.
        let wanted = blocks(u64::from(capacity).max(1), align);
        let chunks = blocks(wanted, largest.max(1));
        let chunk_gaussians = to_u32(blocks(wanted, chunks) * align)?;
        Ok(Self { capacity, sh_degree, sh_storage, planes, chunk_gaussians, chunks: to_u32(chunks)? })
    }

    /// Bytes of one chunk.
    pub fn chunk_bytes(&self) -> u64 {
        u64::from(self.chunk_gaussians) * u64::from(self.planes) * 16
    }

    /// Plan for the same Gaussians with two SH planes in one. The same plan if they are so already.
    pub(crate) fn halved(&self) -> Self {
        let sh_storage = ShStorage::Half;
        Self { sh_storage, planes: sh_storage.planes(self.sh_degree), ..*self }
    }

    /// Returns where a plane is in a chunk, as `place_in` of planes.glsl takes it.
    pub(crate) fn plane_place(&self, plane: u32) -> [u32; 3] {
        let Range { start, end } = self.group(plane);
        [start * self.chunk_gaussians, end - start, plane - start]
    }

    /// Returns the planes stored together with `plane`.
    pub(crate) fn group(&self, plane: u32) -> Range<u32> {
        group_of(plane, |degree| self.sh_storage.planes(degree))
    }

    /// Returns the index, in vec4, of plane `plane` of Gaussian `index` in a chunk. The groups of planes are 0 to 2
    /// (geometry), 3, 4 and 5, 6 to 9, and 10 to 14 (one SH degree each), or with SH in halves 3, 4, 5 and 6, and 7 and 8, or with
    /// bytes 3, 4, 5, and 6. A group is contiguous for all Gaussians, in rows of eight Gaussians. Planes `first` to `end - 1` begin at
    /// `first * chunk_gaussians + (index / 8 * (end - first) + plane - first) * 8 + index % 8`.
    ///
    /// # Panics
    /// If `plane` is not below `planes`, or `index`, which counts from the chunk's first Gaussian, is not
    /// below `chunk_gaussians`.
    pub fn place(&self, plane: u32, index: usize) -> usize {
        assert!(plane < self.planes && index < self.chunk_gaussians as usize, "{plane}, {index}: {self:?}");
        let [first, planes, own] = self.plane_place(plane).map(|part| part as usize);
        let row = PLANE_ROW as usize;
        first + (index / row * planes + own) * row + index % row
    }

    /// Returns the chunks that `count` Gaussians occupy.
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
    /// Gaussians.
    pub gaussians: u32,
    /// Visible Gaussians. A frame with more overflows and is run again.
    pub visible: u32,
    /// (tile, Gaussian) instances.
    pub instances: u32,
    /// Scenes, each with a camera block. Views that share one depth order count the scenes of all views.
    pub scenes: u32,
    /// Pictures.
    pub pictures: PictureCapacity,
    /// Passes of blending. Each handles [`LaunchSizes::entries_per_pass`] entries of a tile.
    pub blend_passes: u32,
    /// True if the frame has the buffers of the backward pass. Every frame in these buffers then keeps instance indices through
    /// the tile sort, also one without a backward pass.
    pub backward: bool,
    /// True if these include the absolute gradients of the 2D means.
    pub absolute: bool,
    /// True if these include the sums for the gradients of the camera's pose and lens.
    pub camera_sums: bool,
    /// True if the frame has [`FrameBuffers::depth_sums`](super::FrameBuffers::depth_sums).
    pub depth: bool,
    /// True if the frame has [`FrameBuffers::last_entries`](super::FrameBuffers::last_entries) also without `backward`.
    pub last_entries: bool,
    /// True if densification works in the frame's memory between steps.
    pub trained: bool,
    /// Outputs besides the picture.
    pub outputs: Outputs,
}

impl Default for FrameCapacity {
    /// Capacity before the first frame: of one scene and one pass of blending, otherwise nothing.
    fn default() -> Self {
        Self {
            gaussians: 0,
            visible: 0,
            instances: 0,
            scenes: 1,
            pictures: PictureCapacity::NONE,
            blend_passes: 1,
            backward: false,
            absolute: false,
            camera_sums: false,
            depth: false,
            last_entries: false,
            trained: false,
            outputs: Outputs::default(),
        }
    }
}

/// Returns the size of an image in tiles: (columns, rows).
pub const fn tile_grid(width: u32, height: u32) -> (u32, u32) {
    (width.div_ceil(TILE_SIZE), height.div_ceil(TILE_SIZE))
}

/// Bits of a tile index, at least one.
pub const fn tile_bits(tiles: u32) -> u32 {
    if tiles <= 2 { 1 } else { 32 - (tiles - 1).leading_zeros() }
}

/// Bytes per element of the widest buffer per instance.
const INSTANCE_BYTES: u64 = 16;

/// First estimate of the visible Gaussians of a frame; a frame with more overflows and is run again. A camera sees only
/// part of a large scene, and most of a frame's memory is per visible Gaussian.
pub fn initial_visible(gaussians: u32) -> u32 {
    gaussians.min(MIN_VISIBLE.max(gaussians / 4))
}

/// Lower bound of the estimate, unless the scene has fewer Gaussians.
pub const MIN_VISIBLE: u32 = 1 << 12;

/// First estimate of the instances of a frame with `visible` visible Gaussians, bounded by a binding and a grid. A frame
/// with more overflows and is run again.
pub fn initial_instances(limits: &Limits, visible: u32, pictures: &PictureCapacity) -> u32 {
    let guess = u64::from(visible) * 6 + pictures.tiles * 16;
    guess.max(MIN_INSTANCES.into()).min(max_trained_instances(limits).into()) as u32
}

/// Lower bound of the estimate of a frame's instances.
pub const MIN_INSTANCES: u32 = 1 << 12;

/// Returns the most instances of a training step's frame, as the limits of a binding and a grid allow.
pub fn max_trained_instances(limits: &Limits) -> u32 {
    let axis = u64::from(limits.max_workgroups_per_axis);
    let bytes = limits.max_storage_buffer_range.min(limits.max_allocation_bytes);
    let max = (bytes / INSTANCE_BYTES).min(axis * axis * u64::from(LaunchSizes::new(limits).smallest()));
    max.clamp(1, u32::MAX.into()) as u32
}

/// Returns the most Gaussians that can be trained on a device: their gradients are in one buffer.
pub fn max_trained_gaussians(limits: &Limits) -> u32 {
    let bytes = limits.max_storage_buffer_range.min(limits.max_allocation_bytes);
    (bytes / (16 * u64::from(GRADIENT_PLANES))).min(u32::MAX.into()) as u32
}

/// Index of a frame's first Gaussian of the scene after one that ends before `end`. It begins a culling block, of `block` Gaussians,
/// because a culling block belongs to one scene. `u32::MAX` for a begin beyond all indices, which exceeds any capacity.
pub const fn next_scene_begin(end: u32, block: u32) -> u32 {
    match end.checked_next_multiple_of(block) {
        Some(begin) => begin,
        None => u32::MAX,
    }
}

/// Number of Gaussians in a frame of a scene with this capacity and `frozen` neighbours.
pub const fn gaussians_with(capacity: u32, frozen: u32) -> u32 {
    match frozen {
        0 => capacity,
        _ => next_scene_begin(capacity, ELEMENTWISE_WORKGROUP).saturating_add(frozen),
    }
}

/// Returns the most Gaussians that can be trained on a device beside `frozen` neighbours.
pub fn max_trained_among(limits: &Limits, frozen: u32) -> u32 {
    match (max_trained_gaussians(limits), frozen) {
        (max, 0) => max,
        (max, _) => max.saturating_sub(frozen) / ELEMENTWISE_WORKGROUP * ELEMENTWISE_WORKGROUP,
    }
}

/// Converts `n` to u32.
///
/// # Errors
/// [`Error::TooLarge`] when it does not fit.
pub fn to_u32(n: u64) -> Result<u32> {
    let limit = (u32::MAX.into(), "32-bit counts");
    u32::try_from(n).map_err(|_| Error::too_large("a count", (n, "elements"), limit))
}

/// Sizes of the pictures that a frame's buffers hold. Each field is the largest over the pictures, so that no memory is
/// planned for a picture that is both wide and high.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PictureCapacity {
    /// Pixels.
    pub pixels: u64,
    /// Tiles.
    pub tiles: u64,
    /// Values per plane in [`Strips`], for any picture with the same grid of tiles. Only frames with backward use them.
    pub strip_values: u64,
    /// Tiles along the longer side. Only the loss of backward frames has a grid of workgroups with these sides.
    pub side_tiles: u32,
}

impl PictureCapacity {
    /// Capacity for no picture.
    pub const NONE: Self = Self { pixels: 0, tiles: 0, strip_values: 0, side_tiles: 0 };

    /// Returns the capacity for pictures of one size, px.
    pub fn of(width: u32, height: u32) -> Self {
        let (columns, rows) = tile_grid(width, height);
        let strips =
            Strips { width: columns.saturating_mul(TILE_SIZE), height: rows.saturating_mul(TILE_SIZE) };
        Self {
            pixels: u64::from(width) * u64::from(height),
            tiles: u64::from(columns) * u64::from(rows),
            strip_values: strips.values(),
            side_tiles: columns.max(rows),
        }
    }

    /// Returns the capacity for the picture of each camera.
    pub fn of_cameras<'a>(cameras: impl IntoIterator<Item = &'a Camera>) -> Self {
        cameras.into_iter().map(|camera| Self::of(camera.width, camera.height)).fold(Self::NONE, Self::and)
    }

    /// Same capacity, without the sizes that only frames with backward need.
    #[must_use]
    pub fn without_backward(self) -> Self {
        Self { strip_values: 0, side_tiles: 0, ..self }
    }

    /// Returns the capacity for the pictures of both.
    #[must_use]
    pub fn and(self, other: Self) -> Self {
        Self {
            pixels: self.pixels.max(other.pixels),
            tiles: self.tiles.max(other.tiles),
            strip_values: self.strip_values.max(other.strip_values),
            side_tiles: self.side_tiles.max(other.side_tiles),
        }
    }
}
