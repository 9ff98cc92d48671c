//! Training: from photographs and a sparse point cloud to Gaussians.
//!
//! One step is one submission: forward, loss, backward, Adam. A host may record it into its own command
//! buffer instead. A densification or an opacity reset runs at the start of the next step, so that the scene between steps is
//! what the reference would save. A step whose frame overflowed its buffers changes nothing and is repeated with a larger
//! capacity.

mod align;
mod block;
mod budget;
pub mod checkpoint;
mod choices;
mod exchange;
mod iteration;
mod model;
mod needs;
pub mod options;
mod photos;
mod population;
mod poses;
mod random;
mod record;
mod report;
mod resume;
mod run;
mod schedule;
pub mod settings;
mod step;
mod step_recorder;
mod strategies;
pub mod strategy;
mod surroundings;
mod terms;
pub mod verify;
mod warm_up;
mod work;

pub use block::{BlockState, SceneBlock, Surroundings};
pub use budget::Forecast;
pub use checkpoint::{Checkpoint, ExposureState, LightSums, MeanState, PoseState, Room};
pub use photos::PhotoSize;
pub use photos::TrainView;
pub use population::{Growth, Population};
pub use record::RecordedStep;
pub use record::StepReservation;
pub use report::{Maintenance, StepOutcome, StepReport};
pub use settings::{ImportanceType, OptimizerType, Preset, SplitType, StrategyType, TrainSettings};
pub use strategies::{Budget, Fixed, GrowthSchedule, Mcmc, QuantilePlace, Reference};
pub use strategy::Strategy;
pub use terms::*;
pub use work::{Actions, Densified};

use crate::error::{Error, Result};
use crate::forward::{Blending, Filter3d, RenderSettings, SceneBuffers};
use crate::loss::LossTerm;
use crate::plan::{PictureCapacity, gaussians_with};
use crate::planes;
use crate::renderer::{Aligner, Frame, FrameRunner, FrameStore, PixelReport, TileReport};
use crate::scene::{Camera, Gaussians};
use crate::vk::{ArenaMemory, Context};
use budget::Kit;
use model::{Model, RowMemory, State};
use photos::DepthMaps;
use photos::Photos;
use poses::Poses;
use run::Run;
use std::panic::{self, AssertUnwindSafe};
use step_recorder::{LossMemory, StepRecorder};
use surroundings::Block;

/// Replaceable parts of training. The photometric term of the loss always comes first.
pub struct TrainParts {
    /// Density control.
    pub strategy: Box<dyn Strategy>,
    /// Loss terms besides the photometric one and the strategy's own.
    pub terms: Vec<Box<dyn LossTerm>>,
    /// Block that the initial Gaussians form; None if they are the whole scene.
    pub block: Option<SceneBlock>,
}

impl TrainParts {
    /// Returns the parts that the settings select.
    ///
    /// # Errors
    /// When the device refuses a pipeline.
    pub fn of_settings(context: &Context, settings: &TrainSettings) -> Result<Self> {
        let terms = terms::of_settings(context, settings)?;
        Ok(Self { strategy: strategies::of_settings(context, settings)?, terms, block: None })
    }
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
/// See the [guide](crate::guide::first_training). [`Trainer::record_step`] records into a host's command buffer.
pub struct Trainer {
    context: Context,
    run: Run,
    photos: Photos,
    maps: DepthMaps,
    schedule: iteration::Schedule,
    strategy: Box<dyn Strategy>,
    recorder: StepRecorder,
    losses: LossMemory,
    /// None unless poses are optimised.
    poses: Option<Poses>,
    /// Created by the first alignment.
    aligner: Option<Aligner>,
    runner: FrameRunner,
    /// Buffers of frames drawn between steps. The result of training does not depend on them.
    pictures: FrameStore,
    rows: RowMemory,
    state: State,
    /// The 3D filter, if the settings enable it.
    filter: Option<Filter3d>,
    block: Option<Block>,
    recording: record::Recording,
}

impl Trainer {
    /// Uploads photographs and initial Gaussians.
    ///
    /// `scene_extent` is 1.1 times the largest distance of a training camera to their mean, world units (the
    /// reference's `cameras_extent`). It scales the learning rate of the means and the thresholds of
    /// densification.
    ///
    /// # Errors
    /// [`Error::Argument`] for invalid settings, cameras or photographs; memory or device failures;
    /// [`Error::MissingFeature`] if subgroups differ from the device's report ([`subgroups::check`](crate::subgroups::check)).
    pub fn new(
        context: &Context,
        views: Vec<TrainView>,
        initial: &Gaussians,
        scene_extent: f32,
        settings: TrainSettings,
    ) -> Result<Self> {
        settings.check()?;
        let parts = TrainParts::of_settings(context, &settings)?;
        Self::with_parts(context, views, initial, scene_extent, settings, parts)
    }

