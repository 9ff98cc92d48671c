//! `ashsplat train`.

mod accounting;
mod allowance;
mod checkpoints;
mod folder;
#[cfg(feature = "view")]
mod live;
#[cfg(not(feature = "view"))]
#[path = "train/no_viewers.rs"]
mod live;
mod outside;
mod poses;
mod prepared;
mod refined;
mod report;
mod rounds;
mod saving;
mod testing;
#[cfg(test)]
mod tests;
mod tracking;
mod training_start;
mod verify;

use accounting::Effect;
use ashsplat::frame::to_u32;
use ashsplat::passes::lpips::Weights;
use ashsplat::train::{StrategyType, TrainSettings, Trainer};
use ashsplat::vk::Context;
use ashsplat::{Error, Result};
use ashsplat_files::Dataset;
use ashsplat_program::args::{DeviceArguments, bytes};
use ashsplat_program::blocks::job::Job;
use ashsplat_program::blocks::result;
use ashsplat_program::config::{DefaultsInput, Overrides, Settings, SettingsSources};
use ashsplat_program::eval::read_weights;
use ashsplat_program::lock::FolderLock;
use ashsplat_program::measure::{Cost, Stopwatch};
use ashsplat_program::progress::TrainProgress;
use ashsplat_program::session;
use ashsplat_program::train_log::{LOG_FILE, TrainLog};
use checkpoints::StartFrom;
use clap::{Arg, Args, value_parser};
use glam::DVec3;
use live::{Live, LiveArguments};
use prepared::{Views, photo_memory};
pub use report::print_next_steps;
use report::{KernelTimes, print_complete};
use saving::SaveRetries;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use testing::Tested;
use tracking::Tracking;
use training_start::{RunStart, check_fits};

/// Train a scene from a data set: photos with a COLMAP model or a transforms.json, or a ZIP of them.
///
/// Names of options are those of the reference implementation, with hyphens or underscores. Its settings are --preset reference;
/// the defaults are those that measured best.
/// Ctrl-C finishes the iteration, saves, writes a checkpoint, and exits with 130. When an iteration fails,
/// the scene before it is saved and a checkpoint written. The scene is not saved if its opacities were
/// already reset. Neither is saved if the device is lost or too slow, because the state of the Gaussians is
/// then unknown. A run that resumes from a checkpoint ends with the same bits as one that was never stopped.
#[derive(Args)]
#[command(mut_args(in_short_help), after_help = EXAMPLES)]
pub struct Arguments {
    #[command(flatten)]
    overrides: Overrides,
    /// TOML file with any of these settings (as settings.toml in a model folder); the command line wins
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Continue from this checkpoint, or from the newest of the model folder; all other settings must be unchanged. auto:
    /// from the newest, or from the start if there is none
    #[arg(long, value_name = "FILE|latest|auto", value_parser = value_parser!(StartFrom))]
    start_checkpoint: Option<StartFrom>,
    /// Most memory for photos, with a unit: 800M, 6G; the other photos are read during training, with the same result:
    /// unscaled JPEGs from their files, the rest from a file beside the model folder [default: half of the device's memory or
    /// of --max-memory]
    #[arg(long, value_name = "SIZE", value_parser = bytes)]
    photo_memory: Option<u64>,
    /// Keep parameters and Adam's moments in the machine's memory, at most SIZE of it, for scenes that are larger than the device:
    /// slower, with the same result [default of SIZE: --max-host-memory, else three quarters of what is free]
    #[arg(long, value_name = "SIZE", value_parser = bytes, num_args = 0..=1)]
    offload: Option<Option<u64>>,
    /// Instead of training: run N iterations twice, compare hashes after each, and name the first kernel whose output differs
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    verify_determinism: Option<u32>,
    /// Largest share of training's time for measuring PSNR during training, 0.001 to 0.9: the mean over the same few
    /// held-out views each time; 0 measures only after --test-iterations
    #[arg(long, value_name = "SHARE", default_value_t = tracking::SHARE, value_parser = tracking::share)]
    eval_share: f64,
    /// Wait while another training writes into the model folder, instead of failing: a scheduler may retry while its first
    /// try still runs. The folder need not exist yet
    #[arg(long)]
    wait: bool,
    #[command(flatten, next_help_heading = "Viewers of the running training")]
    live: LiveArguments,
    #[command(flatten, next_help_heading = "Device and memory")]
    device: DeviceArguments,
    /// No progress; only results and errors
    #[arg(long)]
    quiet: bool,
}

