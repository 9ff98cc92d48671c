//! Records an iteration: its frame, the loss terms, the backward pass, the optimiser's step, and the strategy's work.

use super::checkpoint::{ExposureState, LightSums, MeanState};
use super::iteration::IterationPlan;
use super::model::Model;
use super::photos::{DepthMaps, Photos};
use super::poses::Poses;
use super::run::Run;
use super::settings::{OptimizerType, TrainSettings};
use super::strategy::{StepInputs, Strategy};
use super::warm_up::{PhotoInputs, PhotoPreparation};
use super::{TrainView, Trainer};
use crate::backward::{Backward, BackwardVariant, Statistics};
use crate::error::{Error, Result};
use crate::exposure::{Exposing, LightBuffers, LightForm};
use crate::forward::{Filter3d, FrameInputs, RenderSettings, SceneBuffers};
use crate::lens_effects::{self, LensInputs, Lenses};
use crate::loss::{LossTerm, Targets, TermInputs};
use crate::optimizer::{Averaging, GradientSums, MeanStep, Optimizer};
use crate::pixels::PixelBorder;
use crate::plan::LaunchSizes;
use crate::planes;
use crate::renderer::Request;
use crate::scene::{Exposure, LensEffects};
use crate::vk::{Buffer, Context, MemoryKind, Recorder};
use std::collections::{BTreeMap, BTreeSet};

/// Kernels of an iteration after its frame.
pub(super) struct StepRecorder {
    terms: Vec<Box<dyn LossTerm>>,
    targets: Targets,
    /// Converts pictures to rows, for terms that read them so.
    border: Option<PixelBorder>,
    sizes: LaunchSizes,
    light: Light,
    backward: Backward,
    /// Render settings of frames, without the depths of the loss terms.
    drawn: RenderSettings,
    /// Index of the absolute statistic among all statistics.
    absolute: Option<usize>,
    optimizer: Optimizer,
    /// None unless parameters are averaged.
    averaging: Option<Averaging>,
    poses: bool,
    preparation: Option<PhotoPreparation>,
}

/// Memory of the loss.
pub(super) struct LossMemory {
    /// Buffers of [`LossTerm::scratch_requests`], per term.
    scratch: Vec<Vec<Buffer>>,
    losses: Buffer,
    /// Replaces the frame's, which does not hold the gradient of the inverse depth on all devices.
    image_gradient: Option<Buffer>,
    /// Pictures by rows, for terms that read them so.
    rows: Option<PixelRows>,
    /// Photograph reduced to the frame's size or over another background.
    prepared: Option<Buffer>,
    pub light: LightMemory,
    pub readback: Buffer,
}

/// Pictures of a view by rows.
struct PixelRows {
    picture: Buffer,
    gradient: Buffer,
    photo: Buffer,
}

/// Total loss and the values of each term.
pub(super) struct LossValues {
    /// Sum of the terms.
    pub total: f32,
    /// Per term: its name; its weighted value and further values.
    pub terms: Vec<(&'static str, [f32; 4])>,
}

/// Inputs of one iteration.
pub(super) struct StepParts<'a> {
    pub run: &'a Run,
    pub model: &'a Model,
    pub photos: &'a Photos,
    pub maps: &'a DepthMaps,
    pub memory: &'a LossMemory,
    pub strategy: &'a dyn Strategy,
    /// None without a 3D filter.
    pub filter: Option<&'a Filter3d>,
    pub poses: Option<&'a Poses>,
    pub plan: &'a IterationPlan,
}

impl<'a> StepParts<'a> {
    /// Frame of the iteration.
    pub fn frame(&self) -> Request<'a> {
        Request {
            scene: &self.model.scene,
            camera: &self.plan.camera,
            pose: self.poses.map(|poses| poses.camera(self.plan.view)),
            settings: &self.plan.settings,
            sh_degree: self.plan.sh_degree,
            backward: true,
        }
    }
}

