//! Records an iteration: its frame, the loss terms, the backward pass, the optimiser's step, and the strategy's work.

use super::appearance::{Appearance, AppearanceInputs, AppearanceMemory};
use super::memory::Model;
use super::photos::{DepthMaps, Photos};
use super::poses::Poses;
use super::schedule::{IterationPlan, Progress, TrainingRun, WARM_UP_FACTORS};
use super::settings::{MomentsType, OptimizerType, TrainSettings};
use super::strategy::Densified;
use super::strategy::{StepInputs, Strategy};
use crate::error::Result;
use crate::frame::{
    FrameInputs, FrameVariant, LENS_SUM_BYTES, LaunchSizes, RenderSettings, SceneBuffers, SceneSettings,
    ShStorage, Strips, array_of, blocks,
};
use crate::kernels::constants::STATE_WORDS;
use crate::kernels::pixels::photo_reduced;
use crate::passes::adam::{Optimizer, OptimizerForm};
use crate::passes::backward::{Backward, BackwardForm, Statistics};
use crate::passes::filter_3d::Filter3d;
use crate::passes::lens::LensGradient;
use crate::passes::loss::{LossTerm, NativeLayout, TermData, TermInputs, photo_bytes};
use crate::passes::pixels::LayoutConverter;
use crate::render::{BlendSamples, FrameCounts, Request};
use crate::scene::{Camera, LENS_PARAMETERS};
use crate::vk::{Buffer, Context, Kernel, MemoryKind, RecordSlot, Recorder, ScopeTime};
use bytemuck::{Pod, Zeroable};
use std::collections::VecDeque;

/// Kernels of an iteration after its frame.
pub(super) struct StepRecorder {
    terms: Vec<Box<dyn LossTerm>>,
    term_data: TermData,
    sizes: LaunchSizes,
    appearance: Appearance,
    backward: Backward,
    /// Storage of the scene's SH.
    sh_storage: ShStorage,
    /// Render settings of frames, without the depths of the loss terms.
    base_settings: RenderSettings,
    /// See [`Strategy::absolute_gradients`].
    pub absolute: bool,
    optimizer: Optimizer,
    poses: bool,
    /// None unless lenses are optimised.
    lens: Option<LensGradient>,
    preparation: Option<PhotoPreparation>,
}

/// Memory of the loss.
pub(super) struct LossMemory {
    /// Number of buffers of [`LossTerm::scratch_requests`], per term.
    scratch_counts: Vec<usize>,
    losses: Buffer,
    /// Replaces the frame's, which does not hold the gradient of the inverse depth on all devices.
    image_gradient: Option<Buffer>,
    /// Photograph reduced to the frame's size or over another background.
    prepared: Option<Buffer>,
    pub appearance: AppearanceMemory,
    /// None unless lenses are optimised.
    lens_gradient: Option<Buffer>,
    /// The losses, then the gradient of the lens.
    pub readback: Buffer,
}

/// Total loss and the values of each term.
pub(super) struct LossValues {
    /// Sum of the terms.
    pub total: f32,
    /// Per term: its name; its weighted value and further values.
    pub terms: Vec<(&'static str, [f32; 4])>,
    /// None unless lenses are optimised.
    pub lens: Option<LensReadback>,
}

/// Gradients with respect to a view's lens and to the scene's position.
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
pub(super) struct LensReadback {
    /// Focal lengths, principal point and the lens's words, before [`Camera::lens_gradient`].
    pub parameters: [f32; LENS_PARAMETERS],
    /// Sum over the gradients of all means, world.
    pub means: [f32; 3],
}

/// Inputs of one iteration.
pub(super) struct StepParts<'a> {
    pub run: &'a TrainingRun,
    pub model: &'a Model,
    pub frozen: &'a [SceneBuffers],
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
    /// True if the step reads the photograph as it is stored: the frame has its size, and no random background is behind it.
    fn uses_stored_photo(&self) -> bool {
        let Self { run, photos, plan, .. } = self;
        let composed = run.settings.random_background && photos.is_transparent(plan.view);
        plan.camera.width == run.cameras[plan.view].width && !composed
    }

