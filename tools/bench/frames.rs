//! A frame or a training step that is run again and again: `bench render`, `train-step`, and `profile`.

use super::measure::{self, Iteration, Iterations, Measured};
use super::schema::{CopyBandwidth, Run, Workload};
use super::traffic::{Counts, Traffic};
use super::workload::{Scene, Storage};
use super::{forms, synthetic};
use ashsplat::frame::ScenePlan;
use ashsplat::vk::{Context, Profile};
use ashsplat::{
    BlendSamples, Blending, FrameStats, RenderSettings, Renderer, Result, StepReport, TrainSettings,
    TrainView, Trainer,
};
use ashsplat_files::Photo;
use clap::ValueEnum;
use std::rc::Rc;

/// Unit of work of a measurement.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum IterationKind {
    /// A frame
    Render,
    /// A training step
    TrainStep,
}

impl IterationKind {
    pub fn name(self) -> &'static str {
        match self {
            Self::Render => "render",
            Self::TrainStep => "train-step",
        }
    }
}

#[derive(Clone)]
pub struct Plan {
    pub what: IterationKind,
    pub scene: Rc<Scene>,
    /// None for the device's default.
    pub form: Option<Blending>,
    /// True if a frame's picture is read back.
    pub reads_back: bool,
    pub seed: u64,
}

pub struct PlannedWork<'a> {
    context: &'a Context,
    plan: &'a Plan,
    runner: Runner,
    /// Statistics of the last iteration.
    stats: IterationStats,
}

enum Runner {
    Frame(Box<Renderer>),
    Step(Box<Trainer>),
}

#[derive(Clone, Copy, Default)]
struct IterationStats {
    gaussians: u32,
    visible: u32,
    instances: u32,
    longest_tile: u32,
    samples: BlendSamples,
}

impl<'a> PlannedWork<'a> {
    /// Builds the kernels and loads the scene.
    pub fn new(context: &'a Context, plan: &'a Plan) -> Result<Self> {
        let mut runner = match plan.what {
            IterationKind::Render => Runner::Frame(Box::new(renderer(context, &plan.scene)?)),
            IterationKind::TrainStep => Runner::Step(Box::new(trainer(context, plan)?)),
        };
        match (plan.form, &mut runner) {
            (Some(form), Runner::Frame(renderer)) => renderer.set_blending(form),
            (Some(form), Runner::Step(trainer)) => trainer.set_blending(form),
            (None, _) => {}
        }
        Ok(Self { context, plan, runner, stats: IterationStats::default() })
    }

    fn blending(&self) -> Blending {
        match &self.runner {
            Runner::Frame(renderer) => renderer.blending(),
            Runner::Step(trainer) => trainer.blending(),
        }
    }

    /// Runs one iteration.
    pub fn iterate(&mut self) -> Result<()> {
        let (camera, settings) = (&self.plan.scene.camera, RenderSettings::default());
        self.stats = match &mut self.runner {
            Runner::Frame(renderer) => {
                let stats = match self.plan.reads_back {
                    true => renderer.render(camera, &settings)?.stats,
                    false => renderer.draw(camera, &settings)?,
                };
                let FrameStats { gaussians, visible, instances, longest_tile, samples, .. } = stats;
                IterationStats { gaussians, visible, instances, longest_tile, samples }
            }
            Runner::Step(trainer) => {
                let StepReport { gaussians, visible, instances, longest_tile, samples, .. } =
                    trainer.step()?;
                IterationStats { gaussians, visible, instances, longest_tile, samples }
            }
        };
        Ok(())
    }

    /// Counts the samples of an iteration; the context must have `COUNT_HITS`.
    pub fn samples(mut self) -> Result<BlendSamples> {
        self.iterate().map(|()| self.stats.samples)
    }

    /// Runs unmeasured iterations, in which buffers grow and caches fill.
    pub fn warm_up(&mut self, iterations: u32) -> Result<()> {
        (0..iterations).try_for_each(|_| self.iterate())
    }

    pub fn timed(&mut self, profile: &Profile) -> Result<Iteration> {
        let context = self.context;
        Iteration::timed(context, profile, || self.iterate())
    }

    pub fn picture(&mut self) -> Result<Vec<[f32; 3]>> {
        let (camera, settings) = (&self.plan.scene.camera, RenderSettings::default());
        let frame = match &mut self.runner {
            Runner::Frame(renderer) => renderer.render(camera, &settings)?,
            Runner::Step(trainer) => trainer.render(camera, &settings)?,
        };
        Ok(frame.color)
    }