impl StepRecorder {
    /// The first term writes the picture's gradient. `sums`: true if gradients of several views may be added up. `absolute`:
    /// index of [`ABSOLUTE_STATISTIC`](super::work::ABSOLUTE_STATISTIC) among all statistics.
    ///
    /// # Errors
    /// When the device refuses a pipeline.
    pub fn new(
        context: &Context,
        terms: Vec<Box<dyn LossTerm>>,
        (settings, sums): (&TrainSettings, bool),
        absolute: Option<usize>,
    ) -> Result<Self> {
        let targets = Self::targets_of(&terms);
        let sparse = settings.optimizer_type == OptimizerType::SparseAdam;
        let optimizer = match targets.parameters {
            true => Optimizer::with_parameter_gradients(context, sparse),
            false => Optimizer::new(context, sparse),
        };
        let optimizer = if sums { optimizer.with_sums() } else { optimizer };
        let averages = settings.average_last > 0.0;
        let poses = settings.pose_opt;
        let optimizer = if poses { optimizer.with_moved_cameras() } else { optimizer };
        Ok(Self {
            preparation: PhotoPreparation::new(context, settings)?,
            border: targets.rows().then(|| PixelBorder::new(context)).transpose()?,
            sizes: LaunchSizes::new(context.limits()),
            light: Light::new(context, settings, sums)?,
            backward: Backward::new(context),
            drawn: RenderSettings { dropout: settings.dropout_at(0), ..settings.render_settings() },
            absolute,
            terms,
            targets,
            optimizer,
            averaging: averages.then(|| Averaging::new(context)).transpose()?,
            poses,
        })
    }

    /// Gradients that the terms add to.
    pub fn targets_of(terms: &[Box<dyn LossTerm>]) -> Targets {
        terms.iter().fold(Targets::default(), |all, term| all.and(term.targets()))
    }