    /// Frame of the iteration. `hides`: only the photograph's visible pixels count.
    pub fn frame(&self, hides: bool) -> Request<'a> {
        let hides = hides && self.photos.is_masked(self.plan.view) && self.uses_stored_photo();
        Request {
            scene: &self.model.scene,
            other_scenes: self.frozen,
            camera: &self.plan.camera,
            pose: self.poses.map(|poses| poses.camera(self.plan.view)),
            settings: &self.plan.settings,
            of_scenes: &SceneSettings::USUAL,
            sh_degree: self.plan.sh_degree,
            backward: true,
            last_entries: false,
            hidden_by: hides.then(|| self.photos.of(self.plan.view)),
        }
    }
}

impl StepRecorder {
    /// The first term writes the picture's gradient. `absolute`: [`Strategy::absolute_gradients`].
    pub fn new(
        context: &Context,
        terms: Vec<Box<dyn LossTerm>>,
        settings: &TrainSettings,
        absolute: bool,
    ) -> Result<Self> {
        let term_data = Self::term_data_of(&terms);
        let sparse = settings.optimizer_type == OptimizerType::SparseAdam;
        let poses = settings.pose_opt;
        let form = OptimizerForm {
            packed: settings.moments == MomentsType::Packed,
            sparse,
            parameter_gradients: term_data.parameters,
            moved_cameras: poses,
        };
        Ok(Self {
            preparation: PhotoPreparation::new(context, settings)?,
            sizes: LaunchSizes::new(context.limits()),
            appearance: Appearance::new(context, settings)?,
            backward: Backward::new(context),
            sh_storage: settings.sh_storage,
            base_settings: RenderSettings { dropout: settings.dropout_at(0), ..settings.render_settings() },
            absolute,
            terms,
            term_data,
            optimizer: Optimizer::new(context, form),
            poses,
            lens: settings.lens_opt.then(|| LensGradient::new(context)).transpose()?,
        })
    }

    /// True if no term reads pixels that a photograph's mask hides: those besides the photometric one read no pictures.
    pub fn hides_masked_tiles(&self) -> bool {
        let others = Self::term_data_of(&self.terms[1..]);
        !(others.picture || others.inverse_depth)
    }

    /// True if steps have the gradient of the camera's pose or lens.
    pub fn differentiates_cameras(&self) -> bool {
        self.poses || self.lens.is_some()
    }

    fn backward_form(&self, absolute: bool) -> BackwardForm {
        BackwardForm { absolute, pose: self.poses, lens: self.lens.is_some() }
    }

    /// Gradients that the terms add to.
    pub fn term_data_of(terms: &[Box<dyn LossTerm>]) -> TermData {
        terms.iter().fold(TermData::default(), |all, term| all.and(term.data()))
    }