    /// Same as [`Trainer::new`], but with a strategy or loss terms that the settings cannot name.
    ///
    /// # Errors
    /// Same as [`Trainer::new`].
    pub fn with_parts(
        context: &Context,
        views: Vec<TrainView>,
        initial: &Gaussians,
        scene_extent: f32,
        settings: TrainSettings,
        parts: TrainParts,
    ) -> Result<Self> {
        Self::build(context, views, initial, (settings, scene_extent), parts, None)
    }

    /// `room`: capacities of an earlier run.
    fn build(
        context: &Context,
        views: Vec<TrainView>,
        initial: &Gaussians,
        (settings, scene_extent): (TrainSettings, f32),
        mut parts: TrainParts,
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
        let sh_degree = settings.sh_degree;
        let count = crate::plan::to_u32(initial.len() as u64)?;
        parts.strategy.check(&settings, count)?;
        let block = parts.block.take();
        Block::check(&settings, &*parts.strategy, block.as_ref())?;
        let around = crate::plan::to_u32(block.as_ref().map_or(0, |block| block.frozen.len() as u64))?;
        photos::check(&views)?;
        let photo_sizes = budget::sizes_of(&views, &settings);
        let photo_memory = photos::memory_of_file(&views);
        let kit = Kit::new(context, (&settings, scene_extent), parts, &photo_sizes)?;
        let counts = (count, around);
        let before = room;
        let (capacity, room) =
            kit.capacity(context, &settings, (&photo_sizes, photo_memory), counts, room)?;
        // The check takes memory, so a training that does not fit is refused first.
        if context.owns_device() {
            crate::subgroups::check(context)?;
        }
        let Kit { strategy, recorder, rows } = kit;
        let sizes: Vec<_> = cameras.iter().map(|camera| (camera.width, camera.height)).collect();
        let photos = Photos::new(context, &views, &photo_sizes, settings.seed)?;
        let maps = DepthMaps::new(context, &views, &photo_sizes)?;
        let poses = Poses::new(context, &settings, &cameras, initial, strategy.records().sums)?;
        let lenses = step_recorder::lenses_of(&views);
        let views_fingerprint = resume::fingerprint_of(&views, settings.lens_effects);
        drop(views);
        let scene = planes::upload(context, ("scene", rows.planes()), initial, capacity, sh_degree)?;
        let state = State::new(Model::new(context, scene, &rows)?);
        let mut runner = FrameRunner::new(context)?;
        let pictures = PictureCapacity::of_cameras(&cameras);
        runner.expect_pictures(pictures);
        let absolute = rows.absolute().is_some();
        if absolute {
            runner.expect_absolute();
        }
        let scenes = 1 + u32::from(around > 0);
        let pictures = (pictures, scenes);
        let first = || before?.first_frame(context, gaussians_with(capacity, around), pictures, absolute);
        let expected = if room.is_none() { first() } else { None };
        room.and_then(|room| room.frame(pictures, absolute)).map_or(Ok(()), |frame| runner.restore(frame))?;
        let run = Run { settings, scene_extent, cameras, lenses, views_fingerprint };
        let filter = run.settings.filter_3d.then(|| Filter3d::new(context, &run.cameras)).transpose()?;
        let filter = match &poses {
            Some(poses) => filter.map(|filter| filter.with_poses(poses.all_cameras().clone())),
            None => filter,
        };
        let block = Block::new(context, block, (&rows, sh_degree), filter.as_ref())?;
        runner.surround(block.as_ref().and_then(Block::around).cloned().into_iter().collect());
        let mut trainer = Self {
            losses: recorder.allocate(context, &sizes)?,
            poses,
            aligner: None,
            schedule: iteration::Schedule::new(&run, &recorder.drawn()),
            pictures: FrameStore::new(context)?,
            context: context.clone(),
            run,
            photos,
            maps,
            strategy,
            recorder,
            runner,
            rows,
            state,
            filter,
            block,
            recording: record::Recording::default(),
        };
        trainer.compute_filters()?;
        // Last, because required buffers come before expected ones.
        expected.map_or(Ok(()), |frame| trainer.runner.restore_if_room(frame))?;
        Ok(trainer)
    }

