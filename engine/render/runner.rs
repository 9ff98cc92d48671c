//! Runs a frame until its capacities suffice, and reads it back.

use super::forward::Forward;
use super::frame::{Frame, FrameStats};
use super::frame_store::{FrameStore, State};
use crate::error::{Error, Result};
use crate::frame::{
    FrameBuffers, FrameCapacity, FrameInputs, FrameVariant, PlacedScene, RenderSettings, SceneBuffers,
    first_frozen, gaussians_with,
};
use crate::scene::Camera;
use crate::vk::{Buffer, Context, Recorder, RunReport};
use std::borrow::Cow;

/// The forward pass with its own frame buffers.
pub(crate) struct FrameRunner {
    pub(super) context: Context,
    pub(crate) forward: Forward,
    pub(crate) store: FrameStore,
    /// Frozen neighbours: drawn together with every scene, in the same axes, with the same SH degree. Frames with a pose on
    /// the device ([`Request::pose`]) cannot have them.
    pub(crate) frozen: Vec<SceneBuffers>,
}

/// Inputs of a run.
#[derive(Clone, Copy)]
pub(crate) struct Request<'a> {
    pub scene: &'a SceneBuffers,
    pub camera: &'a Camera,
    /// See [`FrameInputs::pose`].
    pub pose: Option<&'a Buffer>,
    pub settings: &'a RenderSettings,
    /// Evaluated SH degree.
    pub sh_degree: u32,
    /// True if the frame has the buffers of the backward pass.
    pub backward: bool,
}

impl<'a> Request<'a> {
    fn placed(&self) -> PlacedScene<'a> {
        PlacedScene::alone(self.scene, self.camera, self.sh_degree)
    }

    /// The scene and its frozen neighbours, one behind the other in the frame's index space. Without neighbours it is
    /// `alone`, and nothing is allocated.
    fn scenes(&self, alone: &'a PlacedScene<'a>, frozen: &'a [SceneBuffers]) -> Cow<'a, [PlacedScene<'a>]> {
        if frozen.is_empty() {
            return Cow::Borrowed(std::slice::from_ref(alone));
        }
        let mut end = self.scene.count;
        let placed = frozen.iter().map(|scene| {
            let first = first_frozen(end);
            end = first.saturating_add(scene.count);
            PlacedScene { scene, first, ..*alone }
        });
        Cow::Owned(std::iter::once(*alone).chain(placed).collect())
    }

    fn inputs(
        &self,
        frame: &'a FrameBuffers,
        capacity: &'a FrameCapacity,
        scenes: &'a [PlacedScene<'a>],
    ) -> FrameInputs<'a> {
        let inputs = FrameInputs::new(scenes, frame, capacity, self.settings);
        FrameInputs { pose: self.pose, backward: self.backward, ..inputs }
    }
}

/// Result of a run.
pub(crate) struct FrameRun {
    pub state: State,
    pub report: RunReport,
    /// Number of times the frame was run again because a capacity had to grow.
    pub retries: u32,
}

/// Reason why a run failed.
pub(crate) enum Failed {
    /// The frame exceeds the available memory: its counts, and the error.
    TooLittleRoom(Box<(State, Error)>),
    Other(Error),
}

impl From<Error> for Failed {
    fn from(error: Error) -> Self {
        Self::Other(error)
    }
}

impl Failed {
    pub fn error(self) -> Error {
        match self {
            Self::TooLittleRoom(why) => why.1,
            Self::Other(error) => error,
        }
    }
}

impl FrameRunner {
    pub fn new(context: &Context) -> Result<Self> {
        let (forward, store) = (Forward::new(context)?, FrameStore::new(context)?);
        Ok(Self { context: context.clone(), forward, store, frozen: Vec::new() })
    }

    /// Returns the capacity needed behind every scene: for the frozen neighbours, and the gaps between scenes.
    pub fn frozen_capacity(&self) -> u32 {
        let join = |behind: u32, scene: &SceneBuffers| gaussians_with(scene.count, behind);
        self.frozen.iter().rev().fold(0, join)
    }

    fn scenes(&self) -> u32 {
        1 + self.frozen.len() as u32
    }

    /// Returns the Gaussians of a frame with a scene of this capacity.
    pub fn gaussians_with(&self, capacity: u32) -> u32 {
        gaussians_with(capacity, self.frozen_capacity())
    }