    /// Names of the terms.
    pub fn terms(&self) -> impl Iterator<Item = &'static str> {
        self.terms.iter().map(|term| term.name())
    }

    /// Losses of a skipped step.
    pub fn no_losses(&self) -> LossValues {
        let terms = self.terms().map(|name| (name, [f32::NAN; 4])).collect();
        LossValues { total: f32::NAN, terms, lens: None }
    }

    /// Render settings of frames, without the random parts.
    pub fn base_settings(&self) -> RenderSettings {
        let TermData { inverse_depth, linear_depth, .. } = self.term_data;
        RenderSettings { inverse_depth, linear_depth, ..self.base_settings }
    }

    /// Builds the missing kernels of any iteration at an SH degree.
    pub fn prepare(&mut self, sh_degree: u32, cameras: &[Camera]) -> Result<()> {
        for variant in FrameVariant::of_cameras(&self.base_settings(), cameras, true) {
            let variant = FrameVariant { sh_storage: self.sh_storage, ..variant };
            self.backward.prepare(sh_degree, variant, self.backward_form(false))?;
            if self.absolute {
                self.backward.prepare(sh_degree, variant, self.backward_form(true))?;
            }
            self.optimizer.prepare(sh_degree, variant)?;
        }
        Ok(())
    }

    /// Builds the missing kernels of this iteration: a short or resumed run needs few of them.
    pub fn prepare_for(&mut self, plan: &IterationPlan) -> Result<()> {
        let sh_storage = self.sh_storage;
        let variant = FrameVariant { sh_storage, ..FrameVariant::of(&plan.settings, &plan.camera, true) };
        let absolute = self.absolute && plan.work.accumulates;
        self.backward.prepare(plan.sh_degree, variant, self.backward_form(absolute))?;
        self.optimizer.prepare(plan.sh_degree, variant)
    }

    /// Scratch of the terms for views of these sizes, in a frame's memory: see [`FrameInputs::loss_scratch`].
    pub fn scratch_requests(&self, sizes: &[(u32, u32)]) -> Vec<(&'static str, u64)> {
        self.terms.iter().flat_map(|term| term.scratch_requests(sizes)).collect()
    }

    /// Further device buffers of the loss for views of these sizes, one per view.
    pub fn device_requests(&self, sizes: &[(u32, u32)]) -> Vec<(&'static str, u64)> {
        let mut requests = vec![("losses", self.losses_bytes())];
        if self.term_data.inverse_depth {
            let each = sizes.iter().map(|&(width, height)| LayoutConverter::gradient_bytes(width, height));
            requests.push(("image_gradient", each.max().unwrap_or(0)));
        }
        requests.extend(self.preparation.iter().map(|preparation| preparation.request(sizes)));
        requests.extend(self.appearance.requests(sizes));
        requests.extend(self.lens.iter().map(|_| ("lens_gradient", LENS_SUM_BYTES)));
        requests
    }

    /// Host-readable copy of the losses.
    pub fn readback_request(&self) -> (&'static str, u64) {
        ("loss_readback", self.losses_bytes() + self.lens.as_ref().map_or(0, |_| LENS_SUM_BYTES))
    }

    fn losses_bytes(&self) -> u64 {
        16 * self.terms.len() as u64
    }

    pub fn allocate(&self, context: &Context, sizes: &[(u32, u32)]) -> Result<LossMemory> {
        let mut device = context.allocate("loss", &self.device_requests(sizes), MemoryKind::Device)?;
        let lens_gradient = self.lens.as_ref().and_then(|_| device.pop());
        let mut device = device.into_iter();
        let scratch_counts = self.terms.iter().map(|term| term.scratch_requests(sizes).len()).collect();
        let [readback] =
            array_of(context.allocate("readback", &[self.readback_request()], MemoryKind::HostVisible)?);
        let [losses] = array_of(device.by_ref().take(1).collect());
        let image_gradient = self.term_data.inverse_depth.then(|| device.next()).flatten();
        let prepared = self.preparation.as_ref().and_then(|_| device.next());
        let appearance = self.appearance.allocated(context, device)?;
        Ok(LossMemory {
            scratch_counts,
            losses,
            image_gradient,
            prepared,
            appearance,
            lens_gradient,
            readback,
        })
    }

    /// Records the work after a frame. `losses` is a host-readable copy. If the frame overflowed, persistent state does not
    /// change.
    pub fn record(&self, r: &mut Recorder, inputs: &FrameInputs, parts: &StepParts, losses: &Buffer) {
        let StepParts { model, plan, .. } = *parts;
        let gradient = parts.memory.image_gradient.as_ref().unwrap_or(&inputs.buffers.image_gradient);
        r.barrier();
        self.record_loss(r, inputs, parts, gradient);
        r.barrier();
        let accumulate = plan.work.accumulates;
        let statistics = Statistics { buffer: &model.statistics[0], accumulate };
        let form = self.backward_form(self.absolute && accumulate);
        self.backward.record(r, inputs, gradient, statistics, form);
        if plan.work.optimizes {
            r.barrier();
            let direct = &model.parameter_gradients;
            self.optimizer.record(r, inputs, &model.moments, direct, &plan.step);
            let step = StepInputs {
                frame: inputs,
                moments: &model.moments,
                iteration: plan.iteration,
                step: &plan.step,
                settings: &parts.run.settings,
                scene_extent: parts.run.scene_extent,
            };
            parts.strategy.record_update(r, &step);
            self.appearance.record_step(r, &self.appearance_inputs(inputs, parts));
            // The frame has its own copy of its camera.
            if let Some(poses) = parts.poses {
                poses.record(r, inputs, plan.view, &plan.pose_step);
            }
            if let Some((lens, gradient)) = self.lens.as_ref().zip(parts.memory.lens_gradient.as_ref()) {
                lens.record(r, inputs, gradient);
                r.barrier();
                r.copy(gradient, &losses.range(self.losses_bytes(), LENS_SUM_BYTES));
            }
        }
        if let Some(filter) = parts.filter.filter(|_| plan.computes_filters) {
            r.barrier();
            filter.record(r, inputs.scene(), &inputs.buffers.state);
        }
        r.copy(&parts.memory.losses, &losses.range(0, self.losses_bytes()));
    }

    fn record_loss(&self, r: &mut Recorder, inputs: &FrameInputs, parts: &StepParts, gradient: &Buffer) {
        let StepParts { model, photos, memory, plan, .. } = *parts;
        let (photo, photo_is_masked) = (photos.of(plan.view), photos.is_masked(plan.view));
        let prepared = self.preparation.as_ref().and_then(|preparation| preparation.record(r, parts));
        let photo = prepared.unwrap_or(photo);
        if self.term_data.inverse_depth {
            r.fill(gradient, 0);
        }
        model.parameter_gradients.iter().for_each(|gradients| r.fill(gradients, 0));
        if self.term_data.inverse_depth || self.term_data.parameters {
            r.barrier();
        }
        let rendered = inputs.buffers.rendered(&self.sizes);
        let appearance = self.appearance_inputs(inputs, parts);
        let as_photographed = self.appearance.record(r, &appearance);
        let mut scratches = inputs.loss_scratch;
        for (row, (term, &count)) in self.terms.iter().zip(&memory.scratch_counts).enumerate() {
            let (scratch, others) = scratches.split_at(count);
            scratches = others;
            if row > 0 {
                r.barrier();
            }
            let inputs = TermInputs {
                frame: inputs,
                // Only the photometric term, which comes first, compares with a photograph.
                picture: as_photographed.filter(|_| row == 0).unwrap_or(rendered),
                photo,
                photo_is_masked,
                inverse_depth_map: parts.maps.of(plan.view),
                depth_points: parts.maps.points_of(plan.view),
                iteration: plan.iteration,
                image_gradient: gradient,
                parameter_gradients: &model.parameter_gradients,
                scratch,
                losses: &memory.losses,
                row: row as u32,
            };
            term.record(r, &inputs);
            if row == 0 {
                self.appearance.record_backward(r, &appearance, gradient);
            }
        }
    }

    fn appearance_inputs<'a>(
        &self,
        frame: &'a FrameInputs<'a>,
        parts: &StepParts<'a>,
    ) -> AppearanceInputs<'a> {
        let StepParts { run, memory, plan, .. } = *parts;
        let rendered = frame.buffers.rendered(&self.sizes);
        AppearanceInputs { frame, rendered, memory: &memory.appearance, plan, run }
    }

    /// Reads the losses of a finished step.
    pub fn read_losses(&self, readback: &Buffer) -> Result<LossValues> {
        let (_, bytes) = self.readback_request();
        let mut bytes = vec![0u8; bytes as usize];
        readback.read(0, &mut bytes)?;
        let (losses, lens) = bytes.split_at(self.losses_bytes() as usize);
        let rows: Vec<[f32; 4]> = bytemuck::pod_collect_to_vec(losses);
        let terms: Vec<_> = self.terms().zip(rows).collect();
        let lens =
            self.lens.as_ref().map(|_| bytemuck::pod_read_unaligned(&lens[..size_of::<LensReadback>()]));
        Ok(LossValues { total: terms.iter().map(|(_, row)| row[0]).sum(), terms, lens })
    }
}