const EXAMPLES: &str = "Examples:
  ashsplat train -s my_scene -m out/my_scene --eval
  ashsplat train -s my_scene -m out/first_look --eval -r 400 --iterations 600
  ashsplat train -s my_scene -m out/my_scene --preset quality --exposure --view
  ashsplat train --config out/my_scene/settings.toml --start-checkpoint latest";

/// Options that `-h` lists; `--help` lists all.
const COMMON: [&str; 26] = [
    "source_path",
    "model_path",
    "preset",
    "resolution",
    "eval",
    "few_photos",
    "init",
    "test_iterations",
    "checkpoint_every",
    "start_checkpoint",
    "config",
    "iterations",
    "sh_degree",
    "cap_max",
    "exposure",
    "pose_opt",
    "lens_opt",
    "white_background",
    "antialiasing",
    "seed",
    "view",
    "device",
    "max_memory",
    "photo_memory",
    "quiet",
    "help",
];

fn in_short_help(argument: Arg) -> Arg {
    let is_common = COMMON.contains(&argument.get_id().as_str());
    argument.hide_short_help(!is_common)
}

/// Number of iterations after which the cost is noted, for comparison with other trainers.
const FIRST_ITERATIONS: u32 = 100;

pub fn run(arguments: &Arguments) -> Result<()> {
    let given = SettingsSources::read(arguments.config.as_deref(), &arguments.overrides)?;
    let settings = given.settle(&DefaultsInput::default())?;
    if settings.train.lens_opt && settings.data.undistort {
        let problem = "does not go together with --undistort, whose photographs are those of a pinhole";
        return Err(Error::argument("--lens-opt", problem));
    }
    for (path, name) in
        [(&settings.data.source_path, "-s/--source-path"), (&settings.data.model_path, "-m/--model-path")]
    {
        // Verification writes nothing, and reads at most the newest checkpoint.
        let newest = matches!(arguments.start_checkpoint, Some(StartFrom::Latest | StartFrom::Auto));
        let unused = arguments.verify_determinism.is_some() && !newest && name.starts_with("-m");
        if path.as_os_str().is_empty() && !unused {
            return Err(Error::argument(name, "is missing; give it here or in --config FILE"));
        }
    }
    let job = Job::of(&settings.data.job)?;
    // Ctrl-C is handled before a ZIP is unpacked, so that no unpacked files remain.
    let stop = session::stop_on_ctrl_c()?;
    let writes = arguments.verify_determinism.is_none();
    let model = &settings.data.model_path;
    let held = if writes { folder::hold(model, arguments.wait, &stop)? } else { None };
    let is_asked_again = arguments.start_checkpoint == Some(StartFrom::Auto);
    if writes && is_asked_again && job.as_ref().is_some_and(result::is_done) {
        return print_complete(&settings);
    }
    let round = rounds::current_round(job.as_ref(), &settings)?;
    if let Some(round) = round.as_ref().filter(|round| writes && is_asked_again && round.is_done) {
        round.print_done();
        return Ok(());
    }
    let from = rounds::start(arguments.start_checkpoint.as_ref(), round.as_ref(), model);
    let lpips = read_weights(&settings.data.lpips_weights, &arguments.device.host)?;
    let port = if writes { arguments.live.open()? } else { None };
    // Open the device first, so that its absence is reported before the photos are loaded.
    let host = &arguments.device.host;
    let offload = arguments.offload.map(|size| size.unwrap_or_else(|| host.memory().limit()));
    let context = arguments.device.context_with(|options| options.offload = offload)?;
    let mut initial = RunStart::read(
        from.as_ref(),
        &settings,
        round.as_ref().and_then(|round| round.surroundings.as_deref()),
        host,
    )?;
    job.as_ref().map_or(Ok(()), |job| job.check_coarse(&settings.data.init))?;
    if writes && job.is_none() && initial.is_complete(&settings) {
        return print_complete(&settings);
    }
    // Photographs are read for the settings that the checkpoint brings, such as its background.
    let settings = given.settle(&DefaultsInput::of_start(initial.checkpoint()))?;
    let mut options = session::options(&settings.data, settings.train.white_background, host)?;
    // Depth maps are used for training only.
    options.depths = Some(settings.data.depths.clone()).filter(|folder| !folder.as_os_str().is_empty());
    // A continued training keeps its coordinates.
    options.frame = initial.checkpoint().map(|checkpoint| checkpoint.frame);
    options.keep_opacity = settings.train.random_background;
    options.photo_memory = Some(photo_memory(&context, arguments.photo_memory, &settings.data.model_path));
    let mut gallery = session::open(&settings.data, &options, &stop)?;
    initial.express_in(gallery.frame());
    let (mut settings, defaults) =
        given.settle_for(&mut gallery, initial.checkpoint(), initial.sh_degree())?;
    settings.data.level = gallery.level().to_string();
    // A continued training keeps its settings, used or not.
    if initial.start().is_none() {
        given.refuse_unused(&settings)?;
    }
    initial.warn_if_out_of_view(&settings, &gallery)?;
    warn_of_late_growth(&settings.train);
    let used = outside::look(
        &context,
        &mut gallery,
        (initial.scene(), &settings, job.as_ref()),
        (arguments.quiet, &stop),
    )?;
    let out_of_view = initial.divide(&settings, &gallery)?;
    testing::check_sizes(&lpips, &gallery, &settings)?;
    check_fits(&context, &gallery, &settings, &initial)?;
    let mut dataset = session::load(&gallery, arguments.quiet, &stop)?;
    let start = describe_start(&dataset, &context);
    gallery
        .notes()
        .iter()
        .chain(&dataset.notes)
        .chain(&defaults)
        .chain(&used)
        .filter(|_| !arguments.quiet)
        .for_each(|line| errln!("{line}"));
    // The pages show whole photos.
    let gallery = arguments.live.wants_photos().then(|| gallery.with_whole_photos());
    match initial.needs_points {
        true => settings.settle_points(&mut dataset, &options.host_memory, arguments.quiet, &stop)?,
        false => dataset.needs_no_points(),
    }
    session::warn(&dataset.warnings);
    initial.start().iter().for_each(|start| start.warn(&context));
    if let Some(iterations) = arguments.verify_determinism {
        drop(gallery);
        session::end_at_once(&stop)?;
        return verify::run(&context, dataset, (&settings, &initial), iterations, arguments.quiet);
    }
    let folder = settings.data.model_path.clone();
    let mut run = Run::begin(&context, dataset, (settings, held), &initial, arguments.quiet)?;
    if !arguments.quiet {
        errln!("{start}");
    }
    out_of_view.iter().filter(|_| !arguments.quiet).for_each(|line| errln!("{line}"));
    // Freed here: a checkpoint is as large as everything that training keeps on the device.
    drop(initial);
    run.repeat(&arguments.device, arguments.photo_memory, arguments.offload);
    run.tracking = Tracking::new(&run.views.test, &run.settings.train, arguments.eval_share);
    run.lpips = lpips;
    if let Some(round) = &round {
        run.stop_at_end_of(round);
    }
    run.serve(port, &context, gallery)?;
    // Nothing is trained yet, so Ctrl-C may end the run here.
    session::check(&stop)?;
    let interrupted = run.train(&stop)?;
    run.report();
    let ended = job.as_ref().zip(round.as_ref()).filter(|_| !interrupted);
    ended.map_or(Ok(()), |(job, round)| run.note_end(job, round))?;
    outln!("written to {}", folder.display());
    let DVec3 { x, y, z } = run.views.frame.origin;
    if run.views.frame.origin != DVec3::ZERO {
        outln!("the scene's origin is {x} {y} {z}: positions in point_cloud.ply are relative to it");
    }
    if !interrupted && !arguments.quiet && round.is_none_or(|round| round.is_last()) {
        print_next_steps(&folder, run.views.held_out);
    }
    arguments.device.report_validation(&context);
    if interrupted { Err(Error::Interrupted) } else { Ok(()) }
}

