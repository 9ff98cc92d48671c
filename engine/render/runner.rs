//! Runs a frame until its capacities suffice.

use super::forward::Forward;
use super::frame_store::{FrameCounts, FrameMemory, FrameStore};
use crate::error::{Error, Result};
use crate::frame::tuning::ELEMENTWISE_WORKGROUP;
use crate::frame::{
    FrameCapacity, FrameInputs, FrameVariant, PlacedScene, RenderSettings, SceneBuffers, ScenePlan,
    SceneSettings, gaussians_with, next_scene_begin,
};
use crate::scene::Camera;
use crate::vk::{Buffer, Context, Recorder, RunReport};

/// The forward pass with its own frame buffers.
pub(crate) struct FrameRunner {
    pub(super) context: Context,
    pub(crate) forward: Forward,
    pub(crate) store: FrameStore,
}

/// A frame for [`FrameRunner::run`] and [`FrameRunner::record`].
#[derive(Clone, Copy)]
pub(crate) struct Request<'a> {
    pub scene: &'a SceneBuffers,
    /// Drawn together with the scene, in the same axes, with the same SH degree. Frames with a pose on the device have none.
    pub other_scenes: &'a [SceneBuffers],
    pub camera: &'a Camera,
    /// See [`FrameInputs::pose`].
    pub pose: Option<&'a Buffer>,
    pub settings: &'a RenderSettings,
    /// Settings of the scene and the others.
    pub of_scenes: &'a SceneSettings<'a>,
    /// Evaluated SH degree.
    pub sh_degree: u32,
    /// True if the frame has the buffers of the backward pass.
    pub backward: bool,
    /// See [`FrameInputs::last_entries`].
    pub last_entries: bool,
    /// See [`FrameInputs::hidden_by`].
    pub hidden_by: Option<&'a Buffer>,
}

impl<'a> Request<'a> {
    /// A frame of one scene, with the SH degree of the settings.
    pub fn new(
        scene: &'a SceneBuffers,
        camera: &'a Camera,
        settings: &'a RenderSettings,
        backward: bool,
    ) -> Self {
        let (sh_degree, last_entries) = (scene.active_degree(settings), false);
        let (pose, hidden_by) = (None, None);
        Self {
            scene,
            other_scenes: &[],
            camera,
            pose,
            settings,
            of_scenes: &SceneSettings::USUAL,
            sh_degree,
            backward,
            last_entries,
            hidden_by,
        }
    }

    /// The scene and the others, one behind the other in the frame's index space.
    fn scenes(&self) -> Vec<PlacedScene<'a>> {
        let alone = PlacedScene::alone(self.scene, self.camera, self.sh_degree);
        let alone = PlacedScene { settings: self.of_scenes, ..alone };
        let mut end = self.scene.count;
        let placed = self.other_scenes.iter().map(|scene| {
            let first = next_scene_begin(end, ELEMENTWISE_WORKGROUP);
            end = first.saturating_add(scene.count);
            PlacedScene { scene, first, ..alone }
        });
        std::iter::once(alone).chain(placed).collect()
    }

    fn inputs(
        &self,
        memory: &'a FrameMemory,
        capacity: &'a FrameCapacity,
        scenes: &'a [PlacedScene<'a>],
    ) -> FrameInputs<'a> {
        let inputs = FrameInputs::new(scenes, &memory.buffers, capacity, self.settings);
        let Self { pose, backward, last_entries, hidden_by, .. } = *self;
        let loss_scratch = &memory.loss_scratch;
        FrameInputs { pose, backward, last_entries, hidden_by, loss_scratch, ..inputs }
    }
}

/// Result of [`FrameRunner::run`].
pub(crate) struct FrameRun {
    pub counts: FrameCounts,
    pub report: RunReport,
    /// Number of times the frame was run again because a capacity had to grow.
    pub retries: u32,
}

/// Error of [`FrameRunner::run`].
pub(crate) enum RunError {
    /// The frame exceeds the available memory.
    OutOfMemory {
        counts: Box<FrameCounts>,
        error: Error,
    },
    Other(Error),
}

impl From<Error> for RunError {
    fn from(error: Error) -> Self {
        Self::Other(error)
    }
}