    /// Names of the terms.
    pub fn terms(&self) -> impl Iterator<Item = &'static str> {
        self.terms.iter().map(|term| term.name())
    }

    /// Losses of a skipped step.
    pub fn no_losses(&self) -> LossValues {
        LossValues { total: f32::NAN, terms: self.terms().map(|name| (name, [f32::NAN; 4])).collect() }
    }

    /// Render settings of frames, without the random parts.
    pub fn drawn(&self) -> RenderSettings {
        let Targets { inverse_depth, linear_depth, .. } = self.targets;
        RenderSettings { inverse_depth, linear_depth, ..self.drawn }
    }

    /// Builds the missing kernels of any iteration at an SH degree.
    pub fn prepare(&mut self, sh_degree: u32) -> Result<()> {
        self.prepare_backward(sh_degree, false)?;
        if self.absolute.is_some() {
            self.prepare_backward(sh_degree, true)?;
        }
        self.optimizer.prepare(sh_degree)
    }

    /// Builds the missing kernels of this iteration: a short or resumed run needs few of them.
    pub fn prepare_for(&mut self, plan: &IterationPlan) -> Result<()> {
        self.prepare_backward(plan.sh_degree, self.absolute.is_some() && plan.work.accumulates)?;
        self.optimizer.prepare(plan.sh_degree)
    }

    fn prepare_backward(&mut self, sh_degree: u32, absolute: bool) -> Result<()> {
        let variant = BackwardVariant::of(&self.drawn());
        match (self.poses, absolute) {
            (true, _) => self.backward.prepare_with_pose(sh_degree, variant, absolute),
            (false, true) => self.backward.prepare_absolute(sh_degree, variant),
            (false, false) => self.backward.prepare(sh_degree, variant),
        }
    }

    /// Device buffers of the loss for views of these sizes, one per view: scratch of the terms, the losses, and the exposures.
    pub fn device_requests(&self, sizes: &[(u32, u32)]) -> Vec<(&'static str, u64)> {
        let mut requests: Vec<_> = self.terms.iter().flat_map(|term| term.scratch_requests(sizes)).collect();
        requests.push(("losses", self.losses_bytes()));
        let largest =
            |bytes: fn(u32, u32) -> u64| sizes.iter().map(|&(width, height)| bytes(width, height)).max();
        if self.targets.inverse_depth {
            requests.push(("image_gradient", largest(PixelBorder::gradient_bytes).unwrap_or(0)));
        }
        if self.targets.rows() {
            let pixels = largest(|width, height| u64::from(width) * u64::from(height)).unwrap_or(0);
            requests.extend([
                ("picture_rows", 16 * pixels),
                ("gradient_rows", 16 * pixels),
                ("photo_rows", 4 * pixels),
            ]);
        }
        requests.extend(self.preparation.iter().map(|preparation| preparation.request(sizes)));
        requests.extend(self.light.requests(sizes));
        requests
    }

    /// Host-readable copy of the losses.
    pub fn readback_request(&self) -> (&'static str, u64) {
        ("loss_readback", self.losses_bytes())
    }

    fn losses_bytes(&self) -> u64 {
        16 * self.terms.len() as u64
    }

    pub fn allocate(&self, context: &Context, sizes: &[(u32, u32)]) -> Result<LossMemory> {
        let mut device =
            context.allocate("loss", &self.device_requests(sizes), MemoryKind::Device)?.into_iter();
        let scratch = (self.terms.iter())
            .map(|term| device.by_ref().take(term.scratch_requests(sizes).len()).collect())
            .collect();
        let host = context.allocate("readback", &[self.readback_request()], MemoryKind::HostVisible)?;
        match (device.next(), <[Buffer; 1]>::try_from(host)) {
            (Some(losses), Ok([readback])) => {
                let image_gradient = self.targets.inverse_depth.then(|| device.next()).flatten();
                let mut buffers = |count: usize| device.by_ref().take(count).collect::<Vec<_>>();
                let rows = if self.targets.rows() { buffers(3) } else { Vec::new() };
                let rows = <[Buffer; 3]>::try_from(rows).ok();
                let rows = rows.map(|[picture, gradient, photo]| PixelRows { picture, gradient, photo });
                let prepared = self.preparation.as_ref().and_then(|_| device.next());
                let light = self.light.allocated(context, device)?;
                Ok(LossMemory { scratch, losses, image_gradient, rows, prepared, light, readback })
            }
            _ => unreachable!("one buffer per request"),
        }
    }

    /// Records the work after a frame. `losses` is a host-readable copy. If the frame overflowed, persistent state does not
    /// change.
    pub fn record(&self, r: &mut Recorder, inputs: &FrameInputs, parts: &StepParts, losses: &Buffer) {
        let StepParts { model, plan, .. } = *parts;
        let gradient = parts.memory.image_gradient.as_ref().unwrap_or(&inputs.frame.image_gradient);
        r.barrier();
        self.record_loss(r, inputs, parts, gradient);
        r.barrier();
        let accumulate = plan.work.accumulates;
        let absolute = self.absolute.filter(|_| accumulate).map(|place| &model.statistics[place]);
        let statistics = Statistics { buffer: &model.statistics[0], accumulate, absolute };
        let hooks = parts.strategy.records();
        match parts.poses {
            Some(_) => self.backward.record_with_pose(r, inputs, gradient, statistics),
            None => self.backward.record(r, inputs, gradient, statistics),
        }
        let step = StepInputs {
            frame: inputs,
            moments: &model.moments,
            statistics: &model.statistics,
            iteration: plan.iteration,
            step: &plan.step,
            settings: &parts.run.settings,
            scene_extent: parts.run.scene_extent,
        };
        if hooks.statistics {
            r.barrier();
            parts.strategy.record_statistics(r, &step);
        }
        let sums = &model.spare;
        if plan.work.sums_gradients {
            r.barrier();
            let to = GradientSums { sums, starts: plan.summed == 0 };
            self.optimizer.record_add(r, inputs, &model.parameter_gradients, to);
        }
        if plan.work.optimizes {
            r.barrier();
            match plan.work.sums_gradients {
                true => self.optimizer.record_sums(r, inputs, &model.moments, sums, &plan.step),
                false => {
                    let direct = &model.parameter_gradients;
                    self.optimizer.record(r, inputs, &model.moments, direct, &plan.step);
                }
            }
            if hooks.update {
                r.barrier();
                parts.strategy.record_update(r, &step);
            }
        }
        if plan.work.optimizes || plan.work.sums_gradients {
            self.light.record_step(r, &self.light_inputs(inputs, parts));
            // The frame has its own copy of its camera.
            if let Some(poses) = parts.poses {
                poses.record(r, inputs, plan.view, &plan.pose_step);
            }
        }
        if let Some((averaging, step)) = self.averaging.as_ref().zip(plan.mean_step) {
            let state = &inputs.frame.state;
            r.barrier();
            averaging.record_scene(r, inputs.scene(), (&model.spare, state), step);
            parts.memory.light.record_means(r, averaging, (state, step));
        }
        if let Some(filter) = parts.filter.filter(|_| plan.computes_filters) {
            r.barrier();
            filter.record(r, inputs.scene(), &inputs.frame.state);
        }
        r.copy(&parts.memory.losses, losses);
    }

    fn record_loss(&self, r: &mut Recorder, inputs: &FrameInputs, parts: &StepParts, gradient: &Buffer) {
        let StepParts { model, photos, memory, plan, .. } = *parts;
        let (photo, photo_is_masked) = (photos.of(plan.view), photos.is_masked(plan.view));
        let photo = self.record_preparation(r, parts).unwrap_or(photo);
        let rows = self.border.as_ref().zip(memory.rows.as_ref());
        if self.targets.inverse_depth {
            r.fill(gradient, 0);
        }
        model.parameter_gradients.iter().for_each(|gradients| r.fill(gradients, 0));
        if let Some((border, rows)) = rows {
            border.record_picture(r, inputs, &rows.picture);
            let size = (inputs.camera.width, inputs.camera.height);
            border.record_photo(r, size, photo_is_masked, photo, &rows.photo);
        }
        // The gradient of the inverse depth may be native, without rows.
        if self.targets.inverse_depth || self.targets.parameters || rows.is_some() {
            r.barrier();
        }
        let native = (inputs.frame.rendered(&self.sizes), photo, gradient);
        let light = self.light_inputs(inputs, parts);
        let lit = self.light.record(r, &light);
        for (row, (term, scratch)) in self.terms.iter().zip(&memory.scratch).enumerate() {
            if row > 0 {
                r.barrier();
            }
            let by_rows = rows.filter(|_| term.targets().rows());
            if let Some((_, rows)) = by_rows {
                r.fill(&rows.gradient, 0);
                r.barrier();
            }
            // Only the photometric term, which comes first, compares with a photograph.
            let lit = lit.filter(|_| row == 0);
            let (picture, photo, image_gradient) = match (by_rows, lit) {
                (Some((_, rows)), _) => (&rows.picture, &rows.photo, &rows.gradient),
                (None, Some(lit)) => (lit, native.1, native.2),
                (None, None) => native,
            };
            let inputs = TermInputs {
                frame: inputs,
                picture,
                photo,
                photo_is_masked,
                inverse_depth_map: parts.maps.of(plan.view),
                depth_points: parts.maps.points_of(plan.view),
                iteration: plan.iteration,
                image_gradient,
                parameter_gradients: &model.parameter_gradients,
                scratch,
                losses: &memory.losses,
                row: row as u32,
            };
            term.record(r, &inputs);
            if row == 0 {
                self.light.record_backward(r, &light, gradient);
            }
            if let Some((border, rows)) = by_rows {
                r.barrier();
                border.record_gradient(r, inputs.frame, &rows.gradient, gradient, true);
            }
        }
    }

    /// Records the photograph at the frame's size and over its background, with a barrier. None if the stored photograph
    /// serves.
    fn record_preparation<'a>(&self, r: &mut Recorder, parts: &StepParts<'a>) -> Option<&'a Buffer> {
        let StepParts { run, photos, memory, plan, .. } = *parts;
        let camera = &run.cameras[plan.view];
        let transparent = run.settings.random_background && photos.is_transparent(plan.view);
        let (preparation, prepared) = self.preparation.as_ref().zip(memory.prepared.as_ref())?;
        if plan.camera.width == camera.width && !transparent {
            return None;
        }
        let (drawn, composed) = (plan.settings.background, run.render_settings().background);
        let inputs = PhotoInputs {
            cameras: [camera, &plan.camera],
            photo: photos.of(plan.view),
            masked: photos.is_masked(plan.view),
            background_change: transparent.then(|| [0, 1, 2].map(|c| drawn[c] - composed[c])),
        };
        preparation.record(r, &inputs, prepared);
        r.barrier();
        Some(prepared)
    }

    fn light_inputs<'a>(&self, frame: &'a FrameInputs<'a>, parts: &StepParts<'a>) -> LightInputs<'a> {
        let StepParts { run, memory, plan, .. } = *parts;
        LightInputs { frame, rendered: frame.frame.rendered(&self.sizes), memory: &memory.light, plan, run }
    }

    /// Reads the losses of a finished step.
    pub fn read_losses(&self, readback: &Buffer) -> Result<LossValues> {
        let mut bytes = vec![0u8; self.losses_bytes() as usize];
        readback.read(0, &mut bytes)?;
        let rows: Vec<[f32; 4]> = bytemuck::pod_collect_to_vec(&bytes);
        let terms: Vec<_> = self.terms().zip(rows).collect();
        Ok(LossValues { total: terms.iter().map(|(_, row)| row[0]).sum(), terms })
    }
}