/// Warns of Gaussians that are added too late to be trained.
fn warn_of_late_growth(settings: &TrainSettings) {
    /// Iterations after which a scene is better than before a densification. A run that ended sooner lost up to 2 dB.
    const RECOVERY: u32 = 50;
    let (iterations, last) = (settings.iterations, settings.last_densification());
    let Some(last) = last.filter(|_| settings.strategy != StrategyType::Fixed) else {
        return;
    };
    if iterations - last < RECOVERY {
        errln!(
            "warning: the last densification, at iteration {last}, is {} iterations before the end, too few to train what it adds, \
             which may cost decibels; end at least {RECOVERY} after it",
            iterations - last
        );
    }
}

pub fn describe_start(dataset: &Dataset, context: &Context) -> String {
    let sizes = dataset.train.iter().map(|view| (view.camera.width, view.camera.height));
    let size = sizes.max().map_or_else(String::new, |(width, height)| format!(" of {width}x{height}"));
    let (photos, held_out) = (dataset.train.len(), dataset.test.len());
    format!(
        "{photos} photographs{size} to train on, {held_out} held out; training on {}",
        context.device_name()
    )
}

/// A training run: the trainer and its files.
pub struct Run {
    pub settings: Settings,
    pub trainer: Trainer,
    pub views: Views,
    progress: TrainProgress,
    log: TrainLog,
    first: Option<Cost>,
    total: Option<Cost>,
    pub evaluations: Vec<Tested>,
    /// The views that are measured between tests.
    tracking: Tracking,
    /// Number of evaluations in the results files.
    results: usize,
    /// Weights of LPIPS for the last test.
    lpips: Vec<Weights>,
    pub gaussians: u32,
    non_finite: u64,
    effect: Effect,
    /// True once the user was warned that memory is exhausted.
    limited: bool,
    /// Iterations that were skipped because their frames were too large.
    skipped: u32,
    /// Iteration of the checkpoint that the run began with.
    started: u32,
    /// Iteration of the last saved scene.
    saved: Option<u32>,
    /// Iteration of the last checkpoint.
    checkpointed: Option<u32>,
    /// Scene or checkpoint that could not be saved yet.
    retries: SaveRetries,
    kernels: KernelTimes,
    /// Further arguments that are needed to continue with the same bits.
    repeated: String,
    /// The iteration that it stops at.
    until: u32,
    /// True if it is one of several rounds.
    is_in_rounds: bool,
    live: Option<Live>,
    /// The last field, because it must be dropped last.
    _lock: FolderLock,
}