/// Kernels that reduce photographs and compose transparent ones over random backgrounds.
struct PhotoPreparation {
    sizes: LaunchSizes,
    /// True if photographs may keep their size.
    whole: bool,
    /// For opaque, masked and transparent photographs.
    kernels: [Kernel<photo_reduced::Interface>; 3],
}

impl PhotoPreparation {
    /// None unless the settings have a warm-up or random backgrounds.
    fn new(context: &Context, settings: &TrainSettings) -> Result<Option<Self>> {
        let whole = settings.random_background;
        if settings.warm_up == 0 && !whole {
            return Ok(None);
        }
        let sizes = LaunchSizes::new(context.limits());
        let (workgroup_size, strips) = (sizes.elementwise_workgroup, sizes.strips);
        let kernel = |masked, transparent| {
            Kernel::new(context, &photo_reduced::Spec { workgroup_size, strips, masked, transparent })
        };
        let kernels = [kernel(false, false)?, kernel(true, false)?, kernel(true, true)?];
        Ok(Some(Self { sizes, whole, kernels }))
    }

    /// Name and bytes of a prepared photograph, for photographs of these sizes (width, height).
    fn request(&self, sizes: &[(u32, u32)]) -> (&'static str, u64) {
        let layout = if self.sizes.strips { NativeLayout::Strips } else { NativeLayout::Rows };
        let factor = if self.whole { 1 } else { WARM_UP_FACTORS[1] };
        let bytes =
            |&(width, height): &(u32, u32)| photo_bytes(layout, width / factor, height / factor, true);
        ("prepared_photo", sizes.iter().map(bytes).max().unwrap_or(0).max(4))
    }

