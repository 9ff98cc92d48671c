//! Batches of scenes: one dispatch culls and one projects all scenes of a batch.
//!
//! A frame of thousands of small scenes would spend its time on the host, in dispatches. Scenes with parameters in one VkBuffer
//! can share a dispatch. A workgroup is a culling block of one scene, and finds that scene in the table of camera blocks
//! (glsl/include/batch.glsl). It skips blocks of other scenes that lie between those of a batch.

use super::inputs::{Batch, Parameters, PlacedScene};
use crate::kernels::constants::NO_BATCH;

/// Minimum number of scenes in a batch, and in a frame with batches.
pub(crate) const LEAST_SCENES: u32 = 8;
/// Maximum number of culling blocks of a scene in a batch. A batch projects whole culling blocks, even if few of their
/// Gaussians are visible. Outside a batch, a scene's visible Gaussians fill workgroups.
const MOST_BLOCKS: u32 = 16;
/// Maximum number of other scenes' culling blocks between two scenes of a batch.
const MOST_BETWEEN: u32 = 32;
/// Number of batches that accept scenes at the same time.
const OPEN: usize = 8;

/// Properties that the scenes of a batch share.
#[derive(Clone, Copy)]
struct Open {
    parameters: Parameters,
    sh_degree: u32,
    kinds: [bool; 3],
    first: u32,
}

impl Open {
    fn takes(&self, other: &Self) -> bool {
        self.parameters.memory == other.parameters.memory
            && self.sh_degree == other.sh_degree
            && self.kinds == other.kinds
    }
}

/// Makes a batch the first one of the frame.
fn prepend(scenes: &mut [PlacedScene<'_>], batch: u32) {
    scenes[batch as usize].batch.next = scenes[0].batch.frame.head;
    scenes[0].batch.frame.head = batch;
}

/// Dissolves batches with few scenes. Returns the number of scenes in the remaining batches.
fn keep_large(scenes: &mut [PlacedScene<'_>]) -> u32 {
    let (mut batched, mut ended) = (0, false);
    let mut place = std::mem::replace(&mut scenes[0].batch.frame.head, NO_BATCH);
    while let Some(Batch { scenes: count, next, .. }) = scenes.get(place as usize).map(|first| first.batch) {
        if count < LEAST_SCENES {
            ended = true;
        } else {
            batched += count;
            prepend(scenes, place);
        }
        place = next;
    }
    for own in 0..if ended { scenes.len() } else { 0 } {
        let first = scenes.get(scenes[own].batch.first as usize);
        if first.is_some_and(|first| first.batch.scenes < LEAST_SCENES) {
            scenes[own].batch.first = NO_BATCH;
        }
    }
    batched
}

/// Assigns the scenes of a frame to batches and returns the number of scenes in batches. Blocks have `block` Gaussians.
pub(crate) fn form_batches(block: u32, scenes: &mut [PlacedScene<'_>]) -> u32 {
    if scenes.len() < LEAST_SCENES as usize {
        return 0;
    }
    let drawn = assign(block, scenes);
    let batched = keep_large(scenes);
    scenes[0].batch.frame.all = batched == drawn;
    batched
}

/// Assigns scenes to batches of any size and returns the number of drawn scenes.
fn assign(block: u32, scenes: &mut [PlacedScene<'_>]) -> u32 {
    let (mut open, mut drawn) = ([None::<Open>; OPEN], 0);
    for place in 0..scenes.len() {
        let (begin, own_count) = (scenes[place].first, scenes[place].drawn());
        drawn += u32::from(own_count > 0);
        let Some(own) = batched(block, &scenes[place], place as u32) else { continue };
        let known = open.iter().position(|batch| batch.is_some_and(|batch| batch.takes(&own)));
        let is_near = |first: u32| {
            let Batch { end, .. } = scenes[first as usize].batch;
            begin - end.next_multiple_of(block) <= MOST_BETWEEN * block
        };
        let first = match known.and_then(|at| open[at]).map(|batch| batch.first) {
            Some(first) if is_near(first) => first,
            _ => {
                // Replaces a batch that no scene can join any more, or that few scenes will join.
                let worth = |batch: &Open| match scenes[batch.first as usize].batch.scenes {
                    _ if !is_near(batch.first) => 0,
                    1 if batch.parameters.alone => 1,
                    scenes => 1 + scenes,
                };
                let least = || (0..OPEN).min_by_key(|&at| open[at].as_ref().map_or(0, worth)).unwrap_or(0);
                open[known.unwrap_or_else(least)] = Some(own);
                prepend(scenes, place as u32);
                place as u32
            }
        };
        scenes[place].batch.first = first;
        let batch = &mut scenes[first as usize].batch;
        (batch.scenes, batch.end) = (batch.scenes + 1, begin + own_count);
    }
    drawn
}

/// Returns the properties that a scene needs of its batch; None if it cannot be in one.
fn batched(block: u32, placed: &PlacedScene<'_>, first: u32) -> Option<Open> {
    let drawn = placed.drawn();
    let (parameters, kinds) = (placed.batch.parameters, placed.settings.kinds());
    let fits = drawn > 0
        && drawn <= MOST_BLOCKS * block
        && parameters.memory != 0
        && placed.settings.mask().is_none()
        && !placed.scene.plan.half_sh;
    fits.then_some(Open { parameters, sh_degree: placed.sh_degree, kinds, first })
}
