//! `bench render` and `bench train-step`.

use super::measure::{Iterations, Measured, Measurement, measure};
use super::schema::{CopyBandwidth, Run, Workload};
use super::traffic::{Counts, Traffic};
use super::workload::Scene;
use super::{forms, synthetic};
use ashsplat::frame::ScenePlan;
use ashsplat::vk::Context;
use ashsplat::{
    Blending, FrameStats, Gaussians, RenderSettings, Renderer, Result, StepReport, TrainSettings, TrainView,
    Trainer,
};
use ashsplat_files::Photo;

/// Parameters of both commands.
#[derive(Clone, Copy)]
pub struct Job<'a> {
    pub context: &'a Context,
    pub iterations: Iterations,
    pub copy: Option<&'a CopyBandwidth>,
    pub scene: &'a Scene,
    /// None: the device's default.
    pub blending: Option<Blending>,
    pub seed: u64,
}

impl Job<'_> {
    fn run(&self, name: &str, workload: Workload, measured: &Measured, counts: Counts) -> Run {
        result(self.context, name, workload, measured, counts, self.copy)
    }

    fn rendered(
        &self,
        name: &str,
        (stats, workload): (&FrameStats, Workload),
        form: Blending,
        measured: &Measured,
    ) -> Result<Run> {
        let (g, size) = (&self.scene.gaussians, (self.scene.camera.width, self.scene.camera.height));
        let counts = counts(self.context, (g.len() as u32, stats.gaussians), g.sh_degree, size)?;
        let counts = counts.seen(stats.visible, stats.instances);
        let workload = Workload {
            longest_tile: Some(stats.longest_tile),
            blending: Some(forms::name(form).to_owned()),
            ..workload
        };
        Ok(self.run(name, workload, measured, counts))
    }
}

/// Counts of a frame of this size, without its visible Gaussians and instances. `gaussians`: number and capacity.
fn counts(
    context: &Context,
    (gaussians, capacity): (u32, u32),
    sh_degree: u32,
    (width, height): (u32, u32),
) -> Result<Counts> {
    let plan = ScenePlan::new(context.limits(), capacity, sh_degree)?;
    let chunks = plan.ranges(gaussians).count() as u64;
    Ok(Counts { gaussians, visible: 0, instances: 0, width, height, sh_degree, chunks })
}

/// Counts of a training step.
pub fn step_counts(
    context: &Context,
    report: &StepReport,
    sh_degree: u32,
    size: (u32, u32),
) -> Result<Counts> {
    let count = report.gaussians;
    let capacity = count.saturating_add(count / 2).max(1 << 12);
    Ok(counts(context, (count, capacity), sh_degree, size)?.seen(report.visible, report.instances))
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

/// Name of a frame's run, by whether its picture is read back.
fn frame_name(iterations: Iterations) -> &'static str {
    if iterations.reads_back { "render" } else { "draw" }
}

fn frame(renderer: &mut Renderer, job: &Job, settings: &RenderSettings) -> Result<FrameStats> {
    let camera = &job.scene.camera;
    match job.iterations.reads_back {
        true => renderer.render(camera, settings).map(|frame| frame.stats),
        false => renderer.draw(camera, settings),
    }
}

/// The renderer of a scene. `form`: None for the device's default.
pub fn renderer(context: &Context, scene: &Scene, form: Option<Blending>) -> Result<Renderer> {
    let mut renderer = Renderer::new(context)?;
    if let Some(form) = form {
        renderer.set_blending(form);
    }
    renderer.upload(&scene.gaussians)?;
    Ok(renderer)
}

/// Measures a frame. Returns the run and its measurement.
pub fn render(job: &Job) -> Result<(Run, Measured)> {
    let mut renderer = renderer(job.context, job.scene, job.blending)?;
    let settings = RenderSettings::default();
    let mut stats = FrameStats::default();
    let iterate = || {
        stats = frame(&mut renderer, job, &settings)?;
        Ok(())
    };
    let measured = measure(job.context, job.iterations, || Ok(()), iterate)?;
    let workload = job.scene.workload(&settings);
    Ok((
        job.rendered(frame_name(job.iterations), (&stats, workload), renderer.blending(), &measured)?,
        measured,
    ))
}

