//! Training: from photographs and a sparse point cloud to Gaussians.
//!
//! One step is one submission: forward, loss, backward, Adam. A host may record it into its own command
//! buffer instead. A densification or an opacity reset that an iteration requests runs at the start of the
//! next step, so that between steps the scene is what the reference would save. A step whose frame overflowed
//! its buffers changes nothing, and is run again with a larger capacity.

mod budget;
pub mod checkpoint;
mod density;
mod photos;
mod record;
mod resume;
mod schedule;
pub mod settings;
mod step;
pub mod verify;

pub use checkpoint::{Checkpoint, Room};
pub use record::{Maintenance, RecordedStep, StepOutcome, StepReservation};
pub use settings::{OptimizerType, TrainSettings};

use crate::backward::Backward;
use crate::densify::Densify;
use crate::error::{Error, Result};
use crate::forward::{Blending, RenderSettings, SceneBuffers};
use crate::loss::{Loss, PhotoFormat};
use crate::optimizer::{Moments, Optimizer};
use crate::planes;
use crate::renderer::{BlendSamples, Frame, FrameRunner, FrameStore, PixelReport, TileReport};
use crate::scene::StoredPhoto;
use crate::scene::{Camera, Gaussians};
use crate::vk::{ArenaMemory, Buffer, Context, MemoryKind, ScopeTime};
use photos::Photos;

/// A photograph and its camera.
#[derive(Clone, Debug)]
pub struct TrainView {
    /// The camera; its size is the photo's.
    pub camera: Camera,
    /// The photo, kept on the device with 8 bits per channel. Masked pixels carry no loss. Photos in a file
    /// are read ahead of the iterations that need them.
    pub photo: StoredPhoto,
}

/// The report of a step.
#[derive(Clone, Debug, Default)]
pub struct StepReport {
    /// Iteration, from 1.
    pub iteration: u32,
    /// Whether the iteration was skipped, because its frame has more (tile, Gaussian) instances than the
    /// device or the memory can hold. It has changed nothing, and its losses are NaN. See [`Trainer::step`].
    pub skipped: bool,
    /// (1 - λ) L1 + λ (1 - SSIM) before the step.
    pub loss: f32,
    /// Mean absolute difference.
    pub l1: f32,
    /// Mean SSIM.
    pub ssim: f32,
    /// Gaussians in the step.
    pub gaussians: u32,
    /// Gaussians visible in the step's view.
    pub visible: u32,
    /// (tile, Gaussian) instances of the step's view.
    pub instances: u32,
    /// Instances of the longest tile of the step's view.
    pub longest_tile: u32,
    /// Samples of blending, if counted.
    pub samples: BlendSamples,
    /// Gaussians that did not change because their gradient was not finite.
    pub skipped_non_finite: u32,
    /// Wall time of the step; 0 for a recorded one.
    pub milliseconds: f64,
    /// Index of the view.
    pub view: usize,
    /// The report of the densification before the step, if the previous iteration requested one. For recorded
    /// steps see [`Maintenance`].
    pub densified: Option<Densified>,
    /// Device time per stage.
    pub scopes: Vec<ScopeTime>,
}

/// The report of a densification.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Densified {
    /// Gaussians before.
    pub before: u32,
    /// Gaussians that stayed.
    pub kept: u32,
    /// Clones that were added.
    pub cloned: u32,
    /// Gaussians that were replaced by two each.
    pub split: u32,
    /// Whether memory or the device's limits did not suffice for all new Gaussians, so that only those with
    /// the largest gradients were cloned or split.
    pub limited: bool,
}

impl Densified {
    /// Gaussians afterwards.
    pub fn rows(&self) -> u32 {
        self.kept + self.cloned + 2 * self.split
    }
}

/// The optimiser's state and the scene on the device.
pub(crate) struct Training {
    pub scene: SceneBuffers,
    pub moments: Moments,
    /// A fourth set of planes, the target of densification's gather.
    pub spare: Vec<Buffer>,
    /// Per Gaussian: sum of NDC gradient norms, views.
    pub statistics: Buffer,
}