    /// Records the photograph at the frame's size and over its background, with a barrier. None if the stored photograph
    /// serves.
    fn record<'a>(&self, r: &mut Recorder, parts: &StepParts<'a>) -> Option<&'a Buffer> {
        let StepParts { run, photos, memory, plan, .. } = *parts;
        let (camera, prepared) = (&run.cameras[plan.view], memory.prepared.as_ref()?);
        if parts.uses_stored_photo() {
            return None;
        }
        let transparent = run.settings.random_background && photos.is_transparent(plan.view);
        let Camera { width, height, .. } = plan.camera;
        let (drawn, composed) = (plan.settings.background, run.settings.render_settings().background);
        let change = [0, 1, 2].map(|c| drawn[c] - composed[c]);
        let masked = photos.is_masked(plan.view);
        let words = match self.sizes.strips {
            true => (if masked { 4 } else { 3 }) * Strips { width, height }.values() / 4,
            false => u64::from(width) * u64::from(height),
        };
        let push = photo_reduced::Push {
            image_width: camera.width,
            image_height: camera.height,
            factor: camera.width / width,
            background_change: if transparent { change } else { [0.0; 3] },
        };
        let form = if transparent { 2 } else { usize::from(masked) };
        let groups = blocks(words, self.sizes.elementwise_workgroup.into());
        let bind = photo_reduced::Bind { photo: photos.of(plan.view), reduced: prepared };
        r.dispatch(&self.kernels[form], &bind, &push, groups);
        r.barrier();
        Some(prepared)
    }
}

/// Recorded steps of a host.
#[derive(Default)]
pub(super) struct RecordedSteps {
    pub slots: Vec<StepSlot>,
    pub in_flight: VecDeque<InFlight>,
    /// Counts of the first step that overflowed, and the maxima over all such steps. None once the capacity has grown.
    pub overflow: Option<[FrameCounts; 2]>,
    /// True if the next recorded step may use the frame's buffers.
    pub frame_is_ready: bool,
}

pub(super) struct StepSlot {
    pub recording: RecordSlot,
    pub counts: Buffer,
    pub losses: Buffer,
    pub outcome: Option<StepOutcome>,
    /// Capacity in dispatches.
    pub dispatches: usize,
}

pub(super) struct InFlight {
    pub slot: usize,
    pub plan: IterationPlan,
    pub after: Progress,
    pub gaussians: u32,
}