    fn run(&self, measured: &Measured, copy: Option<&CopyBandwidth>) -> Result<Run> {
        let Plan { scene, reads_back, seed, .. } = self.plan;
        let (g, camera, stats) = (&scene.gaussians, &scene.camera, self.stats);
        let (name, workload, gaussians) = match &self.runner {
            Runner::Frame(_) => {
                let name = if *reads_back { "render" } else { "draw" };
                (name, scene.workload(&RenderSettings::default(), &[]), [g.len() as u32, stats.gaussians])
            }
            Runner::Step(trainer) => {
                // Step sizes depend on the extent; the seed disturbs a scene that is trained on its own picture.
                let disturbed_by = scene.view.is_none().then_some(*seed);
                let more = format!("{} {disturbed_by:?}", scene.scene_extent);
                let workload = scene.workload(&trainer.render_settings(), more.as_bytes());
                ("train-step", workload, trained(stats.gaussians))
            }
        };
        let counts =
            counts(self.context, gaussians, g.sh_degree, (camera.width, camera.height), scene.storage)?;
        let counts = counts.with_stats(stats.visible, stats.instances);
        let workload = Workload {
            longest_tile: Some(stats.longest_tile),
            blending: Some(forms::name(self.blending()).to_owned()),
            ..workload
        };
        Ok(result(self.context, name, workload, measured, counts, copy))
    }
}

/// Measures a frame or a step.
pub fn measure(
    context: &Context,
    plan: &Plan,
    iterations: Iterations,
    copy: Option<&CopyBandwidth>,
) -> Result<(Run, Measured)> {
    let mut planned = PlannedWork::new(context, plan)?;
    let measured = measure::measure(context, iterations, || Ok(()), || planned.iterate())?;
    Ok((planned.run(&measured, copy)?, measured))
}

/// Number and capacity of the Gaussians of a training.
fn trained(gaussians: u32) -> [u32; 2] {
    [gaussians, gaussians.saturating_add(gaussians / 2).max(1 << 12)]
}

/// Counts of a frame of this size, without its visible Gaussians and instances. `gaussians`: number and capacity.
fn counts(
    context: &Context,
    [gaussians, capacity]: [u32; 2],
    sh_degree: u32,
    (width, height): (u32, u32),
    storage: Storage,
) -> Result<Counts> {
    let sh_storage = storage.sh_storage;
    let plan = ScenePlan::new(context.limits(), capacity, sh_degree, sh_storage)?;
    let chunks = plan.ranges(gaussians).count() as u64;
    let packed_moments = storage.packed_moments;
    let counts = Counts {
        gaussians,
        width,
        height,
        sh_degree,
        sh_storage,
        packed_moments,
        chunks,
        ..Counts::default()
    };
    Ok(counts)
}

pub fn step_counts(
    context: &Context,
    report: &StepReport,
    sh_degree: u32,
    size: (u32, u32),
) -> Result<Counts> {
    let counts = counts(context, trained(report.gaussians), sh_degree, size, Storage::default())?;
    Ok(counts.with_stats(report.visible, report.instances))
}

pub fn result(
    context: &Context,
    name: &str,
    workload: Workload,
    measured: &Measured,
    counts: Counts,
    copy: Option<&CopyBandwidth>,
) -> Run {
    let traffic = Traffic::of_frame(context.limits(), counts);
    let workload = Workload { visible: Some(counts.visible), instances: Some(counts.instances), ..workload };
    measured.run(context, name, workload, (&traffic, copy))
}

pub fn renderer(context: &Context, scene: &Scene) -> Result<Renderer> {
    let mut renderer = Renderer::new(context)?;
    renderer.upload_stored(&scene.gaussians, scene.storage.sh_storage)?;
    Ok(renderer)
}

/// Settings that make every step the same work: full SH degree, no densification.
fn steady_settings(sh_degree: u32, seed: u64) -> TrainSettings {
    TrainSettings {
        sh_degree,
        sh_degree_interval: 1,
        densify_until_iter: 0,
        opacity_reset_interval: u32::MAX,
        seed: seed as u32,
        ..TrainSettings::reference()
    }
}

/// The trainer of a scene, after steps that reach the full SH degree. A scene without a photo starts disturbed, and is
/// trained on its own picture.
fn trainer(context: &Context, plan: &Plan) -> Result<Trainer> {
    let Plan { scene, seed, .. } = plan;
    let (start, view) = match &scene.view {
        Some(view) => (scene.gaussians.clone(), view.clone()),
        None => {
            let frame = renderer(context, scene)?.render(&scene.camera, &RenderSettings::default())?;
            let photo = Photo::from_f32(frame.width, frame.height, &frame.color)?;
            (synthetic::disturbed(&scene.gaussians, *seed), TrainView::new(scene.camera, photo))
        }
    };
    let settings = TrainSettings {
        moments: scene.storage.moments(),
        sh_storage: scene.storage.sh_storage,
        ..steady_settings(scene.gaussians.sh_degree, *seed)
    };
    let mut trainer = Trainer::new(context, vec![view], &start, scene.scene_extent, settings)?;
    for _ in 0..=scene.gaussians.sh_degree {
        trainer.step()?;
    }
    Ok(trainer)
}