/// Trains Gaussians on photographs.
///
/// # Examples
/// ```no_run
/// use ashsplat::vk::{Context, ContextOptions};
/// use ashsplat::{Gaussians, TrainSettings, TrainView, Trainer};
///
/// fn train(views: Vec<TrainView>, initial: &Gaussians, extent: f32) -> ashsplat::Result<Gaussians> {
///     let context = Context::new(&ContextOptions::default())?;
///     let mut trainer = Trainer::new(&context, views, initial, extent, TrainSettings::default())?;
///     while trainer.iteration() < trainer.settings().iterations {
///         trainer.step()?;
///     }
///     trainer.gaussians()
/// }
/// ```
///
/// The [guide](crate::guide::first_training) has more; [`Trainer::record_step`] is for a host's command buffer.
pub struct Trainer {
    context: Context,
    settings: TrainSettings,
    scene_extent: f32,
    cameras: Vec<Camera>,
    views_fingerprint: u64,
    photos: Photos,
    runner: FrameRunner,
    /// Buffers of the frames that are drawn between steps. Training does not depend on them.
    pictures: FrameStore,
    loss: Loss,
    /// For views with masks.
    masked_loss: Option<Loss>,
    backward: Backward,
    optimizer: Optimizer,
    densify: Densify,
    training: Training,
    scratch: LossScratch,
    order: step::ViewOrder,
    progress: step::Progress,
    recording: record::Recording,
    /// Most instances of a frame so far; see [`Room::most_instances`].
    most_instances: u32,
    /// Number of consecutive skipped iterations.
    skipped: u32,
    /// Whether it is unknown if a submission that changes the scene was executed.
    broken: bool,
}

pub(crate) struct LossScratch {
    /// The buffers of [`Loss::scratch_requests`].
    pub loss: Vec<Buffer>,
    pub losses: Buffer,
    pub readback: Buffer,
}

impl LossScratch {
    const READBACK: [(&str, u64); 1] = [("loss_readback", 16)];

    fn with_losses(mut scratch: Vec<(&'static str, u64)>) -> Vec<(&'static str, u64)> {
        scratch.push(("losses", 16));
        scratch
    }

    fn new(context: &Context, loss: &Loss, cameras: &[Camera]) -> Result<Self> {
        let requests = loss.scratch_requests(cameras.iter().map(|c| (c.width, c.height)));
        let mut device = context.allocate("loss", &Self::with_losses(requests), MemoryKind::Device)?;
        let host = context.allocate("readback", &Self::READBACK, MemoryKind::HostVisible)?;
        match (device.pop(), <[Buffer; 1]>::try_from(host)) {
            (Some(losses), Ok([readback])) => Ok(Self { loss: device, losses, readback }),
            _ => unreachable!("one buffer per request"),
        }
    }
}

impl Trainer {
    /// Uploads photographs and initial Gaussians.
    ///
    /// `scene_extent` is 1.1 times the largest distance of a training camera to their mean, world units (the
    /// reference's `cameras_extent`). It scales the learning rate of the means and the thresholds of
    /// densification.
    ///
    /// # Errors
    /// [`Error::Argument`] for invalid settings, cameras or photographs; memory or device failures.
    pub fn new(
        context: &Context,
        views: Vec<TrainView>,
        initial: &Gaussians,
        scene_extent: f32,
        settings: TrainSettings,
    ) -> Result<Self> {
        Self::build(context, views, initial, scene_extent, settings, None)
    }