// Means of the parameters over the last steps of a run: [`TrainSettings::average_last`].
//
// They share the buffers of the gradient sums that steps of several views use, so the two exclude each other.

/// Refuses averaging together with steps of several views.
pub(super) fn check(settings: &TrainSettings, strategy: &dyn Strategy) -> Result<()> {
    if settings.average_last > 0.0 && strategy.records().sums {
        let problem = format!(
            "is {} (presets and few photos set it), which needs a step after each view; give 0, or multi_step = false",
            settings.average_last
        );
        return Err(Error::argument("average_last", problem));
    }
    Ok(())
}

impl Trainer {
    /// Replaces the parameters by their means. Used if the frame that would record this does not fit.
    pub(super) fn end_means(&mut self) -> Result<()> {
        let model = &self.state.model;
        self.context.run("end means", |r| {
            for (mean, parameters) in model.spare.iter().zip(&model.scene.chunks) {
                r.copy(mean, parameters);
            }
            self.losses.light.record_end(r);
            Ok(())
        })?;
        self.compute_filters()?;
        self.state.progress.averaged = 0;
        Ok(())
    }

    /// Means for the checkpoint; None before the first averaged step.
    pub(super) fn mean_state(&self) -> Result<Option<MeanState>> {
        let model = &self.state.model;
        match self.state.progress.averaged {
            0 => Ok(None),
            steps => Ok(Some(MeanState {
                steps,
                gaussians: planes::download(
                    &self.context,
                    &SceneBuffers { chunks: model.spare.clone(), ..model.scene.clone() },
                )?,
                light: self.light_sums()?,
            })),
        }
    }
}

