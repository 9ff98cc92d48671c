//! One iteration.

use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::{Densified, LossScratch, StepReport, Trainer, Training};
use crate::backward::{Backward, Statistics};
use crate::error::{Error, Result};
use crate::forward::{FrameInputs, RenderSettings};
use crate::loss::{Loss, LossInputs};
use crate::optimizer::{Optimizer, Rates, Step};
use crate::renderer::{Failed, Ran, State};
use crate::vk::{Buffer, Recorder};

/// Random streams of a run, all derived from its seed.
const STREAM_VIEWS: u64 = 1;
const STREAM_BACKGROUND: u64 = 2;

/// Each view once per epoch, in random order.
#[derive(Clone)]
pub(super) struct ViewOrder {
    seed: u32,
    views: usize,
    epoch: u64,
    order: Vec<usize>,
}

impl ViewOrder {
    pub fn new(seed: u32, views: usize) -> Self {
        Self { seed, views, epoch: u64::MAX, order: Vec::new() }
    }

    /// Number of views.
    pub fn views(&self) -> usize {
        self.views
    }

    /// The view of an iteration, from 1. It depends only on the seed and the iteration.
    pub fn view(&mut self, iteration: u32) -> usize {
        let index = iteration as usize - 1;
        let epoch = (index / self.views) as u64;
        if epoch != self.epoch {
            let mut rng = generator(self.seed, STREAM_VIEWS, epoch);
            self.order = (0..self.views).collect();
            self.order.shuffle(&mut rng);
            self.epoch = epoch;
        }
        self.order[index % self.views]
    }
}

fn generator(seed: u32, stream: u64, counter: u64) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(u64::from(seed));
    rng.set_stream(stream);
    // Each counter has 2^20 words of its own, far more than an iteration draws.
    rng.set_word_pos(u128::from(counter) << 20);
    rng
}

/// Work that an iteration requests before the next one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Due {
    pub densifies: bool,
    pub resets: bool,
}

/// Progress of a run between two iterations.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Progress {
    /// Iterations done.
    pub iteration: u32,
    /// Steps of the optimiser. Iterations that densify have none.
    pub steps: u64,
    pub opacity_steps: u64,
    pub due: Due,
}

impl Progress {
    /// The progress after an iteration.
    pub fn after(&self, plan: &IterationPlan) -> Self {
        Self {
            iteration: plan.iteration,
            steps: self.steps + u64::from(plan.optimizes),
            opacity_steps: self.opacity_steps + u64::from(plan.optimizes && !plan.due.resets),
            due: plan.due,
        }
    }
}

/// The work of an iteration.
#[derive(Clone, Copy, Debug)]
pub(super) struct IterationPlan {
    pub iteration: u32,
    pub view: usize,
    collects: bool,
    optimizes: bool,
    pub due: Due,
    pub sh_degree: u32,
    pub settings: RenderSettings,
    step: Step,
}

impl IterationPlan {
    /// A plan with all work that any iteration does, for some view: for a recording that is never executed.
    pub fn rehearsal(self, view: usize) -> Self {
        Self { view, optimizes: true, ..self }
    }
}

/// What an iteration records after its frame.
pub(super) struct LossAndUpdate<'a> {
    pub loss: &'a Loss,
    pub backward: &'a Backward,
    pub optimizer: &'a Optimizer,
    pub training: &'a Training,
    pub scratch: &'a LossScratch,
    pub photo: &'a Buffer,
    pub lambda_dssim: f32,
    pub plan: &'a IterationPlan,
}

/// The runner of a trainer's frames, and for a planned iteration its frame and the work after it. A macro,
/// because it borrows the runner mutably along with other fields of the trainer.
macro_rules! step_parts {
    ($trainer:expr, $plan:expr) => {{
        let $crate::trainer::Trainer {
            runner,
            loss,
            masked_loss,
            backward,
            optimizer,
            training,
            scratch,
            photos,
            cameras,
            settings,
            ..
        } = $trainer;
        let masked = masked_loss.as_ref().filter(|_| photos.is_masked($plan.view));
        let tail = $crate::trainer::step::LossAndUpdate {
            loss: masked.unwrap_or(loss),
            backward,
            optimizer,
            training,
            scratch,
            photo: photos.of($plan.view),
            lambda_dssim: settings.lambda_dssim as f32,
            plan: $plan,
        };
        let request = $crate::renderer::Request {
            scene: &training.scene,
            camera: &cameras[$plan.view],
            settings: &$plan.settings,
            sh_degree: $plan.sh_degree,
            backward: true,
        };
        (runner, request, tail)
    }};
}
pub(super) use step_parts;