    /// As [`Trainer::new`], with the capacities of an earlier run.
    fn build(
        context: &Context,
        views: Vec<TrainView>,
        initial: &Gaussians,
        scene_extent: f32,
        settings: TrainSettings,
        room: Option<&Room>,
    ) -> Result<Self> {
        settings.check()?;
        if views.is_empty() {
            return Err(Error::argument("views", "there are none to train on"));
        }
        if initial.is_empty() {
            return Err(Error::argument("initial Gaussians", "there are none to start from"));
        }
        if !(scene_extent.is_finite() && scene_extent > 0.0) {
            let problem = format!("is {scene_extent}, must be positive; do all cameras stand at one place?");
            return Err(Error::argument("scene extent", problem));
        }
        let cameras: Vec<Camera> = views.iter().map(|view| view.camera).collect();
        let count = crate::plan::to_u32(initial.len() as u64)?;
        let photo_bytes = photos::device_bytes(context, &views)?;
        let before = budget::Before { cameras: &cameras, photo_bytes, count, sh_degree: settings.sh_degree };
        let room = room.filter(|room| before.has_room(context, room));
        let capacity = match room {
            Some(room) => room.gaussians,
            None => before.initial_capacity(context)?,
        };
        let photos = Photos::new(context, &views, settings.seed)?;
        let views_fingerprint = resume::fingerprint_of(&views);
        drop(views);
        let scene = planes::upload(context, "scene", initial, capacity, settings.sh_degree)?;
        let training = Training::new(context, scene)?;
        let sparse = settings.optimizer_type == OptimizerType::SparseAdam;
        let loss = Loss::new(context, PhotoFormat::Rgba8)?;
        let masked = photos.any_masked().then(|| Loss::new(context, PhotoFormat::MaskedRgba8));
        let mut runner = FrameRunner::new(context)?;
        if let Some(frame) = room.and_then(Room::frame) {
            runner.restore(frame)?;
        }
        Ok(Self {
            scratch: LossScratch::new(context, &loss, &cameras)?,
            order: step::ViewOrder::new(settings.seed, cameras.len()),
            runner,
            pictures: FrameStore::new(context)?,
            loss,
            masked_loss: masked.transpose()?,
            backward: Backward::new(context),
            optimizer: Optimizer::new(context, sparse),
            densify: Densify::new(context)?,
            context: context.clone(),
            settings,
            scene_extent,
            cameras,
            views_fingerprint,
            photos,
            training,
            progress: step::Progress::default(),
            recording: record::Recording::default(),
            most_instances: 0,
            skipped: 0,
            broken: false,
        })
    }

    /// The device that it trains on.
    pub fn context(&self) -> &Context {
        &self.context
    }

    /// The settings.
    pub fn settings(&self) -> &TrainSettings {
        &self.settings
    }

    /// The form of blending.
    pub fn blending(&self) -> Blending {
        self.runner.blending()
    }

    /// Sets the form of blending, instead of [`Blending::of_device`]. Steps that are already recorded keep
    /// their form. Another step can be recorded after [`Trainer::maintain`] only.
    pub fn set_blending(&mut self, blending: Blending) {
        if self.runner.set_blending(blending) {
            self.recording.frame_is_ready = false;
        }
    }

    /// Number of finished iterations. Recorded ones count once they have finished and [`Trainer::settle`] has
    /// been called.
    pub fn iteration(&self) -> u32 {
        self.progress.iteration
    }

    /// The SH degree of this iteration.
    pub fn sh_degree(&self) -> u32 {
        self.settings.sh_degree_at(self.progress.iteration)
    }

    /// Renders the current scene. If `settings.sh_degree` is None, it uses the SH degree of this iteration.
    ///
    /// # Errors
    /// [`Error::Argument`] for an invalid camera, while recorded steps are in flight, and after a step with
    /// an unknown outcome; memory or device failures.
    pub fn render(&mut self, camera: &Camera, settings: &RenderSettings) -> Result<Frame> {
        let settings = self.at_present_degree(settings);
        self.drawing(|runner, scene| runner.render(scene, camera, &settings))
    }

    /// As [`Trainer::render`], with the number of Gaussians in the frame's tiles.
    ///
    /// # Errors
    /// As [`Trainer::render`].
    pub fn render_with_tiles(
        &mut self,
        camera: &Camera,
        settings: &RenderSettings,
    ) -> Result<(Frame, TileReport)> {
        let settings = self.at_present_degree(settings);
        self.drawing(|runner, scene| runner.render_with_tiles(scene, camera, &settings))
    }