// Exposure of each photograph and effects of each lens, learned with the scene.

/// Kernels of exposures and of lens effects; None if not learned.
pub(super) struct Light {
    exposing: Option<Exposing>,
    lenses: Option<Lenses>,
}

/// Matrices and moments, which outlive an iteration, and scratch buffers.
pub(super) struct LightMemory {
    pub exposures: Option<LightBuffers>,
    pub lenses: Option<LightBuffers>,
}

/// Inputs of one iteration.
#[derive(Clone, Copy)]
pub(super) struct LightInputs<'a> {
    pub frame: &'a FrameInputs<'a>,
    /// Rendered picture in the native layout.
    pub rendered: &'a Buffer,
    pub memory: &'a LightMemory,
    pub plan: &'a IterationPlan,
    pub run: &'a Run,
}

impl LightInputs<'_> {
    fn view(&self) -> u32 {
        self.plan.view as u32
    }

    fn lens<'a>(&'a self, buffers: &'a LightBuffers) -> LensInputs<'a> {
        let picture = self.memory.exposures.as_ref().map_or(self.rendered, |exposures| &exposures.picture);
        LensInputs { frame: self.frame, picture, buffers, lens: self.run.lenses[self.plan.view] }
    }
}

impl Light {
    /// `sums`: true if steps may follow several views.
    ///
    /// # Errors
    /// When the device refuses a pipeline.
    pub fn new(context: &Context, settings: &TrainSettings, sums: bool) -> Result<Self> {
        let (shares, sparse) = (settings.exposure_shared, settings.exposure_sparsity > 0.0);
        let form = LightForm { center: true, sums, shares, sparse };
        Ok(Self {
            exposing: settings.exposure.then(|| Exposing::new(context, form)).transpose()?,
            lenses: settings.lens_effects.then(|| Lenses::new(context, sums)).transpose()?,
        })
    }

