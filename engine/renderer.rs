//! Rendering on a device of our own: `Renderer::render` records a frame, submits, waits and reads it back.

mod frame_store;
mod gradients;
mod inspect;

pub use frame_store::FrameStore;
pub use gradients::Gradients;
pub use inspect::{PixelReport, Sample};

use crate::error::{Error, Result};
use crate::forward::{Forward, FrameInputs, RenderSettings, SceneBuffers};
use crate::planes;
use crate::scene::{Camera, Gaussians};
use crate::vk::{Context, RunReport, ScopeTime};
use frame_store::State;

/// Renders a scene of Gaussians.
pub struct Renderer {
    context: Context,
    forward: Forward,
    backward: crate::backward::Backward,
    store: FrameStore,
    scene: Option<SceneBuffers>,
}

/// A rendered frame.
#[derive(Clone, Debug, Default)]
pub struct Frame {
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// Row-major colours, linear as trained, on the background, not clamped.
    pub color: Vec<[f32; 3]>,
    /// Transmittance that is left behind the last Gaussian: 1 where there is none.
    pub transmittance: Vec<f32>,
    /// Sum of weights / z, if asked for.
    pub inverse_depth: Option<Vec<f32>>,
    /// What the frame was made of.
    pub stats: FrameStats,
}

/// Counts and times of a frame.
#[derive(Clone, Debug, Default)]
pub struct FrameStats {
    /// Gaussians in the scene.
    pub gaussians: u32,
    /// Visible ones.
    pub visible: u32,
    /// (tile, Gaussian) instances.
    pub instances: u32,
    /// Entries of the fullest tile.
    pub longest_tile: u32,
    /// Device time per stage.
    pub scopes: Vec<ScopeTime>,
    /// Times the frame was run again because a capacity had to grow.
    pub retries: u32,
}

impl Renderer {
    /// Builds the kernels; nothing is loaded yet.
    ///
    /// # Errors
    /// When the device refuses a pipeline.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self {
            context: context.clone(),
            forward: Forward::new(context)?,
            backward: crate::backward::Backward::new(context),
            store: FrameStore::new(context)?,
            scene: None,
        })
    }

    /// Loads a scene in place of the one before.
    ///
    /// # Errors
    /// [`Error::Argument`] when the vectors differ in length; allocation failures.
    pub fn upload(&mut self, gaussians: &Gaussians) -> Result<()> {
        self.scene = None;
        let count = crate::plan::to_u32(gaussians.len() as u64)?;
        self.scene = Some(planes::upload(&self.context, "scene", gaussians, count, gaussians.sh_degree)?);
        Ok(())
    }

    /// Starts the capacity for (tile, Gaussian) instances at this number instead of a guess: frames that need more are
    /// run again with more.
    ///
    /// # Errors
    /// When the memory does not suffice.
    pub fn set_instance_capacity(&mut self, instances: u32) {
        self.store.set_instances(instances);
    }

    /// Renders the scene.
    ///
    /// # Errors
    /// [`Error::Argument`] without a scene or with a camera that makes no sense; memory or device failures.
    pub fn render(&mut self, camera: &Camera, settings: &RenderSettings) -> Result<Frame> {
        let (state, report, retries) = self.run(camera, settings, false, |_, _| Ok(()))?;
        self.read_frame(camera, settings, &state, report, retries)
    }

    /// Runs a frame until its capacities suffice; `record_more` records what follows the blending.
    fn run(
        &mut self,
        camera: &Camera,
        settings: &RenderSettings,
        backward: bool,
        mut record_more: impl FnMut(&mut crate::vk::Recorder, &FrameInputs) -> Result<()>,
    ) -> Result<(State, RunReport, u32)> {
        let Some(scene) = &self.scene else {
            return Err(Error::argument("scene", "none is loaded; call upload first"));
        };
        camera.check()?;
        let sh_degree = active_degree(scene, settings);
        self.forward.prepare(sh_degree, settings.inverse_depth)?;
        let mut retries = 0;
        loop {
            let (frame, capacity) = self.store.ensure(scene.count, camera, backward)?;
            let inputs =
                FrameInputs { scene, frame: &frame, capacity: &capacity, camera, settings, sh_degree };
            let report = self.context.run("frame", |r| {
                self.forward.record(r, &inputs);
                record_more(r, &inputs)?;
                self.store.record_readback(r, &frame);
                Ok(())
            })?;
            let state = self.store.state()?;
            if !self.store.grow(&state, &self.forward.sizes)? {
                return Ok((state, report, retries));
            }
            retries += 1;
        }
    }

    fn read_frame(
        &self,
        camera: &Camera,
        settings: &RenderSettings,
        state: &State,
        report: RunReport,
        retries: u32,
    ) -> Result<Frame> {
        let pixels = u64::from(camera.width) * u64::from(camera.height);
        let frame = self.store.current()?;
        let bytes = self.context.download(&frame.accumulated.range(0, pixels * 16))?;
        let [r, g, b] = settings.background;
        let texels = bytes.chunks_exact(16).map(|texel| {
            let channel = |k: usize| {
                f32::from_le_bytes([texel[4 * k], texel[4 * k + 1], texel[4 * k + 2], texel[4 * k + 3]])
            };
            let t = channel(3);
            ([channel(0) + t * r, channel(1) + t * g, channel(2) + t * b], t)
        });
        let (color, transmittance) = texels.unzip();
        let inverse_depth = match settings.inverse_depth {
            false => None,
            true => {
                let bytes = self.context.download(&frame.inverse_depth.range(0, pixels * 4))?;
                Some(bytemuck::pod_collect_to_vec(&bytes))
            }
        };
        let stats = FrameStats {
            gaussians: self.scene.as_ref().map_or(0, |scene| scene.count),
            visible: state.visible,
            instances: state.instances,
            longest_tile: state.longest_tile,
            scopes: report.scopes,
            retries,
        };
        Ok(Frame { width: camera.width, height: camera.height, color, transmittance, inverse_depth, stats })
    }
}

fn active_degree(scene: &SceneBuffers, settings: &RenderSettings) -> u32 {
    settings.sh_degree.unwrap_or(scene.plan.sh_degree).min(scene.plan.sh_degree)
}
