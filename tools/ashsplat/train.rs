//! `ashsplat train`.

use crate::args::DeviceArguments;
use crate::config::{CAMERAS_FILE, CFG_ARGS_FILE, Overrides, SETTINGS_FILE, Settings};
use crate::eval::{self, Evaluation};
use crate::measure::{Cost, Stopwatch};
use crate::model::point_cloud_path;
use crate::progress::{State, TrainProgress, thousands};
use crate::{output, render, session};
use ashsplat::io::{self, Dataset, View};
use ashsplat::scene::Gaussians;
use ashsplat::trainer::{StepReport, TrainView, Trainer};
use ashsplat::vk::Context;
use ashsplat::{Error, Result};
use clap::Args;
use std::fmt::Write as _;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Train a scene from a COLMAP data set.
///
/// Names and defaults are those of the reference implementation; hyphens and underscores are both accepted.
/// Ctrl-C finishes the iteration, saves, and exits with 130.
#[derive(Args)]
pub struct Arguments {
    #[command(flatten)]
    overrides: Overrides,
    /// TOML file with any of these settings (as settings.toml in a model folder); the command line wins
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    #[command(flatten)]
    device: DeviceArguments,
    /// No progress; only results and errors
    #[arg(long)]
    quiet: bool,
}

/// Views of the training set that stand in for a test set where none is held out.
const STAND_IN_VIEWS: usize = 5;
/// After so many iterations the cost is taken once, for comparison with other trainers.
const FIRST_ITERATIONS: u32 = 100;

/// Runs the command.
pub fn run(arguments: &Arguments) -> Result<()> {
    let settings = Settings::resolve(arguments.config.as_deref(), &arguments.overrides)?;
    for (path, name) in
        [(&settings.data.source_path, "-s/--source-path"), (&settings.data.model_path, "-m/--model-path")]
    {
        if path.as_os_str().is_empty() {
            return Err(Error::argument(name, "is missing; give it here or in --config FILE"));
        }
    }
    // The device first: without one, nobody should wait for the photos.
    let context = arguments.device.context()?;
    let dataset = session::load(&settings.data, settings.train.white_background, arguments.quiet)?;
    let folder = settings.data.model_path.clone();
    let mut run = Run::prepare(&context, dataset, settings, arguments.quiet)?;
    let interrupted = run.train()?;
    run.report();
    say!("written to {}", folder.display());
    arguments.device.report_validation(&context);
    if interrupted { Err(Error::Interrupted) } else { Ok(()) }
}

/// The test after an iteration.
pub struct Tested {
    iteration: u32,
    gaussians: u32,
    pub evaluation: Evaluation,
}

/// One training run: the trainer, and everything that is written beside it.
pub struct Run {
    settings: Settings,
    trainer: Trainer,
    test: Vec<View>,
    /// Whether `test` was held out, or is a sample of the training views.
    held_out: bool,
    progress: TrainProgress,
    log: String,
    first: Option<Cost>,
    total: Option<Cost>,
    /// The tests so far.
    pub evaluations: Vec<Tested>,
    gaussians: u32,
    skipped: u64,
}

impl Run {
    /// Creates the trainer and the model folder with everything that is known before training.
    pub fn prepare(context: &Context, dataset: Dataset, settings: Settings, quiet: bool) -> Result<Run> {
        let points = dataset.initial_points(u64::from(settings.train.seed));
        let initial = Gaussians::from_points(&points, settings.train.sh_degree)?;
        let folder = &settings.data.model_path;
        io::atomic::create_folder(folder)?;
        // Results of an earlier run in this folder would be taken for this one's.
        output::remove(&folder.join(eval::RESULTS_FILE))?;
        output::remove(&folder.join(eval::PER_VIEW_FILE))?;
        output::write_text(&folder.join(SETTINGS_FILE), &settings.to_toml()?)?;
        output::write_text(&folder.join(CFG_ARGS_FILE), &settings.to_cfg_args())?;
        dataset.write_cameras_json(folder.join(CAMERAS_FILE))?;
        io::ply::write_points(folder.join("input.ply"), &points)?;
        let Dataset { train, test, scene_extent, .. } = dataset;
        let held_out = !test.is_empty();
        let test = if held_out { test } else { sample(&train) };
        let views =
            train.into_iter().map(|view| TrainView { camera: view.camera, photo: view.photo }).collect();
        let trainer = Trainer::new(context, views, &initial, scene_extent, settings.train.clone())?;
        Ok(Run {
            progress: TrainProgress::new(settings.train.iterations, quiet),
            settings,
            trainer,
            test,
            held_out,
            log: "iteration,loss,psnr,gaussians,ms,skipped\n".into(),
            first: None,
            total: None,
            evaluations: Vec::new(),
            gaussians: initial.len() as u32,
            skipped: 0,
        })
    }

    /// Trains to the end, or until Ctrl-C: then the answer is true. The log is written in any case.
    pub fn train(&mut self) -> Result<bool> {
        let stop = stop_on_ctrl_c()?;
        let result = self.iterate(&stop);
        self.progress.finish();
        output::write_text(&self.settings.data.model_path.join("train_log.csv"), &self.log)?;
        result
    }