    /// Names and bytes of the buffers, for photographs of these sizes.
    pub fn requests(&self, sizes: &[(u32, u32)]) -> Vec<(&'static str, u64)> {
        let exposures = self.exposing.iter().flat_map(|_| LightBuffers::requests(sizes));
        exposures.chain(self.lenses.iter().flat_map(|_| lens_effects::requests(sizes))).collect()
    }

    /// Takes the buffers of [`Light::requests`] from the allocated ones and clears them.
    pub fn allocated(
        &self,
        context: &Context,
        mut buffers: impl Iterator<Item = Buffer>,
    ) -> Result<LightMemory> {
        let mut next = || {
            let all: Vec<Buffer> = buffers.by_ref().take(LightBuffers::COUNT).collect();
            <[Buffer; LightBuffers::COUNT]>::try_from(all).ok().map(LightBuffers::from_allocated)
        };
        let exposures = self.exposing.as_ref().and_then(|_| next());
        let lenses = self.lenses.as_ref().and_then(|_| next());
        exposures.iter().try_for_each(|exposures| exposures.reset(context, Exposure::IDENTITY.rows))?;
        lenses.iter().try_for_each(|lenses| lenses.reset(context, [[0.0; 4]; 3]))?;
        Ok(LightMemory { exposures, lenses })
    }

    /// Records the exposure and lens effects, and returns the picture to compare with the photograph. None if nothing is
    /// learned: the rendered picture is compared. Ends with a barrier.
    pub fn record<'a>(&self, r: &mut Recorder, inputs: &LightInputs<'a>) -> Option<&'a Buffer> {
        let mut picture = None;
        if let Some((exposing, exposures)) = self.exposing.as_ref().zip(inputs.memory.exposures.as_ref()) {
            exposing.record(r, inputs.frame, exposures, inputs.view());
            r.barrier();
            picture = Some(&exposures.picture);
        }
        if let Some((lenses, buffers)) = self.lenses.as_ref().zip(inputs.memory.lenses.as_ref()) {
            lenses.record(r, &inputs.lens(buffers));
            r.barrier();
            picture = Some(&buffers.picture);
        }
        picture
    }

    /// Records the gradient's way back from that picture to the rendered one. Each part begins with a barrier.
    pub fn record_backward(&self, r: &mut Recorder, inputs: &LightInputs, gradient: &Buffer) {
        if let Some((lenses, buffers)) = self.lenses.as_ref().zip(inputs.memory.lenses.as_ref()) {
            r.barrier();
            lenses.record_backward(r, &inputs.lens(buffers), gradient);
        }
        if let Some((exposing, exposures)) = self.exposing.as_ref().zip(inputs.memory.exposures.as_ref()) {
            r.barrier();
            exposing.record_backward(r, inputs.frame, exposures, inputs.view(), gradient);
        }
    }

    /// Records the steps, or the additions to the gradient sums. Each part begins with a barrier.
    pub fn record_step(&self, r: &mut Recorder, inputs: &LightInputs) {
        let (plan, state) = (inputs.plan, &inputs.frame.frame.state);
        if let Some((exposing, exposures)) = self.exposing.as_ref().zip(inputs.memory.exposures.as_ref()) {
            r.barrier();
            exposing.record_step(r, (exposures, state), inputs.view(), &plan.exposure);
        }
        if let Some((lenses, buffers)) = self.lenses.as_ref().zip(inputs.memory.lenses.as_ref()) {
            r.barrier();
            lenses.record_step(r, (buffers, state), inputs.run.lenses[plan.view], &plan.lens_step);
        }
    }
}

impl LightMemory {
    /// Records the running means, which share the buffers of the gradient sums.
    pub fn record_means(&self, r: &mut Recorder, averaging: &Averaging, (state, step): (&Buffer, MeanStep)) {
        for buffers in self.exposures.iter().chain(&self.lenses) {
            averaging.record(r, [&buffers.values, &buffers.sums, state], step);
        }
    }

    /// Records copies of the means over the values.
    pub fn record_end(&self, r: &mut Recorder) {
        self.exposures.iter().chain(&self.lenses).for_each(|buffers| r.copy(&buffers.sums, &buffers.values));
    }

