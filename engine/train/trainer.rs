//! The trainer: its state, its iterations, and what it can say and draw between two of them.

use super::appearance::lenses_of;
use super::block::Block;
use super::checkpoint::{Capacities, Checkpoint, ExposureState};
use super::lens_opt::{LensOptimizer, with_own_lens};
use super::memory::{Model, PeakCounts, RowMemory, frame_shape};
use super::parts::{BuiltParts, Forecast, TrainParts, check_block};
use super::photos::{self, DepthMaps, Photos, TrainView, fingerprint_of};
use super::population::{Population, may_have_executed};
use super::poses::Poses;
use super::schedule::{IterationPlan, Progress, Schedule, TrainingRun};
use super::settings::TrainSettings;
use super::step::{LossMemory, LossValues, RecordedSteps, StepParts, StepRecorder, StepReport};
use super::strategy::{Actions, Changes, StepWork, Strategy};
use crate::error::{Error, Result};
use crate::frame::{
    Blending, PictureCapacity, RenderSettings, SceneBuffers, gaussians_with, planes, subgroups, to_u32,
};
use crate::passes::filter_3d::Filter3d;
use crate::render::{DeviceScene, Frame, FrameCounts, FrameRun, FrameRunner, Renderer, RunError};
use crate::scene::{Camera, Exposure, Gaussians, LensEffects, Projection, Twist};
use crate::vk::{ArenaMemory, Context};
use std::slice;

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
    pub(super) context: Context,
    pub(super) run: TrainingRun,
    pub(super) photos: Photos,
    pub(super) maps: DepthMaps,
    schedule: Schedule,
    pub(super) strategy: Box<dyn Strategy>,
    pub(super) recorder: StepRecorder,
    pub(super) losses: LossMemory,
    /// None unless poses are optimised.
    pub(super) poses: Option<Poses>,
    /// None unless lenses are optimised.
    pub(super) lens_opt: Option<LensOptimizer>,
    pub(super) runner: FrameRunner,
    /// Draws between steps. The result of training does not depend on it.
    pub(super) pictures: Renderer,
    pub(super) rows: RowMemory,
    pub(super) state: RunState,
    /// The 3D filter, if the settings enable it.
    pub(super) filter: Option<Filter3d>,
    pub(super) block: Option<Block>,
    /// Frozen Gaussians of the block, drawn with every frame; one scene at most.
    pub(super) frozen: Vec<SceneBuffers>,
    pub(super) recorded: RecordedSteps,
}

/// The state of a run between two steps.
pub(super) struct RunState {
    pub model: Model,
    pub progress: Progress,
    pub peak: PeakCounts,
    /// Number of consecutive skipped iterations.
    pub skipped: u32,
    /// True if a submission that changes the scene has an unknown outcome.
    pub broken: bool,
    /// State saved before memory was freed that could not be allocated again.
    pub rescued: Option<Box<Checkpoint>>,
}

impl RunState {
    /// Notes that an iteration's step has executed.
    pub fn done(&mut self, after: Progress, counts: PeakCounts) {
        self.progress = after;
        self.skipped = 0;
        self.peak = self.peak.max(counts);
    }

    /// Checks that the state of the scene is known.
    pub fn check_whole(&self) -> Result<()> {
        if self.broken {
            let problem = "an earlier step was not finished; continue from a checkpoint, or anew";
            return Err(Error::argument("trainer", problem));
        }
        Ok(())
    }

