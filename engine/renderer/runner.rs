//! Runs a frame until its capacities suffice, and reads it back.

use super::frame_store::{FrameStore, State};
use super::{Frame, FrameStats};
use crate::error::{Error, Result};
use crate::forward::{
    Auxiliary, BlendVariant, Blending, Forward, FrameInputs, PlacedScene, RenderSettings, SceneBuffers,
};
use crate::plan::{FrameBuffers, FrameCapacity, PictureCapacity, first_around, gaussians_with};
use crate::scene::Camera;
use crate::vk::{Buffer, Context, Recorder, RunReport};
use std::borrow::Cow;

/// The forward pass with its own frame buffers.
pub(crate) struct FrameRunner {
    pub(super) context: Context,
    pub(super) forward: Forward,
    pub(super) store: FrameStore,
    /// Frozen neighbours: drawn together with every scene, in the same axes.
    around: Vec<SceneBuffers>,
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

    /// The scene and those around it, each behind the one before it in the frame's index space. Without any around it, it is
    /// `alone`, and nothing is allocated.
    fn scenes(&self, alone: &'a PlacedScene<'a>, around: &'a [SceneBuffers]) -> Cow<'a, [PlacedScene<'a>]> {
        if around.is_empty() {
            return Cow::Borrowed(std::slice::from_ref(alone));
        }
        let mut end = self.scene.count;
        let placed = around.iter().map(|scene| {
            let first = first_around(end);
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
        FrameInputs {
            scenes,
            frame,
            capacity,
            camera: self.camera,
            pose: self.pose,
            settings: self.settings,
            depth_limits: None,
            cut_outs: None,
            linear_depth: false,
            backward: self.backward,
            keeps_overflow: false,
            auxiliary: Auxiliary::default(),
            view: None,
        }
    }
}

/// Result of a run.
pub(crate) struct Ran {
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
        Ok(Self { context: context.clone(), forward, store, around: Vec::new() })
    }

    /// Draws these scenes, from now on, together with every scene, in the same axes. They have the SH degree of the scenes.
    /// Frames with a pose on the device ([`Request::pose`]) cannot have them. Returns the previous ones.
    pub fn surround(&mut self, around: Vec<SceneBuffers>) -> Vec<SceneBuffers> {
        std::mem::replace(&mut self.around, around)
    }

    /// Returns the capacity needed behind every scene: for the Gaussians drawn together with it, and the gaps between
    /// scenes.
    pub fn around(&self) -> u32 {
        let join = |behind: u32, scene: &SceneBuffers| gaussians_with(scene.count, behind);
        self.around.iter().rev().fold(0, join)
    }

    /// Returns the scenes that are drawn together with every scene.
    pub fn surroundings(&self) -> &[SceneBuffers] {
        &self.around
    }

    fn scenes(&self) -> u32 {
        1 + self.around.len() as u32
    }

    /// Returns the Gaussians of a frame with a scene of this capacity.
    pub fn gaussians_with(&self, capacity: u32) -> u32 {
        gaussians_with(capacity, self.around())
    }

    /// See [`Forward::blending`].
    pub fn blending(&self) -> Blending {
        self.forward.blending()
    }

    /// See [`Forward::set_blending`].
    pub fn set_blending(&mut self, blending: Blending) -> bool {
        self.forward.set_blending(blending)
    }

    /// Runs a frame. `record_more` records the work after the blending. A frame that overflows is run again with a larger
    /// capacity, so that work must not change persistent state if `STATE_OVERFLOW` is set.
    pub fn run(
        &mut self,
        request: &Request,
        mut record_more: impl FnMut(&mut Recorder, &FrameInputs) -> Result<()>,
    ) -> Result<Ran, Failed> {
        let Request { scene, camera, settings, sh_degree, backward, .. } = *request;
        camera.check()?;
        if backward {
            camera.check_perspective("gradients are of pinholes alone")?;
        }
        settings.check()?;
        let gaussians = [self.gaussians_with(scene.plan.capacity), self.scenes()];
        let Self { context, forward, store, around } = self;
        forward.prepare_variant(sh_degree, BlendVariant::of(settings, backward).of_camera(camera))?;
        let alone = request.placed();
        let scenes = request.scenes(&alone, around);
        let mut retries = 0;
        loop {
            let (frame, capacity) = store.ensure(gaussians, camera, backward)?;
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
            let grown = store.grow(&state, &forward.sizes);
            if !grown.map_err(|error| Failed::TooLittleRoom(Box::new((state, error))))? {
                return Ok(Ran { state, report, retries });
            }
            retries += 1;
        }
    }

    /// Swaps its frame buffers with `store`.
    pub fn exchange(&mut self, store: &mut FrameStore) {
        std::mem::swap(&mut self.store, store);
    }

    /// Frees the buffers. The next frame allocates the same capacity.
    pub fn release(&mut self) {
        self.store.release();
    }

    /// Frees the buffers and resets the capacity.
    pub fn forget(&mut self) {
        self.store.forget();
    }

    /// See [`FrameStore::expect_pictures`].
    pub fn expect_pictures(&mut self, pictures: PictureCapacity) {
        self.store.expect_pictures(pictures);
    }

    /// See [`FrameStore::expect_absolute`].
    pub fn expect_absolute(&mut self) {
        self.store.expect_absolute();
    }

    /// Prepares for [`FrameRunner::record`]: allocates buffers with backward for a scene of this capacity, a camera and the
    /// expected pictures. Also builds the kernels of these settings up to an SH degree.
    pub fn reserve(
        &mut self,
        gaussians: u32,
        camera: &Camera,
        sh_degree: u32,
        settings: &RenderSettings,
    ) -> Result<()> {
        let variant = BlendVariant::of(settings, true);
        for degree in 0..=sh_degree {
            self.forward.prepare_variant(degree, variant)?;
        }
        let gaussians = [self.gaussians_with(gaussians), self.scenes()];
        self.store.ensure(gaussians, camera, true).map(drop)
    }

    /// Grows the capacity above that of all earlier frames, for a scene of this capacity.
    pub fn make_room(&mut self, gaussians: u32) -> Result<()> {
        self.store.make_room(self.gaussians_with(gaussians))
    }

    /// Allocates the capacity of an earlier run.
    pub fn restore(&mut self, capacity: FrameCapacity) -> Result<()> {
        self.store.restore(capacity)
    }

    /// Same as [`FrameRunner::restore`], but if memory does not suffice, the first frame allocates an estimate.
    pub fn restore_if_room(&mut self, capacity: FrameCapacity) -> Result<()> {
        self.store.restore_if_room(capacity)
    }

    /// Current bytes of the frame's buffers.
    pub fn frame_bytes(&self) -> u64 {
        self.store.bytes()
    }

    /// Grows the capacity to the counts that a frame needed. Returns true if it was too small.
    pub fn grow(&mut self, needed: &State) -> Result<bool> {
        self.store.grow(needed, &self.forward.sizes)
    }

    /// Raises the capacity to at least these numbers of visible Gaussians and of instances.
    pub fn set_at_least(&mut self, visible: u32, instances: u32) {
        if visible > self.store.capacity().visible {
            self.store.set_visible(visible);
        }
        if instances > self.store.capacity().instances {
            self.store.set_instances(instances);
        }
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
        let scenes = request.scenes(&alone, &self.around);
        let inputs = FrameInputs { keeps_overflow: true, ..request.inputs(frame, &capacity, &scenes) };
        self.forward.record(r, &inputs);
        record_more(r, &inputs);
        Ok(())
    }

    /// Returns the buffers of the last frame.
    pub fn frame(&self) -> Result<&FrameBuffers> {
        self.store.current()
    }

    /// Returns the capacities of the last frame's buffers.
    pub fn capacity(&self) -> FrameCapacity {
        self.store.capacity()
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
        let ran = self.run(&request, |_, _| Ok(())).map_err(Failed::error)?;
        Ok(FrameStats {
            gaussians: scene.count + self.around.iter().map(|scene| scene.count).sum::<u32>(),
            visible: ran.state.visible,
            instances: ran.state.instances,
            longest_tile: ran.state.longest_tile,
            samples: ran.state.samples,
            scopes: ran.report.scopes,
            retries: ran.retries,
        })
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
        let frame = self.frame()?;
        let [r, g, b] = settings.background;
        let mut color = Vec::with_capacity(pixels as usize);
        let mut transmittance = Vec::with_capacity(pixels as usize);
        self.context.download_chunks(&frame.accumulated.range(0, pixels * 16), |bytes| {
            let texels = bytes.chunks_exact(16).map(bytemuck::pod_read_unaligned::<[f32; 4]>);
            color.extend(texels.clone().map(|[x, y, z, t]| [x + t * r, y + t * g, z + t * b]));
            transmittance.extend(texels.map(|[.., t]| t));
        })?;
        let inverse_depth = match settings.inverse_depth {
            false => None,
            true => {
                let bytes = self.context.download(&frame.inverse_depth.range(0, pixels * 4))?;
                Some(bytemuck::pod_collect_to_vec(&bytes))
            }
        };
        Ok(Frame { width: camera.width, height: camera.height, color, transmittance, inverse_depth, stats })
    }
}