impl RunError {
    pub fn error(self) -> Error {
        match self {
            Self::OutOfMemory { error, .. } | Self::Other(error) => error,
        }
    }
}

impl FrameRunner {
    /// Builds the kernels that every frame needs; allocates no frame.
    pub fn new(context: &Context) -> Result<Self> {
        let (forward, store) = (Forward::new(context)?, FrameStore::new(context)?);
        Ok(Self { context: context.clone(), forward, store })
    }

    /// Runs a frame. `record_more` records the work after the blending. A frame that overflows is run again with a larger
    /// capacity, so that work must not change persistent state if `STATE_OVERFLOW` is set.
    pub fn run(
        &mut self,
        request: &Request,
        mut record_more: impl FnMut(&mut Recorder, &FrameInputs),
    ) -> Result<FrameRun, RunError> {
        let Request { scene, other_scenes, camera, settings, sh_degree, backward, .. } = *request;
        camera.check()?;
        if backward {
            camera.check_differentiable()?;
            if settings.surface.is_some() {
                return Err(Error::argument("settings.surface", "has no gradients").into());
            }
        }
        settings.check()?;
        let gaussians = gaussians_with(scene.plan.capacity, frozen_capacity(other_scenes));
        let Self { context, forward, store } = self;
        let variant = FrameVariant::of(settings, camera, backward);
        let variant = FrameVariant { last_entries: request.last_entries, ..variant };
        for scene in std::iter::once(scene).chain(other_scenes) {
            forward.prepare(sh_degree, variant.of_scene(scene.plan.sh_storage, request.of_scenes))?;
        }
        let scenes = request.scenes();
        let mut retries = 0;
        loop {
            let (memory, capacity) = store.ensure(gaussians, scenes.len() as u32, camera, variant)?;
            let inputs = request.inputs(&memory, &capacity, &scenes);
            let report = context.run("frame", |r| {
                forward.record(r, &inputs);
                record_more(r, &inputs);
                store.record_readback(r, &memory.buffers);
            })?;
            let counts = store.counts()?;
            // Growing frees its buffers before it allocates larger ones.
            drop(memory);
            let grown = store.grow(&counts);
            if !grown.map_err(|error| RunError::OutOfMemory { counts: Box::new(counts), error })? {
                return Ok(FrameRun { counts, report, retries });
            }
            retries += 1;
        }
    }

    /// Prepares for [`FrameRunner::record`]: allocates buffers with backward for a scene of this plan, its frozen
    /// neighbours, the first camera and the expected pictures. Also builds the kernels of these settings and cameras up to an
    /// SH degree.
    pub fn reserve(
        &mut self,
        plan: &ScenePlan,
        frozen: &[SceneBuffers],
        cameras: &[Camera],
        sh_degree: u32,
        settings: &RenderSettings,
    ) -> Result<()> {
        for variant in FrameVariant::of_cameras(settings, cameras, true) {
            let variant = FrameVariant { sh_storage: plan.sh_storage, ..variant };
            (0..=sh_degree).try_for_each(|degree| self.forward.prepare(degree, variant))?;
        }
        let gaussians = gaussians_with(plan.capacity, frozen_capacity(frozen));
        let variant = FrameVariant::of(settings, &cameras[0], true);
        self.store.ensure(gaussians, 1 + frozen.len() as u32, &cameras[0], variant).map(drop)
    }

    /// Only records a frame, into the existing buffers, prepared by [`FrameRunner::reserve`]. Keeps the overflow flag of an
    /// earlier frame.
    pub fn record(
        &self,
        r: &mut Recorder,
        request: &Request,
        record_more: impl FnOnce(&mut Recorder, &FrameInputs),
    ) -> Result<()> {
        let (memory, capacity) = (self.store.memory()?, self.store.capacity());
        let scenes = request.scenes();
        let inputs = FrameInputs { keeps_overflow: true, ..request.inputs(memory, &capacity, &scenes) };
        self.forward.record(r, &inputs);
        record_more(r, &inputs);
        Ok(())
    }
}

/// Returns the capacity needed behind a scene: for its frozen neighbours, and the gaps between them.
pub(crate) fn frozen_capacity(frozen: &[SceneBuffers]) -> u32 {
    frozen.iter().rev().fold(0, |behind, scene| gaussians_with(scene.count, behind))
}