    fn iterate(&mut self, stop: &AtomicBool) -> Result<bool> {
        let mut watch = Stopwatch::start();
        for _ in 0..self.settings.train.iterations {
            let report = self.trainer.step()?;
            let stopping = stop.load(Ordering::Relaxed);
            self.account(&report, &watch);
            let psnr = watch.paused(|| self.keep(report.iteration, stopping))?;
            self.log_line(&report, psnr);
            if stopping {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// Counts and shows an iteration.
    fn account(&mut self, report: &StepReport, watch: &Stopwatch) {
        let cost = watch.cost(report.iteration);
        if report.iteration <= FIRST_ITERATIONS {
            self.first = Some(cost);
        }
        self.total = Some(cost);
        self.gaussians = report.gaussians;
        self.skipped += u64::from(report.skipped_non_finite);
        self.progress.step(&State {
            iteration: report.iteration,
            loss: report.loss,
            gaussians: report.gaussians,
            memory_bytes: self.trainer.memory_bytes(),
        });
    }

    /// Tests and saves where it is time to; the PSNR where it was tested.
    fn keep(&mut self, iteration: u32, stopping: bool) -> Result<Option<f64>> {
        let last = iteration == self.settings.train.iterations;
        let data = &self.settings.data;
        if last || stopping || data.save_iterations.contains(&iteration) {
            let path = point_cloud_path(&data.model_path, iteration);
            output::make_way(&path)?;
            io::ply::write(&path, &self.trainer.gaussians()?)?;
            let reason = if stopping && !last { "interrupted: " } else { "" };
            self.progress.note(&format!("{reason}saved {}", path.display()));
        }
        if last || data.test_iterations.contains(&iteration) {
            return self.test(iteration).map(Some);
        }
        Ok(None)
    }

    /// Measures the test views; those that were held out are also saved.
    fn test(&mut self, iteration: u32) -> Result<f64> {
        let folder = &self.settings.data.model_path;
        let save_to = self.held_out.then(|| folder.join("test").join(format!("ours_{iteration}")));
        let settings = render::settings_of(&self.settings);
        let trainer = &mut self.trainer;
        let evaluation =
            eval::evaluate(&self.test, save_to.as_deref(), |camera| trainer.render(camera, &settings))?;
        if self.held_out {
            eval::write_results(folder, iteration, &evaluation)?;
        }
        let psnr = evaluation.psnr();
        self.progress.tested(psnr);
        let tested = Tested { iteration, gaussians: self.gaussians, evaluation };
        self.progress.note(&self.describe(&tested));
        self.evaluations.push(tested);
        Ok(psnr)
    }

    fn describe(&self, tested: &Tested) -> String {
        let Tested { iteration, gaussians, evaluation } = tested;
        let kind = if self.held_out { "held-out" } else { "training" };
        format!(
            "iteration {iteration}: PSNR {:.2} dB, SSIM {:.4} on {} {kind} views, {} Gaussians",
            evaluation.psnr(),
            evaluation.ssim(),
            evaluation.views.len(),
            thousands(u64::from(*gaussians)),
        )
    }

    fn log_line(&mut self, report: &StepReport, psnr: Option<f64>) {
        let psnr = psnr.map_or_else(String::new, |psnr| format!("{psnr:.4}"));
        let StepReport { iteration, loss, gaussians, milliseconds, skipped_non_finite, .. } = report;
        // Writing to a string cannot fail.
        writeln!(self.log, "{iteration},{loss},{psnr},{gaussians},{milliseconds:.2},{skipped_non_finite}")
            .ok();
    }

    /// Results and costs, on stdout.
    pub fn report(&self) {
        for tested in &self.evaluations {
            say!("{}", self.describe(tested));
        }
        if let Some(first) = self.first {
            say!("first {} iterations: {first}", first.iterations);
        }
        if let Some(total) = self.total {
            say!("all {} iterations: {total}, {:.1} s", total.iterations, total.seconds);
        }
        if self.skipped > 0 {
            say!("{} updates with a gradient that is not finite were skipped", thousands(self.skipped));
        }
    }

    /// The trained scene.
    pub fn trainer(&mut self) -> &mut Trainer {
        &mut self.trainer
    }

    /// What the run was made with.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// Number of Gaussians after the last iteration.
    pub fn gaussians(&self) -> u32 {
        self.gaussians
    }

    /// The views that are tested.
    pub fn test_views(&self) -> &[View] {
        &self.test
    }
}

/// A few of the training views, evenly spread.
fn sample(train: &[View]) -> Vec<View> {
    let step = train.len().div_ceil(STAND_IN_VIEWS).max(1);
    train.iter().step_by(step).cloned().collect()
}

/// A flag that Ctrl-C raises; a second Ctrl-C ends the program at once.
fn stop_on_ctrl_c() -> Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    let flag = stop.clone();
    let handler = move || {
        if flag.swap(true, Ordering::Relaxed) {
            std::process::exit(i32::from(crate::INTERRUPTED));
        }
    };
    ctrlc::set_handler(handler).map_err(|e| Error::argument("Ctrl-C", format!("cannot be caught: {e}")))?;
    Ok(stop)
}
