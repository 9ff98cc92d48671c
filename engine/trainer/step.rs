//! One iteration.

use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::{Densified, StepReport, Trainer};
use crate::backward::Statistics;
use crate::error::{Error, Result};
use crate::forward::{FrameInputs, RenderSettings};
use crate::loss::LossInputs;
use crate::optimizer::{Rates, Step};
use crate::renderer::{Ran, Request};
use crate::vk::Recorder;

/// Streams of random numbers of a run, all from its seed.
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

    /// The view of an iteration, from 1: depends on nothing but the seed and the iteration.
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
    // A counter's numbers are 2^20 words apart: far more than anybody draws.
    rng.set_word_pos(u128::from(counter) << 20);
    rng
}

/// What an iteration leaves to be done before the next.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Due {
    pub densifies: bool,
    pub resets: bool,
}

/// What an iteration does behind the backward pass.
#[derive(Clone, Copy)]
struct Plan {
    collects: bool,
    densifies: bool,
    resets: bool,
    optimizes: bool,
}

impl Trainer {
    /// Runs one iteration.
    ///
    /// # Errors
    /// When memory does not suffice: the Gaussians are then as before the iteration, and it may be tried again. When the
    /// device is lost or too slow ([`Error::DeviceLost`], [`Error::Timeout`]): what has become of them is unknown, and
    /// every later step is refused; go on from a checkpoint.
    pub fn step(&mut self) -> Result<StepReport> {
        if self.broken {
            let problem = "an earlier step was not finished; go on from a checkpoint, or anew";
            return Err(Error::argument("trainer", problem));
        }
        let result = self.run_iteration();
        // What went wrong while waiting may or may not have been done.
        self.broken = match &result {
            Err(Error::DeviceLost { .. } | Error::Timeout { .. }) => true,
            Err(Error::Vulkan { call, .. }) => *call == "vkWaitForFences",
            _ => false,
        };
        result
    }

    fn run_iteration(&mut self) -> Result<StepReport> {
        let start = std::time::Instant::now();
        let densified = self.catch_up()?;
        let iteration = self.iteration + 1;
        let s = &self.settings;
        let plan = Plan {
            collects: s.collects_statistics_at(iteration),
            densifies: s.densifies_at(iteration),
            resets: s.resets_opacity_at(iteration),
            // The reference's parameters lose their gradient when densification replaces them, and its last iteration
            // only saves.
            optimizes: !s.densifies_at(iteration) && iteration < s.iterations,
        };
        let view = self.order.view(iteration);
        self.photos.prepare(&self.context, iteration)?;
        let ran = self.run_step(iteration, view, plan)?;
        if plan.optimizes {
            self.steps += 1;
            self.opacity_steps += u64::from(!plan.resets);
        }
        self.iteration = iteration;
        self.due = Due { densifies: plan.densifies, resets: plan.resets };
        let [loss, l1, ssim] = self.read_loss()?;
        Ok(StepReport {
            iteration,
            loss,
            l1,
            ssim,
            gaussians: self.training.scene.count,
            visible: ran.state.visible,
            instances: ran.state.instances,
            longest_tile: ran.state.longest_tile,
            samples: ran.state.samples,
            skipped_non_finite: ran.state.non_finite,
            milliseconds: start.elapsed().as_secs_f64() * 1e3,
            view,
            densified,
            scopes: ran.report.scopes,
        })
    }

    /// Densifies and resets as the iteration before asked for. The reference tests and saves before it does so: between
    /// steps, the scene is what it would save.
    fn catch_up(&mut self) -> Result<Option<Densified>> {
        let mut densified = None;
        if self.due.densifies {
            densified = Some(self.run_densification(self.iteration)?);
            self.due.densifies = false;
        }
        if self.due.resets {
            self.run_opacity_reset()?;
            self.due.resets = false;
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

    fn rates(&self, iteration: u32, plan: Plan) -> Rates {
        let s = &self.settings;
        Rates {
            mean: s.position_lr(iteration) * f64::from(self.scene_extent),
            // A reset replaces the opacities, which then have no gradient in the reference.
            opacity: if plan.resets { 0.0 } else { s.opacity_lr },
            quat: s.rotation_lr,
            log_scale: s.scaling_lr,
            sh_dc: s.feature_lr,
            sh_rest: s.feature_rest_lr(),
        }
    }

    /// Forward, loss, backward and the optimiser's step in one submission.
    fn run_step(&mut self, iteration: u32, view: usize, plan: Plan) -> Result<Ran> {
        let sh_degree = self.settings.sh_degree_at(iteration);
        let settings = RenderSettings { background: self.background(iteration), ..self.render_settings() };
        let step = self.optimizer_step(iteration, plan);
        self.backward.prepare(sh_degree, settings.inverse_depth)?;
        self.optimizer.prepare(sh_degree)?;
        let Self {
            runner,
            loss,
            masked_loss,
            backward,
            optimizer,
            training,
            scratch,
            photos,
            cameras,
            settings: s,
            ..
        } = self;
        let camera = &cameras[view];
        let loss = if photos.is_masked(view) { masked_loss.as_ref().unwrap_or(loss) } else { loss };
        let statistics = Statistics { buffer: &training.statistics, accumulate: plan.collects };
        let record = |r: &mut Recorder, inputs: &FrameInputs| {
            r.barrier();
            let f = inputs.frame;
            loss.record(
                r,
                &LossInputs {
                    accumulated: &f.accumulated,
                    photo: photos.of(view),
                    derivatives: &scratch.derivatives,
                    partials: &scratch.partials,
                    losses: &scratch.losses,
                    slot: 0,
                    image_gradient: &f.image_gradient,
                    width: camera.width,
                    height: camera.height,
                    background: settings.background,
                    lambda_dssim: s.lambda_dssim as f32,
                },
            );
            r.barrier();
            backward.record(r, inputs, statistics);
            if plan.optimizes {
                r.barrier();
                optimizer.record(r, inputs, &training.moments, &step);
            }
            r.copy(&scratch.losses, &scratch.readback);
            Ok(())
        };
        let request =
            Request { scene: &training.scene, camera, settings: &settings, sh_degree, backward: true };
        runner.run(&request, record)
    }

    fn optimizer_step(&self, iteration: u32, plan: Plan) -> Step {
        let rates = self.rates(iteration, plan);
        match self.settings.optimizer_type {
            super::OptimizerType::SparseAdam => Step { rates, count: 0, opacity_count: 0 },
            super::OptimizerType::Default => {
                Step { rates, count: self.steps + 1, opacity_count: self.opacity_steps + 1 }
            }
        }
    }

    fn read_loss(&self) -> Result<[f32; 3]> {
        let mut bytes = [0u8; 12];
        self.scratch.readback.read(0, &mut bytes)?;
        Ok(bytemuck::pod_read_unaligned(&bytes))
    }
}