impl Run {
    /// Prepares a run that begins with the data set's points.
    pub fn prepare(context: &Context, dataset: Dataset, settings: Settings, quiet: bool) -> Result<Run> {
        Self::begin(context, dataset, (settings, None), &RunStart::points(), quiet)
    }

    /// Creates the trainer. Then, when only the disk can still fail, it creates the model folder with
    /// everything that is known before training.
    fn begin(
        context: &Context,
        dataset: Dataset,
        (settings, held): (Settings, Option<FolderLock>),
        initial: &RunStart,
        quiet: bool,
    ) -> Result<Run> {
        let mut first = initial.initial_gaussians(&dataset, &settings)?;
        let points = first.points.take();
        let (data, views) = prepared::split(dataset, &settings);
        let trainer = initial.trainer(context, data, first, &settings.train)?;
        let model = settings.data.model_path.clone();
        let start = initial.start();
        let continues = start.is_some_and(|start| start.is_of(&model));
        let cameras = (&views.cameras[..], &views.frame);
        let lock = folder::begin(&settings, held, cameras, points.as_ref(), continues)?;
        let log = match start {
            None => TrainLog::create(&model.join(LOG_FILE))?,
            Some(_) => TrainLog::resume(&model.join(LOG_FILE), trainer.iteration())?,
        };
        let tracking = Tracking::new(&views.test, &settings.train, tracking::SHARE);
        let until = settings.train.iterations;
        let mut run = Run {
            progress: TrainProgress::new(trainer.iteration(), &settings.train, quiet),
            started: trainer.iteration(),
            log,
            settings,
            trainer,
            tracking,
            views,
            first: None,
            total: None,
            evaluations: Vec::new(),
            results: 0,
            lpips: Vec::new(),
            gaussians: 0,
            non_finite: 0,
            effect: Effect::default(),
            limited: false,
            skipped: 0,
            saved: None,
            checkpointed: None,
            retries: SaveRetries::default(),
            kernels: KernelTimes::new(context),
            repeated: String::new(),
            until,
            is_in_rounds: false,
            live: None,
            _lock: lock,
        };
        if let Some(start) = start {
            if continues {
                start.keep(&model)?;
            }
            run.gaussians = to_u32(start.checkpoint.gaussians.len() as u64)?;
            run.save_poses(run.started)?;
        }
        Ok(run)
    }

