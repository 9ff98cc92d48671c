//! The bytes that a kernel must move: each element of its inputs and outputs once ("compulsory traffic").
//!
//! The recorder knows the bound capacity. The part that a frame uses follows from the memory plan (`ashsplat::frame`) at the
//! frame's own counts. A kernel that reads elements several times, such as blending, moves more than this through its caches. A
//! kernel at 100 % of the device's copy bandwidth can become faster only by moving less.

use ashsplat::frame::{FrameBuffers, FrameCapacity, LaunchSizes, PictureCapacity, ShStorage};
use ashsplat::vk::{Access, BoundBuffer, CommandRecord, Limits, SMALLEST_BUFFER};
use std::collections::HashMap;

/// Bytes of a vec4.
const VEC4: u64 = 16;
/// Planes of a Gaussian that culling reads: mean and opacity, rotation, scales.
const GEOMETRY_PLANES: u64 = 3;

/// Attributes of visible Gaussians, all of which may share one buffer.
const SPLAT_ROLES: [&str; 4] = ["mean2d_extent", "conic_opacity", "color_inverse_depth", "footprints"];

/// Bindings that no measured workload uses; some other buffer is bound instead.
const UNUSED_ROLES: [&str; 5] =
    ["cut_outs", "selection", "instance_gradients_d", "pose_sums", "parameter_gradients"];

#[derive(Clone, Copy, Debug, Default)]
pub struct Counts {
    pub gaussians: u32,
    pub visible: u32,
    pub instances: u32,
    pub width: u32,
    pub height: u32,
    /// Evaluated SH degree.
    pub sh_degree: u32,
    pub sh_storage: ShStorage,
    /// True if Adam's moments are packed: then they have as many planes as parameters with SH in halves.
    pub packed_moments: bool,
    /// Number of dispatches that share the Gaussians' planes.
    pub chunks: u64,
}

impl Counts {
    pub fn with_stats(self, visible: u32, instances: u32) -> Self {
        Self { visible, instances, ..self }
    }
}

/// Bytes by buffer at a workload's counts. Without counts, kernels touch everything that is bound.
pub struct Traffic {
    counts: Option<Counts>,
    /// Used bytes of a frame's buffers: sized by all Gaussians, by visible ones, by visible ones alone in the depth sort, or
    /// by instances alone in the tile sort.
    all: HashMap<&'static str, u64>,
    visible: HashMap<&'static str, u64>,
    depth_sort: HashMap<&'static str, u64>,
    tile_sort: HashMap<&'static str, u64>,
}

impl Traffic {
    /// Traffic of kernels that use their buffers whole.
    pub fn bound() -> Self {
        let none = HashMap::new;
        Self { counts: None, all: none(), visible: none(), depth_sort: none(), tile_sort: none() }
    }

    pub fn of_frame(limits: &Limits, counts: Counts) -> Self {
        let blocks = LaunchSizes::new(limits);
        let used = |gaussians: u32, instances: u32| {
            let capacity = FrameCapacity {
                gaussians,
                visible: gaussians,
                instances,
                pictures: PictureCapacity::of(counts.width, counts.height),
                backward: true,
                ..FrameCapacity::default()
            };
            FrameBuffers::requests(&capacity, &blocks).into_iter().collect::<HashMap<_, _>>()
        };
        Self {
            counts: Some(counts),
            all: used(counts.gaussians, counts.instances),
            visible: used(counts.visible, counts.instances),
            depth_sort: used(counts.visible, 0),
            tile_sort: used(0, counts.instances),
        }
    }

    /// Returns the (read, written) bytes of a command. `first`: true if it is the first of its kernel in its scope, where a
    /// sort generates its values instead of reading them.
    pub fn of(&self, command: &CommandRecord, first: bool) -> (u64, u64) {
        let made_up =
            |b: &BoundBuffer| first && command.name.starts_with("sort/sort_downsweep") && b.role == "values";
        // Blending reads its outputs only if a tile takes several passes.
        let outputs_only = first && command.name.starts_with("forward/blend");
        // Blending that composites the picture for the backward pass leaves no other output (FrameBuffers::rendered).
        let composites = command.buffers.iter().any(|b| b.role == "composited" && b.bytes > SMALLEST_BUFFER);
        let instead = |b: &BoundBuffer| composites && b.role == "accumulated";
        let (mut read, mut written) = (0, 0);
        for buffer in command.buffers.iter().filter(|buffer| !made_up(buffer) && !instead(buffer)) {
            let bytes = self.touched(command, buffer);
            match buffer.access {
                Access::Read => read += bytes,
                Access::Write => written += bytes,
                Access::ReadWrite if outputs_only => written += bytes,
                Access::ReadWrite => {
                    read += bytes;
                    written += bytes;
                }
            }
        }
        (read, written)
    }

    fn touched(&self, command: &CommandRecord, buffer: &BoundBuffer) -> u64 {
        let Some(counts) = &self.counts else { return buffer.bytes };
        if matches!(command.name, "fill" | "copy" | "update") {
            return buffer.bytes;
        }
        // Kernels that read parameters have one dispatch for each chunk.
        let planes = self.planes(command.name, buffer.role, counts);
        let dispatches = planes.map_or(1, |_| counts.chunks.max(1));
        let used = match (buffer.name, command.scope) {
            _ if UNUSED_ROLES.contains(&buffer.role) => Some(0),
            ("planes", _) => planes,
            // Densification's statistics and the inverse depth are off in measured workloads.
            ("statistics" | "depth_sums", _) => Some(0),
            // Expansion reads attributes only of Gaussians with more tiles than a list holds.
            _ if command.name == "forward/duplicate_with_tiles" && SPLAT_ROLES.contains(&buffer.role) => {
                Some(0)
            }
            // One buffer may be bound to several of these roles.
            _ if SPLAT_ROLES.contains(&buffer.role) => Some(u64::from(counts.visible) * VEC4),
            ("visible_flags" | "visible_blocks" | "visible_index", _) => self.all.get(buffer.name).copied(),
            (name, "depth sort") => self.depth_sort.get(name).copied(),
            (name, "tile sort") => self.tile_sort.get(name).copied(),
            (name, _) => self.visible.get(name).copied(),
        };
        used.map_or(buffer.bytes, |used| (used / dispatches).min(buffer.bytes))
    }

    /// Bytes of the planes that hold parameters or moments, in all dispatches.
    fn planes(&self, kernel: &str, role: &str, counts: &Counts) -> Option<u64> {
        let planes = |stored: ShStorage| u64::from(stored.planes(counts.sh_degree));
        let all = planes(counts.sh_storage);
        let (gaussians, planes) = match kernel {
            "forward/cull" => (counts.gaussians, GEOMETRY_PLANES),
            "forward/project" | "backward/project_backward" => (counts.visible, all),
            "optimizer/adam" if role.contains("parameters") => (counts.gaussians, all),
            "optimizer/adam" => (
                counts.gaussians,
                match (counts.packed_moments, role.contains('1')) {
                    (false, _) => planes(ShStorage::F32),
                    (true, true) => planes(ShStorage::Half),
                    // The second moments are in the buffers of the first.
                    (true, false) => 0,
                },
            ),
            _ => return None,
        };
        Some(u64::from(gaussians) * planes * VEC4)
    }
}