impl LossAndUpdate<'_> {
    /// Records the loss, the backward pass and the optimiser's step. `losses` is a host-readable copy.
    /// Persistent state does not change if the frame overflowed.
    pub fn record(&self, r: &mut Recorder, inputs: &FrameInputs, losses: &Buffer) {
        let Self { training, scratch, plan, .. } = self;
        r.barrier();
        let f = inputs.frame;
        self.loss.record(
            r,
            &LossInputs {
                rendered: f.rendered(self.loss.sizes()),
                photo: self.photo,
                scratch: &scratch.loss,
                losses: &scratch.losses,
                row: 0,
                image_gradient: &f.image_gradient,
                width: inputs.camera.width,
                height: inputs.camera.height,
                background: inputs.settings.background,
                lambda_dssim: self.lambda_dssim,
            },
        );
        r.barrier();
        let statistics = Statistics { buffer: &training.statistics, accumulate: plan.collects };
        self.backward.record(r, inputs, &f.image_gradient, statistics);
        if plan.optimizes {
            r.barrier();
            self.optimizer.record(r, inputs, &training.moments, &plan.step);
        }
        r.copy(&scratch.losses, losses);
    }
}

impl Trainer {
    /// Runs one iteration. If its frame has more instances than the device or the memory can hold, the
    /// iteration is skipped: it changes nothing, but counts ([`StepReport::skipped`]).
    ///
    /// # Errors
    /// When memory does not suffice, also if no view at all fits: the Gaussians are then as before the
    /// iteration, and it may be tried again. When the device is lost or too slow ([`Error::DeviceLost`],
    /// [`Error::Timeout`]): the state of the Gaussians is unknown, and every later step is refused; resume
    /// from a checkpoint. [`Error::Argument`] while recorded steps are in flight.
    pub fn step(&mut self) -> Result<StepReport> {
        self.check_whole()?;
        let result = self.run_iteration();
        self.recording.frame_is_ready = false;
        self.note_failure(&result);
        result
    }

    /// The last iteration of a run does not change the parameters, as in the reference. In a longer run it
    /// does. This runs it again when a run is extended: its view, on the same parameters, gives the same
    /// gradients. Its statistics are already added. A skipped iteration stays skipped, and so does one that
    /// does not fit here.
    pub(super) fn finish_last_iteration(&mut self) -> Result<()> {
        if self.skipped > 0 {
            return Ok(());
        }
        let progress = self.progress;
        let before = Progress { iteration: progress.iteration - 1, ..progress };
        let plan = IterationPlan { collects: false, ..self.plan_after(&before) };
        if !plan.optimizes {
            return Ok(());
        }
        self.photos.prepare(&self.context, plan.iteration)?;
        match self.run_step(&plan) {
            Err(Failed::TooLittleRoom(why)) => self.leave_out(&plan, &why.0, why.1)?,
            ran => {
                ran.map_err(Failed::error)?;
                self.progress = before.after(&plan);
            }
        }
        self.progress.due = progress.due;
        Ok(())
    }

    /// Whether the state of the scene is known.
    pub(super) fn check_whole(&self) -> Result<()> {
        if self.broken {
            let problem = "an earlier step was not finished; go on from a checkpoint, or anew";
            return Err(Error::argument("trainer", problem));
        }
        Ok(())
    }

    /// A submission whose wait failed may or may not have been executed.
    pub(super) fn note_failure<T>(&mut self, result: &Result<T>) {
        self.broken = match result {
            Err(Error::DeviceLost { .. } | Error::Timeout { .. }) => true,
            Err(Error::Vulkan { call, .. }) => *call == "vkWaitForFences",
            _ => false,
        };
    }

    fn run_iteration(&mut self) -> Result<StepReport> {
        let start = std::time::Instant::now();
        self.check_settled()?;
        let densified = self.catch_up()?;
        let progress = self.progress;
        let plan = self.plan_after(&progress);
        self.photos.prepare(&self.context, plan.iteration)?;
        let ran = match self.run_step(&plan) {
            Err(Failed::TooLittleRoom(why)) => {
                let (state, error) = *why;
                self.leave_out(&plan, &state, error)?;
                return Ok(StepReport {
                    skipped: true,
                    milliseconds: start.elapsed().as_secs_f64() * 1e3,
                    densified,
                    ..StepReport::new(&plan, self.training.scene.count, [f32::NAN; 3], &state)
                });
            }
            ran => ran.map_err(Failed::error)?,
        };
        self.progress = self.progress.after(&plan);
        self.skipped = 0;
        self.most_instances = self.most_instances.max(ran.state.instances);
        let losses = read_losses(&self.scratch.readback)?;
        Ok(StepReport {
            milliseconds: start.elapsed().as_secs_f64() * 1e3,
            densified,
            scopes: ran.report.scopes,
            ..StepReport::new(&plan, self.training.scene.count, losses, &ran.state)
        })
    }