    /// Notes a submission whose wait failed.
    pub fn note_failure<T>(&mut self, result: &Result<T>) {
        self.broken |= result.as_ref().is_err_and(may_have_executed);
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
    /// [`Error::Argument`] for invalid settings, cameras or photographs; memory or device failures;
    /// [`Error::MissingFeature`] if subgroups differ from the device's report ([`subgroups::check`](crate::frame::subgroups::check)).
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
    pub fn with_parts(
        context: &Context,
        views: Vec<TrainView>,
        initial: &Gaussians,
        scene_extent: f32,
        settings: TrainSettings,
        parts: TrainParts,
    ) -> Result<Self> {
        Self::build(context, views, initial, scene_extent, settings, parts, None)
    }

    /// `earlier`: capacities of an earlier run.
    pub(super) fn build(
        context: &Context,
        views: Vec<TrainView>,
        initial: &Gaussians,
        scene_extent: f32,
        settings: TrainSettings,
        mut parts: TrainParts,
        earlier: Option<&Capacities>,
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
        let gaussians = to_u32(initial.len() as u64)?;
        parts.strategy.check(&settings, gaussians)?;
        let block = parts.block.take();
        block.as_ref().map_or(Ok(()), |block| check_block(&settings, &*parts.strategy, block))?;
        let frozen = to_u32(block.as_ref().map_or(0, |block| block.frozen.len() as u64))?;
        photos::check(&views)?;
        settings.check_cameras(views.iter().map(|view| &view.camera))?;
        let photo_sizes = photos::sizes_of(&views, &settings);
        let photo_memory = photos::memory_of_file(&views);
        let parts = BuiltParts::new(context, &settings, scene_extent, parts, &photo_sizes)?;
        let forecast = Forecast {
            settings: &settings,
            photos: &photo_sizes,
            photo_memory,
            gaussians,
            frozen,
            capacities: earlier,
        };
        let (capacity, fits_earlier) = forecast.capacity(context, &parts)?;
        // The check takes memory, so a training that does not fit is refused first.
        if context.owns_device() {
            subgroups::check(context)?;
        }
        let BuiltParts { strategy, recorder, rows } = parts;
        let any_masked = photo_sizes.iter().any(|photo| photo.masked);
        let photos = Photos::new(context, &views, &photo_sizes, settings.seed)?;
        let maps = DepthMaps::new(context, &views, &photo_sizes)?;
        let mut cameras: Vec<Camera> = views.iter().map(|view| view.camera).collect();
        if settings.lens_opt {
            if cameras.iter().all(|camera| camera.projection == Projection::Equirectangular) {
                return Err(Error::argument("lens_opt", "all views are panoramas, which have no parameters"));
            }
            cameras.iter_mut().for_each(|camera| *camera = with_own_lens(camera));
        }
        let lens_opt = match settings.lens_opt {
            true => {
                // The neighbours of a block, and known depths, determine the scene's size.
                let may_scale = block.is_none() && !recorder.base_settings().inverse_depth;
                Some(LensOptimizer::new(context, &cameras, initial, may_scale)?)
            }
            false => None,
        };
        let poses = Poses::new(context, &settings, &cameras, initial)?;
        let run = TrainingRun {
            lens_of_view: lenses_of(&views),
            views_fingerprint: fingerprint_of(&views, settings.lens_effects),
            settings,
            scene_extent,
            cameras,
        };
        drop(views);
        let sh_degree = run.settings.sh_degree;
        let plan = rows.plan(context, capacity, sh_degree)?;
        let scene = planes::upload_planned(context, "scene", rows.planes, initial, plan)?;
        let model = Model::new(context, scene, &rows)?;
        let mut runner = FrameRunner::new(context)?;
        let pictures = PictureCapacity::of_cameras(&run.cameras);
        let shape = frame_shape(pictures, 1 + u32::from(frozen > 0), &recorder);
        let sizes: Vec<_> = run.cameras.iter().map(|camera| (camera.width, camera.height)).collect();
        runner.store.expect(shape, recorder.scratch_requests(&sizes));
        if any_masked {
            runner.forward.prepare_hiding()?;
        }
        let first =
            |earlier: &Capacities| earlier.first_frame(context, gaussians_with(capacity, frozen), shape);
        let expected = earlier.filter(|_| !fits_earlier).and_then(first);
        if let Some(frame) = earlier.filter(|_| fits_earlier).and_then(|earlier| earlier.frame(shape)) {
            runner.store.restore(frame)?;
        }
        let moved = poses.as_ref().map(|poses| poses.all_cameras().clone());
        let filter =
            run.settings.filter_3d.then(|| Filter3d::new(context, &run.cameras, moved)).transpose()?;
        let mut frozen = Vec::new();
        if let Some(block) = block.as_ref().filter(|block| !block.frozen.is_empty()) {
            let plan = rows.plan(context, to_u32(block.frozen.len() as u64)?, sh_degree)?;
            frozen.push(planes::upload_planned(context, "surroundings", rows.planes, &block.frozen, plan)?);
        }
        if let Some(filter) = &filter {
            // Frozen Gaussians do not move, so once is enough.
            frozen.iter().try_for_each(|scene| filter.run(context, scene))?;
        }
        let block = block.map(|block| Block::new(context, &block)).transpose()?.flatten();
        let mut trainer = Self {
            losses: recorder.allocate(context, &sizes)?,
            poses,
            lens_opt,
            schedule: Schedule::new(&run, &recorder.base_settings()),
            pictures: Renderer::new(context)?,
            context: context.clone(),
            run,
            photos,
            maps,
            strategy,
            recorder,
            runner,
            rows,
            state: RunState {
                model,
                progress: Progress::default(),
                peak: PeakCounts::default(),
                skipped: 0,
                broken: false,
                rescued: None,
            },
            filter,
            block,
            frozen,
            recorded: RecordedSteps::default(),
        };
        trainer.compute_filters()?;
        // Last, because required buffers come before expected ones.
        expected.map_or(Ok(()), |frame| trainer.runner.store.restore_if_it_fits(frame))?;
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
        self.runner.forward.blending()
    }

    /// Sets the form of the blending kernel. Recorded steps keep their form. The next step can be recorded only after
    /// [`Trainer::maintain`].
    pub fn set_blending(&mut self, blending: Blending) {
        self.pictures.set_blending(blending);
        if self.runner.forward.set_blending(blending) {
            self.recorded.frame_is_ready = false;
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
    pub fn render(&mut self, camera: &Camera, settings: &RenderSettings) -> Result<Frame> {
        let settings = self.at_current_degree(settings);
        self.draw(|renderer| renderer.render(camera, &settings))
    }

    /// Calls `draw` with a renderer of the current scene and its [surroundings](Trainer::surroundings). The renderer has its
    /// own buffers, so that a viewer does not change the training's. With a memory limit they are freed afterwards. If they do
    /// not fit beside the training frame, that frame is freed, `draw` is called again, and the next step allocates the frame.
    ///
    /// # Errors
    /// [`Error::Argument`] while recorded steps are in flight, and after a step with an unknown outcome; errors of `draw`.
    pub fn draw<T>(&mut self, mut draw: impl FnMut(&mut Renderer) -> Result<T>) -> Result<T> {
        self.check_readable()?;
        let scenes = [slice::from_ref(&self.state.model.scene), &self.frozen].concat();
        let pictures = &mut self.pictures;
        let mut drawn = pictures.with_scenes(scenes.clone(), &mut draw);
        if let Err(Error::TooLarge { .. } | Error::Vulkan { call: "vkAllocateMemory", .. }) = drawn {
            pictures.shrink();
            self.runner.store.release();
            self.recorded.frame_is_ready = false;
            drawn = pictures.with_scenes(scenes, &mut draw);
        }
        if drawn.is_err() {
            pictures.shrink();
        } else if self.context.memory_limit().is_some() {
            pictures.release();
        }
        drawn
    }

    /// Frees the buffers of [`Trainer::draw`]: see [`Renderer::shrink`].
    pub fn shrink_pictures(&mut self) {
        self.pictures.shrink();
    }

    /// Returns the settings with the SH degree of this iteration, unless they have one.
    pub fn at_current_degree(&self, settings: &RenderSettings) -> RenderSettings {
        let sh_degree = settings.sh_degree.unwrap_or_else(|| self.sh_degree());
        RenderSettings { sh_degree: Some(sh_degree), ..*settings }
    }

    /// Render settings of training, without the random background.
    pub fn render_settings(&self) -> RenderSettings {
        self.run.settings.render_settings()
    }

    /// Downloads the Gaussians.
    pub fn gaussians(&self) -> Result<Gaussians> {
        self.check_readable()?;
        planes::download(&self.context, &self.state.model.scene)
    }

    /// Downloads the Gaussians. The 3D filter, if any, is merged into scales and opacities, so that any renderer draws them
    /// alike.
    pub fn baked_gaussians(&self) -> Result<Gaussians> {
        let mut gaussians = self.gaussians()?;
        if self.filter.is_some() {
            gaussians.bake_filters(&self.filters()?)?;
        }
        Ok(gaussians)
    }

    /// Sizes of Mip-Splatting's 3D filter, world units, one per Gaussian; empty without [`TrainSettings::filter_3d`].
    pub fn filters(&self) -> Result<Vec<f32>> {
        self.check_readable()?;
        match self.filter {
            Some(_) => planes::download_filters(&self.context, &self.state.model.scene),
            None => Ok(Vec::new()),
        }
    }

    /// Current and peak bytes of each arena of the context. The last entries are the offloaded bytes, if any, and the total of
    /// the rest.
    pub fn memory(&self) -> Vec<ArenaMemory> {
        let offloaded = Some(self.context.memory_offloaded()).filter(|memory| memory.peak_bytes > 0);
        let total = self.context.memory_total();
        self.context.memory().into_iter().chain(offloaded).chain([total]).collect()
    }

    /// Frozen Gaussians around the [block](super::SceneBlock), which every picture of this trainer shows; None if there are none. In
    /// [`Renderer::inspect`] their indices follow those of the trained Gaussians.
    pub fn surroundings(&self) -> Option<DeviceScene> {
        Some(DeviceScene::new(&self.context, self.frozen.first()?.clone()))
    }

    /// Hides the statistics of Gaussians outside the core from a densification.
    pub(super) fn mask_outside(&self, action: Actions) -> Result<()> {
        let mask = self.block.as_ref().and_then(|block| block.mask.as_ref());
        let Some(mask) = mask.filter(|_| action == Actions::DENSIFY) else { return Ok(()) };
        let model = &self.state.model;
        self.context.run("mask statistics", |r| mask.record(r, &model.scene, &model.statistics[0]))?;
        Ok(())
    }

    pub(super) fn appearance_states(&self) -> Result<[ExposureState; 2]> {
        self.losses.appearance.states(&self.context, &self.run.lens_of_view)
    }

    /// Exposures of the views' photographs in their order; empty unless they are learned ([`TrainSettings::exposure`]).
    pub fn exposures(&self) -> Result<Vec<Exposure>> {
        self.check_readable()?;
        let [exposures, _] = self.appearance_states()?;
        Ok(exposures.values.into_iter().map(|rows| Exposure { rows }).collect())
    }

    /// Lens effects of the views' cameras in the views' order; empty unless they are learned ([`TrainSettings::lens_effects`]).
    pub fn lens_effects(&self) -> Result<Vec<LensEffects>> {
        self.check_readable()?;
        let [_, lens_effects] = self.appearance_states()?;
        let of = |&lens: &u32| lens_effects.values.get(lens as usize).map(|&rows| LensEffects { rows });
        Ok(self.run.lens_of_view.iter().filter_map(of).collect())
    }

    /// Runs one iteration. The iteration is skipped if its frame has more visible Gaussians or instances than the device or the
    /// memory can hold, even without the reserve of Gaussians. It then changes nothing, but counts ([`StepReport::skipped`]).
    ///
    /// # Errors
    /// When memory is short, or no view fits: the Gaussians stay as before the iteration, and the caller may try again. When
    /// the device is lost or too slow ([`Error::DeviceLost`], [`Error::Timeout`]): the state of the Gaussians is unknown, and
    /// every later step is refused; resume from a checkpoint. [`Error::Argument`] while recorded steps are in flight.
    pub fn step(&mut self) -> Result<StepReport> {
        self.state.check_whole()?;
        let result = self.run_iteration();
        self.recorded.frame_is_ready = false;
        self.state.note_failure(&result);
        result
    }

    /// Repeats the last iteration of a run that is extended. As in the reference, that iteration did not change the parameters,
    /// but in a longer run it does. Its view gives the same gradients on the same parameters. Its statistics are already added.
    /// An iteration stays skipped, and is skipped if it does not fit here.
    pub(super) fn finish_last_iteration(&mut self) -> Result<()> {
        if self.state.skipped > 0 {
            return Ok(());
        }
        let progress = self.state.progress;
        let before = Progress { iteration: progress.iteration - 1, ..progress };
        let plan = self.plan_after(&before);
        if !plan.work.optimizes {
            return Ok(());
        }
        let plan = IterationPlan { work: StepWork { accumulates: false, ..plan.work }, ..plan };
        self.photos.prepare(&self.context, plan.iteration)?;
        match self.run_step(&plan) {
            Err(RunError::OutOfMemory { counts, error }) => self.skip(&plan, &counts, error)?,
            ran => {
                ran.map_err(RunError::error)?;
                self.read_losses(&plan)?;
                self.state.progress = before.after(&plan);
            }
        }
        self.state.progress.due = progress.due;
        Ok(())
    }

    fn run_iteration(&mut self) -> Result<StepReport> {
        let start = std::time::Instant::now();
        self.check_settled()?;
        let densified = self.catch_up()?.densified;
        let progress = self.state.progress;
        let plan = self.plan_after(&progress);
        self.photos.prepare(&self.context, plan.iteration)?;
        if plan.iteration < self.run.settings.iterations {
            self.photos.prefetch(&self.context)?;
        }
        let mut ran = self.run_step(&plan);
        if let Err(RunError::OutOfMemory { counts, .. }) = &ran
            && self.give_up_reserve(counts)?
        {
            ran = self.run_step(&plan);
        }
        let ran = match ran {
            Err(RunError::OutOfMemory { counts, error }) => {
                self.skip(&plan, &counts, error)?;
                let skipped = self.recorder.no_losses();
                return Ok(StepReport {
                    skipped: true,
                    milliseconds: start.elapsed().as_secs_f64() * 1e3,
                    densified,
                    ..StepReport::new(&plan, self.state.model.scene.count, &skipped, &counts)
                });
            }
            ran => ran.map_err(RunError::error)?,
        };
        self.state.done(progress.after(&plan), PeakCounts::of_whole_frame(&plan, &self.run, &ran.counts));
        let losses = self.read_losses(&plan)?;
        Ok(StepReport {
            milliseconds: start.elapsed().as_secs_f64() * 1e3,
            densified,
            scopes: ran.report.scopes,
            ..StepReport::new(&plan, self.state.model.scene.count, &losses, &ran.counts)
        })
    }

    /// Reads the losses of a finished step, and makes the lenses' step.
    fn read_losses(&mut self, plan: &IterationPlan) -> Result<LossValues> {
        let losses = self.recorder.read_losses(&self.losses.readback)?;
        if let Some(lenses) = &mut self.lens_opt {
            lenses.step(&mut self.run.cameras, plan, &losses);
        }
        Ok(losses)
    }

    /// Number of steps of lenses that were not made, because they would have folded the picture.
    pub fn refused_lens_steps(&self) -> u32 {
        self.lens_opt.as_ref().map_or(0, |lenses| lenses.refused)
    }

    /// The camera with its lens as [`lens_opt`](super::TrainSettings::lens_opt) has moved it, if a training view was given with the
    /// same lens; otherwise only the change that all focal lengths share.
    pub fn with_trained_lens(&self, camera: &Camera) -> Camera {
        self.lens_opt.as_ref().map_or(*camera, |lenses| lenses.refined(camera))
    }

    /// Computes the sizes of the 3D filter for all Gaussians, if there is one.
    pub(super) fn compute_filters(&self) -> Result<()> {
        match &self.filter {
            Some(filter) => filter.run(&self.context, &self.state.model.scene),
            None => Ok(()),
        }
    }

    /// Plan of the next iteration.
    pub(super) fn plan_after(&mut self, progress: &Progress) -> IterationPlan {
        let work = self.strategy.work(&self.run.settings, progress.iteration + 1);
        self.schedule.plan_after(progress, &self.run, work)
    }

    /// Does the work that the previous iteration left for the time before the next one. The reference tests and saves first, so
    /// between steps the scene is what the reference would save.
    pub(super) fn catch_up(&mut self) -> Result<Changes> {
        if let Some(lenses) = &mut self.lens_opt {
            lenses.apply_zoom(&self.context, &self.state.model.scene, &mut self.run.cameras)?;
        }
        let mut done = Changes::default();
        loop {
            let due = self.state.progress.due;
            if due.is_empty() {
                return Ok(done);
            }
            self.mask_outside(due.first())?;
            let mut population = Population {
                context: &self.context,
                run: &self.run,
                rows: &self.rows,
                runner: &mut self.runner,
                pictures: &mut self.pictures,
                frozen: &self.frozen,
                model: &mut self.state.model,
                photos: &self.photos,
                poses: self.poses.as_ref(),
                peak: &mut self.state.peak,
                iteration: self.state.progress.iteration,
            };
            let changes = self.strategy.between_steps(&mut population, due.first())?;
            if changes.densified.is_some() {
                self.compute_filters()?;
            }
            done.densified = changes.densified.or(done.densified);
            done.opacities_reset |= changes.opacities_reset;
            self.state.progress.due = due.without(due.first());
        }
    }

    /// Skips an iteration whose frame has too many visible Gaussians or instances for the device or the memory. Densification
    /// adds no Gaussians until frames have fewer.
    ///
    /// # Errors
    /// The given error, if it has another cause, if no step has succeeded yet, or if every view was skipped since the last
    /// successful step. A training without progress must end.
    pub(super) fn skip(&mut self, plan: &IterationPlan, needed: &FrameCounts, error: Error) -> Result<()> {
        let state = &mut self.state;
        // A view that fits may come first in one epoch and last in the next.
        let apart = 2 * (self.run.cameras.len() as u64 - 1);
        let trains = state.progress.steps > 0 && u64::from(state.skipped) < apart;
        if !matches!(error, Error::TooLarge { .. }) || !trains {
            return Err(error);
        }
        state.skipped += 1;
        state.peak = state.peak.max(PeakCounts::of_whole_frame(plan, &self.run, needed));
        state.progress = Progress { iteration: plan.iteration, due: plan.work.actions, ..state.progress };
        Ok(())
    }

    /// Runs forward, loss, backward and the optimiser's step in one submission.
    fn run_step(&mut self, plan: &IterationPlan) -> Result<FrameRun, RunError> {
        self.recorder.prepare_for(plan)?;
        let (run, model, strategy) = (&self.run, &self.state.model, &*self.strategy);
        let (photos, maps, memory) = (&self.photos, &self.maps, &self.losses);
        let (filter, poses, frozen) = (self.filter.as_ref(), self.poses.as_ref(), &self.frozen);
        let parts = StepParts { run, model, frozen, photos, maps, memory, strategy, filter, poses, plan };
        self.runner.run(&parts.frame(self.recorder.hides_masked_tiles()), |r, inputs| {
            self.recorder.record(r, inputs, &parts, &self.losses.readback);
        })
    }

    /// Current cameras of the training views, in the views' order. [`pose_opt`](super::TrainSettings::pose_opt) moves their poses away
    /// from the given ones, [`lens_opt`](super::TrainSettings::lens_opt) their lenses.
    pub fn cameras(&self) -> Result<Vec<Camera>> {
        self.check_readable()?;
        match &self.poses {
            None => Ok(self.run.cameras.clone()),
            Some(poses) => poses.moved(&self.context, &self.run.cameras),
        }
    }

    /// Total movement of each training view's camera, in the views' order; 0 without
    /// [`pose_opt`](super::TrainSettings::pose_opt).
    pub fn pose_changes(&self) -> Result<Vec<Twist>> {
        self.check_readable()?;
        let Some(poses) = &self.poses else { return Ok(vec![Twist::default(); self.run.cameras.len()]) };
        let parameters = poses.state(&self.context)?.parameters;
        Ok(parameters.iter().map(|xi| Twist::from_array(xi.map(f64::from))).collect())
    }

    /// Extent of the scene as given to training, world units.
    pub fn scene_extent(&self) -> f32 {
        self.run.scene_extent
    }
}