    /// Exposures of all views, and the effects of the first `lenses` lenses.
    pub fn states(&self, context: &Context, lenses: usize) -> Result<[ExposureState; 2]> {
        let state = |buffers: &Option<LightBuffers>, count: usize| -> Result<ExposureState> {
            let Some(buffers) = buffers else { return Ok(ExposureState::default()) };
            let mut sets = buffers.download(context)?;
            sets.iter_mut().for_each(|set| set.truncate(count));
            let [values, first_moments, second_moments] = sets;
            Ok(ExposureState { values, first_moments, second_moments })
        };
        Ok([state(&self.exposures, usize::MAX)?, state(&self.lenses, lenses)?])
    }

    /// Sums of gradients since the last step.
    pub fn sums(&self, context: &Context, lenses: usize) -> Result<LightSums> {
        let sums = |buffers: &Option<LightBuffers>| {
            buffers.as_ref().map_or(Ok(Vec::new()), |buffers| buffers.download_sums(context))
        };
        let mut of_lenses = sums(&self.lenses)?;
        of_lenses.truncate(lenses);
        Ok(LightSums { exposures: sums(&self.exposures)?, lenses: of_lenses })
    }

    /// Restores [`LightMemory::states`] and [`LightMemory::sums`].
    ///
    /// # Errors
    /// [`Error::Argument`] if there are more rows than views.
    pub fn restore(
        &self,
        context: &Context,
        [exposures, lenses]: [&ExposureState; 2],
        sums: &LightSums,
    ) -> Result<()> {
        let parts = [(&self.exposures, exposures, &sums.exposures), (&self.lenses, lenses, &sums.lenses)];
        for (buffers, state, sums) in parts {
            let Some(buffers) = buffers else { continue };
            // Views that share a lens leave rows unused.
            let padded = |rows: &Vec<[[f32; 4]; 3]>| -> Result<Vec<[[f32; 4]; 3]>> {
                if rows.len() > buffers.photographs() {
                    let problem = format!("has {} for {} views", rows.len(), buffers.photographs());
                    return Err(Error::argument("checkpoint", problem));
                }
                let mut rows = rows.clone();
                rows.resize(buffers.photographs(), [[0.0; 4]; 3]);
                Ok(rows)
            };
            let ExposureState { values, first_moments, second_moments } = state;
            let sets = [padded(values)?, padded(first_moments)?, padded(second_moments)?];
            buffers.upload(context, [&sets[0], &sets[1], &sets[2]])?;
            buffers.upload_sums(context, &padded(sums)?)?;
        }
        Ok(())
    }
}

/// Lens index of each view, counted from 0 in the order of the camera ids.
pub(super) fn lenses_of(views: &[TrainView]) -> Vec<u32> {
    let ids: BTreeSet<u32> = views.iter().map(|view| view.camera_id).collect();
    let numbers: BTreeMap<u32, u32> = ids.into_iter().zip(0..).collect();
    views.iter().map(|view| numbers[&view.camera_id]).collect()
}

impl Trainer {
    pub(super) fn light_states(&self) -> Result<[ExposureState; 2]> {
        self.losses.light.states(&self.context, self.run.lens_count())
    }

    pub(super) fn light_sums(&self) -> Result<LightSums> {
        self.losses.light.sums(&self.context, self.run.lens_count())
    }

    /// Exposures of the views' photographs in their order; empty unless they are learned ([`TrainSettings::exposure`]).
    ///
    /// # Errors
    /// Same as [`Trainer::checkpoint`].
    pub fn exposures(&self) -> Result<Vec<Exposure>> {
        self.check_readable()?;
        let [exposures, _] = self.light_states()?;
        Ok(exposures.values.into_iter().map(|rows| Exposure { rows }).collect())
    }

    /// Lens effects of the views' cameras in the views' order; empty unless they are learned ([`TrainSettings::lens_effects`]).
    ///
    /// # Errors
    /// Same as [`Trainer::checkpoint`].
    pub fn lens_effects(&self) -> Result<Vec<LensEffects>> {
        self.check_readable()?;
        let [_, lenses] = self.light_states()?;
        let of = |&lens: &u32| lenses.values.get(lens as usize).map(|&rows| LensEffects { rows });
        Ok(self.run.lenses.iter().filter_map(of).collect())
    }
}