    /// Trains to the end, or until Ctrl-C, for which it returns true. Scene and log are saved after a failure too.
    pub fn train(&mut self, stop: &AtomicBool) -> Result<bool> {
        let mut watch = Stopwatch::start();
        let result = self.iterate(stop, &mut watch);
        if result.is_ok() {
            self.end_show(stop);
        }
        let total = watch.cost(self.trainer.iteration() - self.started);
        self.total = Some(total);
        self.first.get_or_insert(total);
        self.progress.finish();
        if result.is_err() {
            self.rescue();
        }
        let log = self.log.finish();
        if let (Err(_), Err(error)) = (&result, &log) {
            errln!("warning: {error}");
        }
        let interrupted = result?;
        log?;
        if let Err(error) = report::write(self, interrupted || self.until < self.settings.train.iterations) {
            self.progress.warn(&format!("warning: no report: {error}"));
        }
        Ok(interrupted)
    }

    fn iterate(&mut self, stop: &AtomicBool, watch: &mut Stopwatch) -> Result<bool> {
        if self.started == self.settings.train.iterations {
            // Training is complete; only the results that could not be saved are missing.
            self.keep(self.started, false, watch)?;
        }
        for _ in self.started..self.until {
            let iteration = self.trainer.iteration() + 1;
            self.kernels.before(iteration);
            let report = self.trainer.step();
            self.kernels.after(iteration);
            let report = report?;
            self.show(&report, stop, watch);
            let stopping = stop.load(Ordering::Relaxed);
            self.account(&report);
            if report.iteration - self.started == FIRST_ITERATIONS {
                self.first = Some(watch.cost(FIRST_ITERATIONS));
            }
            let kept = self.check(&report).and_then(|()| self.keep(report.iteration, stopping, watch));
            let tracked = self.track(&report, watch);
            self.log.add(&report, (*kept.as_ref().unwrap_or(&None), tracked), &self.trainer.memory());
            // Even if saving or testing fails, the checkpoint holds the complete training.
            if self.checkpoint_is_due(report.iteration, stopping) {
                let written = watch.paused(|| self.keep_checkpoint(stopping));
                if let (Err(error), Err(_)) = (&kept, &written) {
                    self.progress.warn(&format!("warning: {error}"));
                }
                written?;
            }
            if stopping {
                if let Err(error) = kept {
                    self.progress.warn(&format!("warning: {error}"));
                }
                self.print_how_to_resume(report.iteration);
                return Ok(true);
            }
            kept?;
        }
        Ok(false)
    }
}