    /// The Gaussians of the current scene that are blended at a pixel, as [`crate::Renderer::inspect`] lists
    /// them.
    ///
    /// # Errors
    /// As [`crate::Renderer::inspect`].
    pub fn inspect(
        &mut self,
        camera: &Camera,
        settings: &RenderSettings,
        pixel: [u32; 2],
    ) -> Result<PixelReport> {
        let settings = self.at_present_degree(settings);
        self.drawing(|runner, scene| runner.inspect(scene, camera, &settings, pixel))
    }

    /// Draws between two steps, with its own buffers, so that a viewer does not change the training's
    /// buffers. They are freed afterwards if memory is bounded. If they do not fit beside the training frame,
    /// that frame is freed, and the next step allocates it again.
    fn drawing<T>(
        &mut self,
        mut draw: impl FnMut(&mut FrameRunner, &SceneBuffers) -> Result<T>,
    ) -> Result<T> {
        self.check_readable()?;
        let Self { runner, pictures, training, .. } = self;
        let mut apart = |runner: &mut FrameRunner| {
            runner.exchange(pictures);
            let drawn = draw(runner, &training.scene);
            runner.exchange(pictures);
            if drawn.is_err() {
                pictures.forget();
            } else if self.context.memory_limit().is_some() {
                pictures.release();
            }
            drawn
        };
        match apart(runner) {
            Err(Error::TooLarge { .. } | Error::Vulkan { call: "vkAllocateMemory", .. }) => {
                runner.release();
                self.recording.frame_is_ready = false;
                apart(runner)
            }
            drawn => drawn,
        }
    }

    fn at_present_degree(&self, settings: &RenderSettings) -> RenderSettings {
        let sh_degree = settings.sh_degree.unwrap_or_else(|| self.sh_degree());
        RenderSettings { sh_degree: Some(sh_degree), ..*settings }
    }

    /// The render settings of training, without the random background.
    pub fn render_settings(&self) -> RenderSettings {
        RenderSettings {
            antialias: self.settings.antialiasing,
            background: [f32::from(u8::from(self.settings.white_background)); 3],
            ..RenderSettings::default()
        }
    }

    /// Downloads the Gaussians.
    ///
    /// # Errors
    /// [`Error::Argument`] while recorded steps are in flight, and after a step with an unknown outcome; when
    /// the device is lost.
    pub fn gaussians(&self) -> Result<Gaussians> {
        self.check_readable()?;
        planes::download(&self.context, &self.training.scene)
    }

    /// Bytes of device memory in use by all arenas of the context.
    pub fn memory_bytes(&self) -> u64 {
        self.context.memory_total().bytes
    }

    /// Current and peak bytes of each arena of the context. The last entry is the total.
    pub fn memory(&self) -> Vec<ArenaMemory> {
        let mut all = self.context.memory();
        all.push(self.context.memory_total());
        all
    }
}

impl Training {
    fn new(context: &Context, scene: SceneBuffers) -> Result<Self> {
        let moments = Moments {
            first: planes::allocate(context, "moments", &scene.plan)?,
            second: planes::allocate(context, "moments", &scene.plan)?,
        };
        let spare = planes::allocate(context, "spare", &scene.plan)?;
        let statistics = allocate_statistics(context, scene.plan.capacity)?;
        context.run("clear moments", |r| {
            for buffer in moments.first.iter().chain(&moments.second).chain([&statistics]) {
                r.fill(buffer, 0);
            }
            Ok(())
        })?;
        Ok(Self { scene, moments, spare, statistics })
    }
}

fn allocate_statistics(context: &Context, capacity: u32) -> Result<Buffer> {
    let requests = [("statistics", u64::from(capacity) * 8)];
    match context.allocate("statistics", &requests, MemoryKind::Device)?.pop() {
        Some(buffer) => Ok(buffer),
        None => unreachable!("one buffer per request"),
    }
}