    /// Context of the device that trains.
    pub fn context(&self) -> &Context {
        &self.context
    }

    /// The settings.
    pub fn settings(&self) -> &TrainSettings {
        &self.run.settings
    }

    /// Form of the blending kernel.
    pub fn blending(&self) -> Blending {
        self.runner.blending()
    }

    /// Sets the form of the blending kernel. Recorded steps keep their form. The next step can be recorded only after
    /// [`Trainer::maintain`].
    pub fn set_blending(&mut self, blending: Blending) {
        if self.runner.set_blending(blending) {
            self.recording.frame_is_ready = false;
        }
    }

    /// Number of finished iterations. Recorded iterations count once they have finished and [`Trainer::settle`] or
    /// [`Trainer::step_outcome`] was called.
    pub fn iteration(&self) -> u32 {
        self.state.progress.iteration
    }

    /// Work of the strategy between an iteration (1-based) and the next.
    pub fn actions_at(&self, iteration: u32) -> Actions {
        self.strategy.work(&self.run.settings, iteration).actions
    }

    /// Iteration of the last opacity reset, if the scene has not recovered from it: [`TrainSettings::reset_recovery`].
    pub fn recent_reset(&self) -> Option<u32> {
        let (now, recovery) = (self.iteration(), self.run.settings.reset_recovery());
        let resets = |&iteration: &u32| self.actions_at(iteration).contains(Actions::RESET_OPACITY);
        (now.saturating_sub(recovery) + 1..now).rev().find(resets)
    }

    /// The SH degree of this iteration.
    pub fn sh_degree(&self) -> u32 {
        self.run.settings.sh_degree_at(self.state.progress.iteration)
    }

    /// Renders the current scene. Uses the SH degree of this iteration if `settings.sh_degree` is None.
    ///
    /// # Errors
    /// [`Error::Argument`] for an invalid camera, while recorded steps are in flight, and after a step with
    /// an unknown outcome; memory or device failures.
    pub fn render(&mut self, camera: &Camera, settings: &RenderSettings) -> Result<Frame> {
        let settings = self.at_present_degree(settings);
        self.drawing(|runner, scene| runner.render(scene, camera, &settings))
    }

    /// Same as [`Trainer::render`], and also returns the number of Gaussians in each tile of the frame.
    ///
    /// # Errors
    /// Same as [`Trainer::render`].
    pub fn render_with_tiles(
        &mut self,
        camera: &Camera,
        settings: &RenderSettings,
    ) -> Result<(Frame, TileReport)> {
        let settings = self.at_present_degree(settings);
        self.drawing(|runner, scene| runner.render_with_tiles(scene, camera, &settings))
    }