    /// Runs a frame. `record_more` records the work after the blending. A frame that overflows is run again with a larger
    /// capacity, so that work must not change persistent state if `STATE_OVERFLOW` is set.
    pub fn run(
        &mut self,
        request: &Request,
        mut record_more: impl FnMut(&mut Recorder, &FrameInputs) -> Result<()>,
    ) -> Result<FrameRun, Failed> {
        let Request { scene, camera, settings, sh_degree, backward, .. } = *request;
        camera.check()?;
        if backward {
            camera.check_differentiable()?;
        }
        settings.check()?;
        let (gaussians, count) = (self.gaussians_with(scene.plan.capacity), self.scenes());
        let Self { context, forward, store, frozen } = self;
        forward.prepare_variant(sh_degree, FrameVariant::of(settings, camera, backward))?;
        let alone = request.placed();
        let scenes = request.scenes(&alone, frozen);
        let mut retries = 0;
        loop {
            let (frame, capacity) = store.ensure(gaussians, count, camera, backward)?;
            let inputs = request.inputs(&frame, &capacity, &scenes);
            let report = context.run("frame", |r| {
                forward.record(r, &inputs);
                record_more(r, &inputs)?;
                store.record_readback(r, &frame);
                Ok(())
            })?;
            let state = store.state()?;
            // Growing frees its buffers before it allocates larger ones.
            drop(frame);
            let grown = store.grow(&state);
            if !grown.map_err(|error| Failed::TooLittleRoom(Box::new((state, error))))? {
                return Ok(FrameRun { state, report, retries });
            }
            retries += 1;
        }
    }

    /// Prepares for [`FrameRunner::record`]: allocates buffers with backward for a scene of this capacity, the first camera and
    /// the expected pictures. Also builds the kernels of these settings and cameras up to an SH degree.
    pub fn reserve(
        &mut self,
        gaussians: u32,
        cameras: &[Camera],
        sh_degree: u32,
        settings: &RenderSettings,
    ) -> Result<()> {
        for variant in FrameVariant::of_cameras(settings, cameras, true) {
            (0..=sh_degree).try_for_each(|degree| self.forward.prepare_variant(degree, variant))?;
        }
        self.store.ensure(self.gaussians_with(gaussians), self.scenes(), &cameras[0], true).map(drop)
    }

    /// Only records a frame, into the existing buffers, prepared by [`FrameRunner::reserve`]. Keeps the overflow flag of an
    /// earlier frame.
    pub fn record(
        &self,
        r: &mut Recorder,
        request: &Request,
        record_more: impl FnOnce(&mut Recorder, &FrameInputs),
    ) -> Result<()> {
        let (frame, capacity) = (self.store.current()?, self.store.capacity());
        let alone = request.placed();
        let scenes = request.scenes(&alone, &self.frozen);
        let inputs = FrameInputs { keeps_overflow: true, ..request.inputs(frame, &capacity, &scenes) };
        self.forward.record(r, &inputs);
        record_more(r, &inputs);
        Ok(())
    }

    /// Renders a scene into the frame's buffers.
    pub fn draw(
        &mut self,
        scene: &SceneBuffers,
        camera: &Camera,
        settings: &RenderSettings,
    ) -> Result<FrameStats> {
        let sh_degree = scene.active_degree(settings);
        let request = Request { scene, camera, pose: None, settings, sh_degree, backward: false };
        let FrameRun { state, report, retries } = self.run(&request, |_, _| Ok(())).map_err(Failed::error)?;
        let State { visible, instances, longest_tile, samples, .. } = state;
        let gaussians = scene.count + self.frozen.iter().map(|scene| scene.count).sum::<u32>();
        let scopes = report.scopes;
        Ok(FrameStats { gaussians, visible, instances, longest_tile, samples, scopes, retries })
    }

    /// Renders a scene and reads the image back.
    pub fn render(
        &mut self,
        scene: &SceneBuffers,
        camera: &Camera,
        settings: &RenderSettings,
    ) -> Result<Frame> {
        let stats = self.draw(scene, camera, settings)?;
        let pixels = u64::from(camera.width) * u64::from(camera.height);
        let frame = self.store.current()?;
        let [r, g, b] = settings.background;
        let mut color = Vec::with_capacity(pixels as usize);
        let mut transmittance = Vec::with_capacity(pixels as usize);
        self.context.download_chunks(&frame.accumulated.range(0, pixels * 16), |bytes| {
            let texels = bytes.chunks_exact(16).map(bytemuck::pod_read_unaligned::<[f32; 4]>);
            color.extend(texels.clone().map(|[x, y, z, t]| [x + t * r, y + t * g, z + t * b]));
            transmittance.extend(texels.map(|[.., t]| t));
        })?;
        let depth = || self.read(&frame.inverse_depth, 0, pixels * 4);
        let inverse_depth = settings.inverse_depth.then(depth).transpose()?;
        Ok(Frame { width: camera.width, height: camera.height, color, transmittance, inverse_depth, stats })
    }
}