/// Measures a frame in both forms of blending, in turn.
pub fn render_both(job: &Job) -> Result<Vec<Run>> {
    let mut renderer = renderer(job.context, job.scene, None)?;
    let settings = RenderSettings::default();
    let mut stats = FrameStats::default();
    let mut blended = |blending: Blending| {
        renderer.set_blending(blending);
        stats = frame(&mut renderer, job, &settings)?;
        Ok(())
    };
    job.context.reset_memory_peaks();
    let mut both = Vec::new();
    for form in Blending::ALL {
        let measurement = Measurement::begin(job.context, job.iterations, || Ok(()), || blended(form))?;
        both.push((form, measurement));
    }
    for round in 0..job.iterations.measured.max(1) {
        // The two forms take turns at being first.
        for turn in [round, round + 1] {
            let (form, measurement) = &mut both[turn as usize % 2];
            measurement.round(|| Ok(()), || blended(*form))?;
        }
    }
    let workload = job.scene.workload(&settings);
    let run = |(form, measurement): (Blending, Measurement)| {
        let name = format!("{}-{}", frame_name(job.iterations), forms::name(form));
        job.rendered(&name, (&stats, workload.clone()), form, &measurement.end())
    };
    both.into_iter().map(run).collect()
}

/// Settings that make every step the same work: full SH degree, no densification.
pub fn steady_settings(sh_degree: u32, seed: u64) -> TrainSettings {
    TrainSettings {
        sh_degree,
        sh_degree_interval: 1,
        densify_until_iter: 0,
        opacity_reset_interval: u32::MAX,
        seed: seed as u32,
        ..TrainSettings::reference()
    }
}

/// Gaussians that the training of a scene starts from.
pub fn start(scene: &Scene, seed: u64) -> Gaussians {
    match &scene.view {
        Some(_) => scene.gaussians.clone(),
        None => synthetic::disturbed(&scene.gaussians, seed),
    }
}

/// The trainer of a scene, after steps that reach the full SH degree. A synthetic scene starts disturbed, and is trained on its own
/// picture.
pub fn trainer(context: &Context, scene: &Scene, form: Option<Blending>, seed: u64) -> Result<Trainer> {
    let view = match &scene.view {
        Some(view) => view.clone(),
        None => {
            let frame = renderer(context, scene, None)?.render(&scene.camera, &RenderSettings::default())?;
            let photo = Photo::from_f32(frame.width, frame.height, &frame.color)?;
            TrainView::new(scene.camera, photo)
        }
    };
    let settings = steady_settings(scene.gaussians.sh_degree, seed);
    let mut trainer = Trainer::new(context, vec![view], &start(scene, seed), scene.scene_extent, settings)?;
    if let Some(form) = form {
        trainer.set_blending(form);
    }
    for _ in 0..=scene.gaussians.sh_degree {
        trainer.step()?;
    }
    Ok(trainer)
}

/// Measures a training step (forward, loss, backward, Adam). Returns the run and its measurement.
pub fn train_step(job: &Job) -> Result<(Run, Measured)> {
    let mut trainer = trainer(job.context, job.scene, job.blending, job.seed)?;
    let mut report = StepReport::default();
    let iterate = || {
        report = trainer.step()?;
        Ok(())
    };
    let measured = measure(job.context, job.iterations, || Ok(()), iterate)?;
    let camera = &job.scene.camera;
    let degree = job.scene.gaussians.sh_degree;
    let counts = step_counts(job.context, &report, degree, (camera.width, camera.height))?;
    let workload = job.scene.training_workload(&trainer.render_settings(), job.seed);
    let blending = Some(forms::name(trainer.blending()).to_owned());
    let workload = Workload { longest_tile: Some(report.longest_tile), blending, ..workload };
    Ok((job.run("train-step", workload, &measured, counts), measured))
}
