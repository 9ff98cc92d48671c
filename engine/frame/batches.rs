//! Batches of scenes: one dispatch culls and one projects all scenes of a batch.
//!
//! A frame of thousands of small scenes would spend its time on the host, in dispatches. Scenes with parameters in one VkBuffer
//! can share a dispatch. A workgroup is a culling block of one scene, and finds that scene in the table of camera blocks
//! (glsl/include/batch.glsl). It skips blocks of other scenes that lie between those of a batch.

use super::ShStorage;
use super::inputs::PlacedScene;
use crate::kernels::constants::NO_BATCH;

/// Minimum number of scenes in a batch, and in a frame with batches.
pub(crate) const MIN_SCENES: u32 = 8;
/// Maximum number of culling blocks of a scene in a batch. A batch projects whole culling blocks, even if few of their
/// Gaussians are visible. Outside a batch, a scene's visible Gaussians fill workgroups.
const MAX_BLOCKS: u32 = 16;
/// Maximum number of other scenes' culling blocks between two scenes of a batch.
const MAX_BETWEEN: u32 = 32;
/// Number of batches that accept scenes at the same time.
const OPEN: usize = 8;

/// Scenes of a frame that share a dispatch.
#[derive(Clone, Copy, Debug)]
pub struct Batch {
    /// Index of the first scene.
    pub(crate) first: u32,
    /// Number of scenes.
    pub(crate) scenes: u32,
    /// First Gaussian in the frame.
    begin: u32,
    /// One past the last Gaussian in the frame.
    end: u32,
}

impl Batch {
    /// First culling block and one past the last, of `block` Gaussians each.
    pub(crate) fn blocks(&self, block: u32) -> [u32; 2] {
        [self.begin / block, self.end.div_ceil(block)]
    }

    /// True if few enough culling blocks separate the batch from a later scene that begins at this Gaussian.
    fn is_near(&self, block: u32, begin: u32) -> bool {
        begin - self.end.next_multiple_of(block) <= MAX_BETWEEN * block
    }
}

/// Batches of a frame.
#[derive(Clone, Copy, Debug, Default)]
pub struct FrameBatches<'a> {
    pub(crate) list: &'a [Batch],
    /// True if they draw everything, so that recording need not scan thousands of scenes.
    pub(crate) draw_all: bool,
}

/// Properties that the scenes of a batch share: VkBuffer of the parameters, SH degree, [kinds](super::SceneSettings::kinds).
#[derive(Clone, Copy, PartialEq)]
struct BatchKey {
    memory: u64,
    sh_degree: u32,
    kinds: [bool; 3],
}

/// A batch that accepts scenes.
#[derive(Clone, Copy)]
struct OpenBatch {
    shared: BatchKey,
    /// Index in the list of batches.
    batch: usize,
    /// True if the buffer of the first scene has no space for others.
    is_full: bool,
}

/// Assigns the scenes of a frame to batches, and adds these to `batches`. Blocks have `block` Gaussians. Returns true if the batches draw
/// everything.
pub(crate) fn form_batches(block: u32, scenes: &mut [PlacedScene<'_>], batches: &mut Vec<Batch>) -> bool {
    if scenes.len() < MIN_SCENES as usize {
        return false;
    }
    let own = batches.len();
    let drawn = assign(block, scenes, batches);
    for small in batches[own..].iter().filter(|batch| batch.scenes < MIN_SCENES) {
        let of_batch = scenes[small.first as usize..].iter_mut().filter(|placed| placed.batch == small.first);
        of_batch.take(small.scenes as usize).for_each(|placed| placed.batch = NO_BATCH);
    }
    batches.retain(|batch| batch.scenes >= MIN_SCENES);
    batches[own..].iter().map(|batch| batch.scenes).sum::<u32>() == drawn
}

/// Assigns scenes to batches of any size and returns the number of drawn scenes.
fn assign(block: u32, scenes: &mut [PlacedScene<'_>], batches: &mut Vec<Batch>) -> u32 {
    let (mut open, mut drawn) = ([None::<OpenBatch>; OPEN], 0);
    for (index, placed) in (0..).zip(scenes) {
        let (begin, count) = (placed.first, placed.drawn_gaussians());
        drawn += u32::from(count > 0);
        let Some(shared) = shared(block, placed) else { continue };
        let known = open.iter().position(|open| open.is_some_and(|open| open.shared == shared));
        let joined = known.and_then(|at| open[at]).map(|open| open.batch);
        let batch = joined.filter(|&batch| batches[batch].is_near(block, begin)).unwrap_or_else(|| {
            // Replaces a batch that no scene can join any more, or that few scenes will join.
            let worth = |open: &OpenBatch| match batches[open.batch] {
                batch if !batch.is_near(block, begin) => 0,
                Batch { scenes: 1, .. } if open.is_full => 1,
                Batch { scenes, .. } => 1 + scenes,
            };
            let cheapest = || (0..OPEN).min_by_key(|&at| open[at].as_ref().map_or(0, worth)).unwrap_or(0);
            let at = known.unwrap_or_else(cheapest);
            open[at] = Some(OpenBatch { shared, batch: batches.len(), is_full: placed.parameters.is_full });
            batches.push(Batch { first: index, scenes: 0, begin, end: begin });
            batches.len() - 1
        });
        let batch = &mut batches[batch];
        placed.batch = batch.first;
        (batch.scenes, batch.end) = (batch.scenes + 1, begin + count);
    }
    drawn
}

/// Returns what a scene shares with the others of its batch; None if it cannot be in one.
fn shared(block: u32, placed: &PlacedScene<'_>) -> Option<BatchKey> {
    let (drawn, memory) = (placed.drawn_gaussians(), placed.parameters.memory);
    let fits = drawn > 0
        && drawn <= MAX_BLOCKS * block
        && memory != 0
        && placed.settings.mask().is_none()
        && placed.scene.plan.sh_storage == ShStorage::F32;
    fits.then(|| BatchKey { memory, sh_degree: placed.sh_degree, kinds: placed.settings.kinds() })
}
