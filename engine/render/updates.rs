//! New parameters for scenes, copied before a recorded frame.

use super::device_scene::DeviceScene;
use crate::error::Result;
use crate::frame::{ScenePlan, planes};
use crate::kernels::constants::PLANE_ROW;
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
    /// True if both replace some of the same Gaussians. Clones of a scene share its buffers.
    fn overlaps(&self, other: &Self) -> bool {
        let range = |u: &Self| (u64::from(u.first), u64::from(u.first) + u.gaussians.len() as u64);
        let ((first, end), (other_first, other_end)) = (range(self), range(other));
        first < other_end && other_first < end && {
            let (own, theirs) = (&self.scene.buffers.chunks, &other.scene.buffers.chunks);
            own.iter().any(|chunk| theirs.iter().any(|their| their.handle() == chunk.handle()))
        }
    }
}

/// Copies of a frame's updates. The next frame reuses its memory.
#[derive(Default)]
pub(super) struct StagedUpdates {
    words: Vec<[f32; 4]>,
    copies: Vec<StagedCopy>,
}

/// A copy from staging memory to a scene.
struct StagedCopy {
    /// True if it needs a barrier: an update since the last barrier writes some of the same Gaussians.
    behind_barrier: bool,
    from: Buffer,
    to: Buffer,
}

impl StagedUpdates {
    /// Writes new parameters into the slot's staging memory, which must not be in use, and lists the copies from it.
    pub fn stage(&mut self, staging: Option<&Buffer>, updates: &[Update<'_>]) -> Result<()> {
        self.copies.clear();
        let Some(staging) = staging else { return Ok(()) };
        let (mut offset, mut since_barrier) = (0, 0);
        for (number, update) in updates.iter().enumerate() {
            let mut behind_barrier =
                updates[since_barrier..number].iter().any(|earlier| earlier.overlaps(update));
            if behind_barrier {
                since_barrier = number;
            }
            let (buffers, copies) = (&update.scene.buffers, &mut self.copies);
            each_piece(update, &buffers.plan, &mut self.words, |chunk, at, words| {
                let bytes = words.len() as u64 * 16;
                staging.write(offset, bytemuck::cast_slice(words))?;
                let (from, to) = (staging.range(offset, bytes), buffers.chunks[chunk].range(at, bytes));
                copies.push(StagedCopy { behind_barrier, from, to });
                behind_barrier = false;
                offset += bytes;
                Ok(())
            })?;
        }
        Ok(())
    }

    /// Records the copies, and drops the buffers.
    pub fn record(&mut self, r: &mut Recorder) {
        if self.copies.is_empty() {
            return;
        }
        r.scope("scene updates", |r| {
            for StagedCopy { behind_barrier, from, to } in self.copies.drain(..) {
                if behind_barrier {
                    r.barrier();
                }
                r.copy(&from, &to);
            }
            r.barrier();
        });
    }
}

/// Splits an update into pieces that are contiguous on the device: chunk, bytes from its start, vec4s.
fn each_piece(
    update: &Update<'_>,
    plan: &ScenePlan,
    words: &mut Vec<[f32; 4]>,
    mut piece: impl FnMut(usize, u64, &[[f32; 4]]) -> Result<()>,
) -> Result<()> {
    let (first, end) = (update.first, update.first + update.gaussians.len() as u32);
    for range in plan.ranges(end) {
        let (begin, stop) = (first.max(range.first), range.first + range.count);
        if begin >= stop {
            continue;
        }
        let of_update = (begin - first) as usize..(stop - first) as usize;
        // Staging holds only the touched rows, laid out as a chunk of their own.
        let of_chunk = begin - range.first..stop - range.first;
        let rows = of_chunk.start / PLANE_ROW..of_chunk.end.div_ceil(PLANE_ROW);
        let packed = ScenePlan { chunk_gaussians: rows.len() as u32 * PLANE_ROW, ..*plan };
        let at = (of_chunk.start % PLANE_ROW) as usize;
        planes::pack_into(words, update.gaussians, of_update, &packed, at);
        each_run(plan, &packed, rows, of_chunk, |at, run| piece(range.chunk, 16 * at as u64, &words[run]))?;
    }
    Ok(())
}

/// Calls `run` for each contiguous run of texels in the planes of some Gaussians, with its index in their chunk, and its range in a
/// chunk that holds only their rows.
fn each_run(
    plan: &ScenePlan,
    packed: &ScenePlan,
    rows: Range<u32>,
    gaussians: Range<u32>,
    mut run: impl FnMut(usize, Range<usize>) -> Result<()>,
) -> Result<()> {
    let mut last: Option<(usize, Range<usize>)> = None;
    let groups = std::iter::successors(Some(plan.group(0)), |group| {
        (group.end < plan.planes).then(|| plan.group(group.end))
    });
    for (planes, row) in groups.flat_map(|planes| rows.clone().map(move |row| (planes.clone(), row))) {
        let from = gaussians.start.max(row * PLANE_ROW);
        let count = (gaussians.end.min((row + 1) * PLANE_ROW) - from) as usize;
        for plane in planes {
            let at = plan.place(plane, from as usize);
            let own = packed.place(plane, (from - rows.start * PLANE_ROW) as usize);
            match &mut last {
                Some((begun, run)) if *begun + run.len() == at && run.end == own => run.end += count,
                _ => {
                    if let Some((begun, whole)) = last.replace((at, own..own + count)) {
                        run(begun, whole)?;
                    }
                }
            }
        }
    }
    last.map_or(Ok(()), |(begun, whole)| run(begun, whole))
}
