//! Batches of scenes: one dispatch culls and one projects all scenes of a batch.
//!
//! A frame of thousands of small scenes would spend its time on the host, in dispatches. Scenes with parameters in one VkBuffer
//! can share a dispatch. A workgroup is a culling block of one scene, and finds that scene in the table of camera blocks
//! (glsl/include/batch.glsl). It skips blocks of other scenes that lie between those of a batch.

use super::inputs::{Batch, Parameters, PlacedScene};
use super::{BlendVariant, Forward, FrameInputs, camera_block};
use crate::error::Result;
use crate::kernels::constants as c;
use crate::kernels::forward::{cull_scenes, project_scenes};
use crate::vk::Recorder;

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
    let mut place = std::mem::replace(&mut scenes[0].batch.frame.head, c::NO_BATCH);
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
            scenes[own].batch.first = c::NO_BATCH;
        }
    }
    batched
}

impl Forward {
    /// Assigns the scenes of a frame to batches and returns the number of scenes in batches. [`Forward::prepare_batches`] must
    /// have built their kernels.
    pub(crate) fn form_batches(&self, scenes: &mut [PlacedScene<'_>]) -> u32 {
        if scenes.len() < LEAST_SCENES as usize {
            return 0;
        }
        let drawn = self.assign(scenes);
        let batched = keep_large(scenes);
        scenes[0].batch.frame.all = batched == drawn;
        batched
    }

    /// Assigns scenes to batches of any size and returns the number of drawn scenes.
    fn assign(&self, scenes: &mut [PlacedScene<'_>]) -> u32 {
        let block = self.sizes.elementwise_workgroup;
        let (mut open, mut drawn) = ([None::<Open>; OPEN], 0);
        for place in 0..scenes.len() {
            let (begin, own_count) = (scenes[place].first, scenes[place].drawn());
            drawn += u32::from(own_count > 0);
            let Some(own) = self.batched(&scenes[place], (place as u32, own_count)) else { continue };
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
                    let least =
                        || (0..OPEN).min_by_key(|&at| open[at].as_ref().map_or(0, worth)).unwrap_or(0);
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
    fn batched(&self, placed: &PlacedScene<'_>, (first, drawn): (u32, u32)) -> Option<Open> {
        let (parameters, kinds) = (placed.batch.parameters, placed.settings.kinds());
        let fits = drawn > 0
            && drawn <= MOST_BLOCKS * self.sizes.elementwise_workgroup
            && parameters.memory != 0
            && placed.settings.mask().is_none();
        fits.then_some(Open { parameters, sh_degree: placed.sh_degree, kinds, first })
    }

    /// Builds the missing kernels of batches for an SH degree and a variant. Does nothing if no batch has the variant.
    ///
    /// # Errors
    /// When the device refuses a pipeline.
    pub(crate) fn prepare_batches(&mut self, sh_degree: u32, variant: BlendVariant) -> Result<()> {
        if !variant.may_be_batched() {
            return Ok(());
        }
        self.cull_scenes.prepare(&self.context, self.cull_scenes_spec(variant))?;
        self.project_scenes.prepare(&self.context, variant.project_scenes_spec(&self.sizes, sh_degree))
    }

    fn cull_scenes_spec(&self, variant: BlendVariant) -> cull_scenes::Spec {
        variant.cull_scenes_spec(&self.sizes, self.context.limits().subgroup_size)
    }

    /// Records culling of the batch with this first scene.
    pub(super) fn record_batch_flags(
        &self,
        r: &mut Recorder,
        (inputs, place): (&FrameInputs, u32),
        first: &PlacedScene<'_>,
        variant: BlendVariant,
    ) {
        let Some(kernel) = self.cull_scenes.get(r, &self.cull_scenes_spec(variant)) else { return };
        let ([extent, antialias], f) = (inputs.settings.modes(), inputs.frame);
        let [first_block, end_block] = first.batch_blocks(self.sizes.elementwise_workgroup);
        let parameters = first.scene.chunks[0].whole();
        let push = cull_scenes::Push {
            first_block,
            end_block,
            scenes: inputs.scenes.len() as u32,
            batch: place,
            index_count: inputs.index_count(),
            extent,
            antialias,
        };
        let bind = cull_scenes::Bind {
            parameters: &parameters,
            visible_flags: &f.visible_flags,
            block_counts: f.visible_counts(),
            // Same as for a single scene.
            cut_outs: inputs.cut_outs.unwrap_or(&parameters),
            scene_blocks: &camera_block::blocks_of(inputs),
        };
        r.dispatch(kernel, &bind, &push, (end_block - first_block).into());
    }

    /// Records the screen-space attributes of the batch with this first scene.
    pub(super) fn record_batch_project(
        &self,
        r: &mut Recorder,
        (inputs, place): (&FrameInputs, u32),
        first: &PlacedScene<'_>,
        variant: BlendVariant,
    ) {
        let spec = variant.project_scenes_spec(&self.sizes, first.sh_degree);
        let Some(kernel) = self.project_scenes.get(r, &spec) else { return };
        let ([extent, antialias], f) = (inputs.settings.modes(), inputs.frame);
        let [first_block, end_block] = first.batch_blocks(self.sizes.elementwise_workgroup);
        let splats = f.splats();
        let push = project_scenes::Push {
            first_block,
            end_block,
            scenes: inputs.scenes.len() as u32,
            batch: place,
            blocks: inputs.index_count().div_ceil(self.sizes.elementwise_workgroup),
            extent,
            antialias,
            splat_stride: splats.stride,
        };
        let bind = project_scenes::Bind {
            parameters: &first.scene.chunks[0].whole(),
            block_offsets: f.visible_offsets(),
            visible_list: &f.visible_list,
            mean2d_extent: splats.mean2d_extent,
            conic_opacity: splats.conic_opacity,
            color_inverse_depth: splats.color_inverse_depth,
            depth_keys: f.depth_keys(),
            footprints: splats.footprints,
            tile_lists: f.tile_lists(),
            state: &f.state,
            scene_blocks: &camera_block::blocks_of(inputs),
        };
        r.dispatch(kernel, &bind, &push, (end_block - first_block).into());
    }
}