impl StepSlot {
    pub fn new(context: &Context, dispatches: usize, losses: (&'static str, u64)) -> Result<Self> {
        let host = [("state_readback", u64::from(STATE_WORDS) * 4), losses];
        let [counts, losses] = array_of(context.allocate("step slot", &host, MemoryKind::HostVisible)?);
        Ok(Self {
            recording: RecordSlot::new(context, dispatches)?,
            counts,
            losses,
            outcome: None,
            dispatches,
        })
    }

    pub fn counts(&self) -> Result<FrameCounts> {
        let mut bytes = [0u8; STATE_WORDS as usize * 4];
        self.counts.read(0, &mut bytes)?;
        Ok(FrameCounts::of(&bytes))
    }
}

/// Report of a step.
#[derive(Clone, Debug, Default)]
pub struct StepReport {
    /// Iteration, counted from 1.
    pub iteration: u32,
    /// True if the iteration was skipped, because its frame has more visible Gaussians or (tile, Gaussian) instances than the
    /// device or the memory can hold. A skipped iteration changes nothing, and its losses are NaN. See
    /// [`Trainer::step`](super::Trainer::step).
    pub skipped: bool,
    /// Loss before the step: the sum of its terms.
    pub loss: f32,
    /// Mean absolute difference of the colours.
    pub l1: f32,
    /// Mean SSIM.
    pub ssim: f32,
    /// Name and weighted value of each loss term. The first is (1 - λ) L1 + λ (1 - SSIM).
    pub terms: Vec<(&'static str, f32)>,
    /// Number of Gaussians in the step.
    pub gaussians: u32,
    /// Number of visible Gaussians in the step's view.
    pub visible: u32,
    /// Number of (tile, Gaussian) instances in the step's view.
    pub instances: u32,
    /// Number of instances in the longest tile of the step's view.
    pub longest_tile: u32,
    /// Counts of blending samples, if enabled.
    pub samples: BlendSamples,
    /// Number of Gaussians that did not change because their gradient was not finite.
    pub skipped_non_finite: u32,
    /// Wall time of the step; 0 for a recorded step.
    pub milliseconds: f64,
    /// Index of the view.
    pub view: usize,
    /// Report of the densification before the step, if the previous iteration requested one. For recorded steps see
    /// [`Maintenance`](super::Maintenance).
    pub densified: Option<Densified>,
    /// Device time per stage.
    pub scopes: Vec<ScopeTime>,
}

/// Outcome of a recorded step that has finished.
#[derive(Clone, Debug)]
pub enum StepOutcome {
    /// The step was executed.
    Done(StepReport),
    /// The step changed nothing, because its frame or that of an earlier step overflowed.
    /// [`Trainer::maintain`](super::Trainer::maintain) grows the capacity, and the iteration is recorded again.
    Overflowed {
        /// Iteration to repeat.
        iteration: u32,
        /// Number of visible Gaussians that the step needs.
        visible_needed: u32,
        /// Capacity of the step in visible Gaussians.
        visible_capacity: u32,
        /// Number of (tile, Gaussian) instances that the step needs. If visible Gaussians overflowed, counts only those that
        /// fit.
        instances_needed: u32,
        /// Capacity of the step in instances.
        instance_capacity: u32,
    },
}

impl StepReport {
    /// Report of a finished step, without times.
    pub(super) fn new(
        plan: &IterationPlan,
        gaussians: u32,
        losses: &LossValues,
        counts: &FrameCounts,
    ) -> Self {
        // The photometric term comes first. Its own numbers are L1 and SSIM.
        let [_, l1, ssim, _] = losses.terms.first().map_or([f32::NAN; 4], |(_, row)| *row);
        Self {
            iteration: plan.iteration,
            loss: losses.total,
            l1,
            ssim,
            terms: losses.terms.iter().map(|(name, row)| (*name, row[0])).collect(),
            gaussians,
            visible: counts.visible_needed,
            instances: counts.all_instances(),
            longest_tile: counts.longest_tile,
            samples: counts.samples,
            skipped_non_finite: counts.non_finite,
            view: plan.view,
            ..Self::default()
        }
    }
}
