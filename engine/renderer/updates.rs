//! New parameters for scenes, copied before a recorded frame.

use super::device_scene::DeviceScene;
use crate::error::Result;
use crate::kernels::constants::PLANE_ROW;
use crate::plan::{ScenePlan, plane_group};
use crate::planes;
use crate::scene::Gaussians;
use crate::vk::{Buffer, Recorder};
use std::ops::Range;

/// New parameters for some Gaussians of a scene, copied before the frame is rendered.
#[derive(Clone, Copy)]
pub struct Update<'a> {
    /// The scene.
    pub scene: &'a DeviceScene,
    /// Index of the first replaced Gaussian.
    pub first: u32,
    /// The new Gaussians. SH above the scene's degree is dropped, missing SH is zero.
    pub gaussians: &'a Gaussians,
}

impl Update<'_> {
    /// Whether both replace some of the same Gaussians. Clones of a scene share its buffers.
    fn overlaps(&self, other: &Self) -> bool {
        let range = |u: &Self| (u64::from(u.first), u64::from(u.first) + u.gaussians.len() as u64);
        let ((first, end), (other_first, other_end)) = (range(self), range(other));
        let chunks = |u: &Self| u.scene.buffers.chunks.iter().map(Buffer::handle).collect::<Vec<_>>();
        first < other_end && other_first < end && {
            let theirs = chunks(other);
            chunks(self).iter().any(|chunk| theirs.contains(chunk))
        }
    }
}

/// The copies of one update.
pub(super) struct Staged {
    /// Whether it needs a barrier: an update since the last barrier writes some of the same Gaussians.
    behind_barrier: bool,
    /// From the staging memory to the scene.
    copies: Vec<(Buffer, Buffer)>,
}

/// Writes new parameters into the slot's staging memory, which is not in use, and returns the copies from it.
pub(super) fn stage_updates(staging: Option<&Buffer>, updates: &[Update<'_>]) -> Result<Vec<Staged>> {
    let mut staged = Vec::new();
    let Some(staging) = staging else { return Ok(staged) };
    let (mut offset, mut since_barrier) = (0, 0);
    for (number, update) in updates.iter().enumerate() {
        let behind_barrier = updates[since_barrier..number].iter().any(|earlier| earlier.overlaps(update));
        if behind_barrier {
            since_barrier = number;
        }
        let buffers = &update.scene.buffers;
        let mut copies = Vec::new();
        for piece in pieces(update, &buffers.plan) {
            let bytes = piece.words.len() as u64 * 16;
            staging.write(offset, bytemuck::cast_slice(&piece.words))?;
            let to = buffers.chunks[piece.chunk].range(piece.offset, bytes);
            copies.push((staging.range(offset, bytes), to));
            offset += bytes;
        }
        staged.push(Staged { behind_barrier, copies });
    }
    Ok(staged)
}

pub(super) fn record_copies(r: &mut Recorder, staged: &[Staged]) {
    if staged.iter().all(|update| update.copies.is_empty()) {
        return;
    }
    r.scope("scene updates", |r| {
        for update in staged {
            if update.behind_barrier {
                r.barrier();
            }
            for (from, to) in &update.copies {
                r.copy(from, to);
            }
        }
        r.barrier();
    });
}

/// A run of vec4s of one chunk.
struct Piece {
    chunk: usize,
    /// Bytes from the chunk's start.
    offset: u64,
    words: Vec<[f32; 4]>,
}

/// Splits an update into pieces that are contiguous on the device.
fn pieces(update: &Update<'_>, plan: &ScenePlan) -> Vec<Piece> {
    let (first, end) = (update.first, update.first + update.gaussians.len() as u32);
    let mut pieces = Vec::new();
    for range in plan.ranges(end) {
        let (begin, stop) = (first.max(range.first), range.first + range.count);
        if begin >= stop {
            continue;
        }
        let own = (begin - first) as usize..(stop - first) as usize;
        // Packed as a chunk that consists of the touched rows only.
        let (begin, stop) = (begin - range.first, stop - range.first);
        let rows = begin / PLANE_ROW..stop.div_ceil(PLANE_ROW);
        let skipped = rows.start * PLANE_ROW;
        let packed_plan = ScenePlan { chunk_gaussians: (rows.end - rows.start) * PLANE_ROW, ..*plan };
        let packed = planes::pack(update.gaussians, own, &packed_plan, (begin - skipped) as usize);
        for (at, run) in runs(plan, &packed_plan, rows, (begin, stop)) {
            let words = packed[run].to_vec();
            pieces.push(Piece { chunk: range.chunk, offset: 16 * at as u64, words });
        }
    }
    pieces
}

/// Ranges of Gaussians `begin` to `stop` in a chunk, and in a chunk that consists of their rows only.
fn runs(
    plan: &ScenePlan,
    packed: &ScenePlan,
    rows: Range<u32>,
    (begin, stop): (u32, u32),
) -> Vec<(usize, Range<usize>)> {
    let mut runs: Vec<(usize, Range<usize>)> = Vec::new();
    let mut next = 0;
    while next < plan.planes {
        let planes = plane_group(next);
        next = planes.end;
        for row in rows.clone() {
            let from = begin.max(row * PLANE_ROW);
            let count = (stop.min((row + 1) * PLANE_ROW) - from) as usize;
            for plane in planes.clone() {
                let at = plan.place(plane, from as usize);
                let own = packed.place(plane, (from - rows.start * PLANE_ROW) as usize);
                match runs.last_mut() {
                    Some((begun, run)) if *begun + run.len() == at && run.end == own => run.end += count,
                    _ => runs.push((at, own..own + count)),
                }
            }
        }
    }
    runs
}