    /// The plan of the next iteration.
    pub(super) fn plan_after(&mut self, progress: &Progress) -> IterationPlan {
        let iteration = progress.iteration + 1;
        let view = self.order.view(iteration);
        let s = &self.settings;
        let due = Due { densifies: s.densifies_at(iteration), resets: s.resets_opacity_at(iteration) };
        IterationPlan {
            iteration,
            view,
            collects: s.collects_statistics_at(iteration),
            // In the reference, densification replaces the parameters, which then have no gradient, and the
            // last iteration only saves.
            optimizes: !due.densifies && iteration < s.iterations,
            due,
            sh_degree: s.sh_degree_at(iteration),
            settings: RenderSettings { background: self.background(iteration), ..self.render_settings() },
            step: self.optimizer_step(iteration, progress, due),
        }
    }

    /// Densifies and resets opacities if the previous iteration requested it. The reference tests and saves
    /// before it does so: between steps, the scene is what the reference would save.
    pub(super) fn catch_up(&mut self) -> Result<Option<Densified>> {
        let mut densified = None;
        if self.progress.due.densifies {
            densified = Some(self.run_densification(self.progress.iteration)?);
            self.progress.due.densifies = false;
        }
        if self.progress.due.resets {
            self.run_opacity_reset()?;
            self.progress.due.resets = false;
        }
        Ok(densified)
    }

    fn background(&self, iteration: u32) -> [f32; 3] {
        if self.settings.random_background {
            let mut rng = generator(self.settings.seed, STREAM_BACKGROUND, iteration.into());
            return [rng.random(), rng.random(), rng.random()];
        }
        self.render_settings().background
    }

    /// Skips an iteration whose frame has too many instances for the device or the memory. The iteration
    /// changes nothing, and densification adds no Gaussians until frames have fewer instances.
    ///
    /// # Errors
    /// The given error if it has another cause, if no step has succeeded yet, and if every view has been
    /// skipped since the last step that succeeded: a training that makes no progress must end.
    pub(super) fn leave_out(&mut self, plan: &IterationPlan, needed: &State, error: Error) -> Result<()> {
        // A view that fits may come first in one epoch and last in the next.
        let apart = 2 * (self.cameras.len() as u64 - 1);
        let trains = self.progress.steps > 0 && u64::from(self.skipped) < apart;
        if !matches!(error, Error::TooLarge { .. }) || !trains {
            return Err(error);
        }
        self.skipped += 1;
        self.most_instances = self.most_instances.max(needed.instances);
        self.progress = Progress { iteration: plan.iteration, due: plan.due, ..self.progress };
        Ok(())
    }

    /// Runs forward, loss, backward and the optimiser's step in one submission.
    fn run_step(&mut self, plan: &IterationPlan) -> Result<Ran, Failed> {
        self.backward.prepare(plan.sh_degree, plan.settings.inverse_depth)?;
        self.optimizer.prepare(plan.sh_degree)?;
        let (runner, request, tail) = step_parts!(self, plan);
        runner.run(&request, |r, inputs| {
            tail.record(r, inputs, &tail.scratch.readback);
            Ok(())
        })
    }

    fn optimizer_step(&self, iteration: u32, progress: &Progress, due: Due) -> Step {
        let s = &self.settings;
        let rates = Rates {
            mean: s.position_lr(iteration) * f64::from(self.scene_extent),
            // A reset replaces the opacities, which then have no gradient in the reference.
            opacity: if due.resets { 0.0 } else { s.opacity_lr },
            quat: s.rotation_lr,
            log_scale: s.scaling_lr,
            sh_dc: s.feature_lr,
            sh_rest: s.feature_rest_lr(),
        };
        match s.optimizer_type {
            super::OptimizerType::SparseAdam => Step { rates, count: 0, opacity_count: 0 },
            super::OptimizerType::Default => {
                Step { rates, count: progress.steps + 1, opacity_count: progress.opacity_steps + 1 }
            }
        }
    }
}

impl StepReport {
    /// The report of a step that has finished, without times.
    pub(super) fn new(
        plan: &IterationPlan,
        gaussians: u32,
        [loss, l1, ssim]: [f32; 3],
        state: &State,
    ) -> Self {
        Self {
            iteration: plan.iteration,
            loss,
            l1,
            ssim,
            gaussians,
            visible: state.visible,
            instances: state.instances,
            longest_tile: state.longest_tile,
            samples: state.samples,
            skipped_non_finite: state.non_finite,
            view: plan.view,
            ..Self::default()
        }
    }
}

/// Loss, L1 and SSIM.
pub(super) fn read_losses(readback: &Buffer) -> Result<[f32; 3]> {
    let mut bytes = [0u8; 12];
    readback.read(0, &mut bytes)?;
    Ok(bytemuck::pod_read_unaligned(&bytes))
}