    /// Lists the Gaussians of the current scene that are blended at a pixel: see [`crate::Renderer::inspect`].
    ///
    /// # Errors
    /// Same as [`crate::Renderer::inspect`].
    pub fn inspect(
        &mut self,
        camera: &Camera,
        settings: &RenderSettings,
        pixel: [u32; 2],
    ) -> Result<PixelReport> {
        let settings = self.at_present_degree(settings);
        self.drawing(|runner, scene| runner.inspect(scene, camera, &settings, pixel))
    }

    /// Draws between two steps with separate buffers, so that a viewer does not change the training's buffers. With a memory
    /// limit they are freed afterwards. If they do not fit beside the training frame, that frame is freed and the next step
    /// allocates it again.
    fn drawing<T>(
        &mut self,
        mut draw: impl FnMut(&mut FrameRunner, &SceneBuffers) -> Result<T>,
    ) -> Result<T> {
        self.check_readable()?;
        let Self { runner, pictures, state, .. } = self;
        let mut apart = |runner: &mut FrameRunner| {
            runner.exchange(pictures);
            let drawn = panic::catch_unwind(AssertUnwindSafe(|| draw(runner, &state.model.scene)));
            runner.exchange(pictures);
            // A caller that catches the panic can continue training with the training's buffers.
            let drawn = drawn.unwrap_or_else(|panic| {
                pictures.forget();
                panic::resume_unwind(panic)
            });
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

    /// Frees the buffers of frames drawn between steps: see [`crate::Renderer::shrink`].
    pub fn shrink_pictures(&mut self) {
        self.pictures.forget();
    }

    fn at_present_degree(&self, settings: &RenderSettings) -> RenderSettings {
        let sh_degree = settings.sh_degree.unwrap_or_else(|| self.sh_degree());
        RenderSettings { sh_degree: Some(sh_degree), ..*settings }
    }

    /// Render settings of training, without the random background.
    pub fn render_settings(&self) -> RenderSettings {
        self.run.render_settings()
    }

    /// Downloads the Gaussians.
    ///
    /// # Errors
    /// [`Error::Argument`] while recorded steps are in flight, and after a step with an unknown outcome; when
    /// the device is lost.
    pub fn gaussians(&self) -> Result<Gaussians> {
        self.check_readable()?;
        planes::download(&self.context, &self.state.model.scene)
    }

    /// Downloads the Gaussians. The 3D filter, if any, is merged into scales and opacities, so that any renderer draws them
    /// alike.
    ///
    /// # Errors
    /// Same as [`Trainer::gaussians`].
    pub fn baked_gaussians(&self) -> Result<Gaussians> {
        let mut gaussians = self.gaussians()?;
        if self.filter.is_some() {
            gaussians.bake_filters(&self.filters()?)?;
        }
        Ok(gaussians)
    }

    /// Sizes of Mip-Splatting's 3D filter, world units, one per Gaussian; empty without [`TrainSettings::filter_3d`].
    ///
    /// # Errors
    /// Same as [`Trainer::gaussians`].
    pub fn filters(&self) -> Result<Vec<f32>> {
        self.check_readable()?;
        match self.filter {
            Some(_) => planes::download_filters(&self.context, &self.state.model.scene),
            None => Ok(Vec::new()),
        }
    }

    /// Bytes of device memory in use by all arenas of the context, without offloaded buffers.
    pub fn memory_bytes(&self) -> u64 {
        self.context.memory_total().bytes
    }

    /// Current and peak bytes of each arena of the context. The last entries are the offloaded bytes, if any, and the total of
    /// the rest.
    pub fn memory(&self) -> Vec<ArenaMemory> {
        let offloaded = Some(self.context.memory_offloaded()).filter(|memory| memory.peak_bytes > 0);
        let total = self.context.memory_total();
        self.context.memory().into_iter().chain(offloaded).chain([total]).collect()
    }
}
