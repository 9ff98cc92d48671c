//! `bench render` and `bench train-step`.

use super::measure::{Iterations, Measured, measure, memory};
use super::schema::{CopyBandwidth, Run, Workload};
use super::synthetic;
use super::traffic::{Counts, Traffic};
use super::workload::Scene;
use ashsplat::io::Photo;
use ashsplat::plan::ScenePlan;
use ashsplat::vk::Context;
use ashsplat::{FrameStats, RenderSettings, Renderer, Result, StepReport, TrainSettings, TrainView, Trainer};

/// What both are given.
#[derive(Clone, Copy)]
pub struct Job<'a> {
    pub context: &'a Context,
    pub iterations: Iterations,
    pub copy: Option<&'a CopyBandwidth>,
    pub scene: &'a Scene,
    pub seed: u64,
}

impl Job<'_> {
    fn counts(&self, visible: u32, instances: u32, capacity: u32) -> Result<Counts> {
        let gaussians = self.scene.gaussians.len() as u32;
        let sh_degree = self.scene.gaussians.sh_degree;
        let plan = ScenePlan::new(self.context.limits(), capacity, sh_degree)?;
        let chunks = plan.ranges(gaussians).count() as u64;
        let (width, height) = (self.scene.camera.width, self.scene.camera.height);
        Ok(Counts { gaussians, visible, instances, width, height, sh_degree, chunks })
    }

    fn run(&self, name: &str, workload: Workload, measured: &Measured, counts: Counts) -> Run {
        let traffic = Traffic::of_frame(self.context.limits(), counts);
        Run {
            name: name.to_owned(),
            workload: Workload {
                visible: Some(counts.visible),
                instances: Some(counts.instances),
                ..workload
            },
            wall_ms: measured.wall_ms(),
            device_ms: measured.device_ms(),
            split: measured.split(),
            between_submissions_ms: measured.between_submissions_ms(),
            cpu_seconds: measured.cpu_seconds,
            cost_of_measuring: measured.cost,
            kernels: measured.kernels(&traffic, self.copy),
            memory: memory(self.context),
            cpu: Vec::new(),
        }
    }
}

/// A frame, read back, and how it was measured.
pub fn render(job: &Job) -> Result<(Run, Measured)> {
    let mut renderer = Renderer::new(job.context)?;
    renderer.upload(&job.scene.gaussians)?;
    let settings = RenderSettings::default();
    let mut stats = FrameStats::default();
    let iterate = || {
        stats = renderer.render(&job.scene.camera, &settings)?.stats;
        Ok(())
    };
    let measured = measure(job.context, job.iterations, || Ok(()), iterate)?;
    let counts = job.counts(stats.visible, stats.instances, stats.gaussians)?;
    let workload = Workload { longest_tile: Some(stats.longest_tile), ..job.scene.workload(&settings) };
    Ok((job.run("render", workload, &measured, counts), measured))
}

/// Settings that make every step the same work: full SH degree, no densification.
pub fn steady_settings(sh_degree: u32, seed: u64) -> TrainSettings {
    TrainSettings {
        sh_degree,
        sh_degree_interval: 1,
        densify_until_iter: 0,
        opacity_reset_interval: u32::MAX,
        seed: seed as u32,
        ..TrainSettings::default()
    }
}

/// The trainer of a scene. A synthetic scene is trained, from a disturbed state, on a picture of itself.
pub fn trainer(context: &Context, scene: &Scene, seed: u64) -> Result<Trainer> {
    let (view, start) = match &scene.view {
        Some(view) => (view.clone(), scene.gaussians.clone()),
        None => {
            let mut renderer = Renderer::new(context)?;
            renderer.upload(&scene.gaussians)?;
            let frame = renderer.render(&scene.camera, &RenderSettings::default())?;
            let photo = Photo::from_f32(frame.width, frame.height, &frame.color)?;
            (TrainView { camera: scene.camera, photo }, synthetic::disturbed(&scene.gaussians, seed))
        }
    };
    let settings = steady_settings(scene.gaussians.sh_degree, seed);
    Trainer::new(context, vec![view], &start, scene.scene_extent, settings)
}

/// Steps until the full SH degree is in use.
pub fn reach_full_degree(trainer: &mut Trainer) -> Result<()> {
    for _ in 0..=trainer.settings().sh_degree {
        trainer.step()?;
    }
    Ok(())
}

/// A training step (forward, loss, backward, Adam), and how it was measured.
pub fn train_step(job: &Job) -> Result<(Run, Measured)> {
    let mut trainer = trainer(job.context, job.scene, job.seed)?;
    reach_full_degree(&mut trainer)?;
    let mut report = StepReport::default();
    let iterate = || {
        report = trainer.step()?;
        Ok(())
    };
    let measured = measure(job.context, job.iterations, || Ok(()), iterate)?;
    let count = report.gaussians;
    let counts =
        job.counts(report.visible, report.instances, count.saturating_add(count / 2).max(1 << 12))?;
    let workload = job.scene.workload(&trainer.render_settings());
    Ok((job.run("train-step", workload, &measured, counts), measured))
}
