//! `bench quality`: how good scenes become, and at what cost, in trainings with several strategies and seeds.

mod runs;
mod summary;

use super::machine;
use ashsplat::frame::to_u32;
use ashsplat::scene::PointCloud;
use ashsplat::train::{Forecast, TrainSettings, TrainView, Trainer};
use ashsplat::vk::Context;
use ashsplat::{Error, RenderSettings, Result};
use ashsplat_files::{Dataset, Gallery, HostMemory, View, atomic};
use ashsplat_program::args::{DeviceArguments, MAX_MEMORY_IN_TRAINING};
use ashsplat_program::config::{DataSettings, Recipe, Settings, TrainOverrides, When};
use ashsplat_program::eval::{More, Protocol};
use ashsplat_program::lock::{FolderLock, Work};
use ashsplat_program::measure::Stopwatch;
use ashsplat_program::progress::counting;
use ashsplat_program::{config, eval, output, session};
use clap::ArgAction::Set;
use clap::Args;
use runs::{Point, Run, SCHEMA, Setup};
use serde::Serialize;
use serde_json::json;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use summary::Summary;

const MEASURING: Work = Work { file: ".quality.lock", what: "measurement", option: "-o" };
/// Files in the folder, beside `runs/`.
const RESULT_FILE: &str = "quality.json";
const TABLE_FILE: &str = "quality.csv";
const PLOT_FILE: &str = "quality.svg";

/// Train a data set with several strategies, presets and seeds; PSNR and SSIM of all held-out views, Gaussians, processor seconds and
/// seconds along each run.
///
/// Runs take turns, seed by seed, so that a machine that becomes slower does so for all. Measuring does not count. Each
/// run that is over stays in the folder: after Ctrl-C the same command continues the run that was stopped. All
/// settings are those of `train`; what is given here holds for all of them. Two things differ: settings for few photos are not
/// taken (as `train --few-photos off`), and views are measured as the scene shows them, without lens effects and at the poses that
/// were given.
#[derive(Args)]
#[command(mut_arg("max_memory", |argument| argument.help(MAX_MEMORY_IN_TRAINING)))]
#[command(mut_arg("strategy", |argument| argument.hide(true)), mut_arg("seed", |argument| argument.hide(true)))]
pub struct Arguments {
    /// The data set; every 8th view is held out
    #[arg(value_name = "DATASET")]
    dataset: PathBuf,
    /// Folder for the runs, quality.json, quality.csv and quality.svg
    #[arg(short, long, value_name = "FOLDER")]
    out: PathBuf,
    /// Strategies, by the names of `train --strategy`
    #[arg(long, value_name = "NAME,NAME,...", value_delimiter = ',', required_unless_present = "presets")]
    #[arg(value_parser = config::strategies())]
    strategies: Vec<String>,
    /// Presets besides, by the names of `train --preset`
    #[arg(long, value_name = "NAME,NAME,...", value_delimiter = ',', value_parser = config::PRESETS)]
    presets: Vec<String>,
    /// Seeds: A..B, without B, or one by one
    #[arg(long, value_name = "A..B", default_value = "0..1", value_parser = seeds)]
    seeds: Seeds,
    /// How often a run is measured: at N equal shares of its iterations
    #[arg(long, value_name = "N", default_value_t = 20, value_parser = clap::value_parser!(u32).range(1..=1000))]
    points: u32,
    /// Say when this PSNR is reached, dB; may be given again
    #[arg(long, value_name = "DB", allow_negative_numbers = true)]
    until: Vec<f64>,
    /// Folder of the photos within the data set
    #[arg(short, long, value_name = "NAME", default_value = "images")]
    images: String,
    /// Folder of inverse-depth maps within the data set [default: none]
    #[arg(short, long, value_name = "FOLDER")]
    depths: Option<PathBuf>,
    /// 1, 2, 4 or 8 divides the photos' size; another number is their width; -1 scales to 1600 only what is wider
    #[arg(short, long, value_name = "N", allow_negative_numbers = true, default_value_t = -1)]
    resolution: i32,
    /// As `train --random-points`
    #[arg(long, action = Set, num_args = 0..=1, require_equals = true, default_value = "false", default_missing_value = "true", value_name = "BOOL")]
    random_points: bool,
    /// As `train --photo-points`
    #[arg(long, num_args = 0..=1, require_equals = true, default_value = "auto", default_missing_value = "on", value_name = "WHEN")]
    photo_points: When,
    #[command(flatten)]
    train: TrainOverrides,
    #[command(flatten)]
    device: DeviceArguments,
    /// No progress
    #[arg(long)]
    quiet: bool,
}

#[derive(Clone)]
struct Seeds(Vec<u32>);

fn name_of(settings: &TrainSettings) -> String {
    let mut values = settings.values().into_iter();
    values.find(|(name, _)| *name == "strategy").map_or_else(String::new, |(_, value)| value.to_string())
}

fn seeds(text: &str) -> Result<Seeds, String> {
    let number = |text: &str| text.trim().parse::<u32>().ok();
    let seeds: Option<Vec<u32>> = match text.split_once("..") {
        Some((from, to)) => {
            number(from).zip(number(to)).map(|(from, to)| (from..to.min(from + 1000)).collect())
        }
        None => text.split(',').map(number).collect(),
    };
    let mut seeds = seeds.unwrap_or_default();
    let mut seen = std::collections::HashSet::new();
    seeds.retain(|&seed| seen.insert(seed));
    if seeds.is_empty() { Err("expected 0..3, or 0,1,2".into()) } else { Ok(Seeds(seeds)) }
}

/// A training to measure.
struct Job {
    /// Name of the strategy, or `preset-` and the preset's name.
    strategy: String,
    seed: u32,
    settings: TrainSettings,
}

/// Inputs shared by all trainings.
struct Shared<'a> {
    context: &'a Context,
    dataset: &'a Dataset,
    data: &'a DataSettings,
    memory: &'a HostMemory,
    train: Vec<TrainView>,
    points: u32,
    quiet: bool,
    stop: &'a AtomicBool,
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> Result<()> {
    let jobs = arguments.jobs()?;
    if let Some(psnr) = arguments.until.iter().find(|psnr| !(psnr.is_finite() && **psnr > 0.0)) {
        return Err(Error::argument("--until", format!("is {psnr}, must be a PSNR in dB, say 31")));
    }
    let stop = session::stop_on_ctrl_c()?;
    let context = arguments.device.context()?;
    let data = arguments.data();
    // Runs in the folder count only if they used these photos, this device and this program.
    let program = machine::program();
    let setup = |job: &Job| Setup::new((&data, arguments.points), &job.settings, &context, &program);
    let folder = &arguments.out;
    let strategies: Vec<String> = jobs
        .iter()
        .take(arguments.strategies.len() + arguments.presets.len())
        .map(|job| job.strategy.clone())
        .collect();
    let mut done: Vec<Run> = Vec::new();
    for job in &jobs {
        done.extend(runs::read(&runs::file(folder, &job.strategy, job.seed), &setup(job)?)?);
    }
    if done.len() < jobs.len() {
        let mut options = session::options(&data, jobs[0].settings.white_background, &arguments.device.host)?;
        options.depths = arguments.depths.clone();
        let mut gallery = session::open(&data, &options, &stop)?;
        if jobs.iter().any(|job| job.settings.depth_points > 0.0) {
            gallery.read_tracks()?;
        }
        check_fits(&context, &gallery, (&data, &jobs))?;
        let dataset = session::load(&gallery, arguments.quiet, &stop)?;
        session::warn(&dataset.warnings);
        check(&dataset, &arguments.dataset)?;
        Settings { data: data.clone(), train: jobs[0].settings.clone() }.check_points(&dataset)?;
        let shared = Shared {
            context: &context,
            train: dataset.train.iter().map(train_view).collect(),
            dataset: &dataset,
            data: &data,
            memory: &options.host_memory,
            points: arguments.points,
            quiet: arguments.quiet,
            stop: &stop,
        };
        // From here on only the device or the disk can fail.
        atomic::create_folder(folder)?;
        let _lock = FolderLock::take(folder, &MEASURING, None)?;
        for job in &jobs {
            if done.iter().any(|run| run.strategy == job.strategy && run.seed == job.seed) {
                continue;
            }
            let run = shared.measure(job, setup(job)?)?;
            output::write_json(&runs::file(folder, &job.strategy, job.seed), &run)?;
            if !arguments.quiet {
                tell!("{}", run.describe());
            }
            done.push(run);
            write(arguments, &context, &strategies, &done)?;
        }
    }
    let summary = write(arguments, &context, &strategies, &done)?;
    say!("{}", summary.table().trim_end());
    say!("written to {}", folder.display());
    arguments.device.report_validation(&context);
    Ok(())
}

fn train_view(view: &View) -> TrainView {
    TrainView::new(view.camera, view.photo.clone())
        .taken_by(view.camera_id)
        .with_inverse_depth(view.inverse_depth.clone())
        .with_depth_points(view.depth_points.clone())
}

/// Refuses settings that one of the trainings could not use, before the first begins.
fn check_fits(context: &Context, gallery: &Gallery, (data, jobs): (&DataSettings, &[Job])) -> Result<()> {
    let photos = gallery.train_photos();
    for job in jobs {
        let settings = Settings { data: data.clone(), train: job.settings.clone() };
        let points = gallery.points().positions.len();
        let gaussians = if points == 0 { settings.missing_points() } else { points };
        let forecast = Forecast {
            settings: &job.settings,
            photos: &photos,
            photo_memory: gallery.file_memory(),
            gaussians: to_u32(gaussians as u64)?,
            frozen: 0,
            capacities: None,
        };
        forecast.check(context)?;
    }
    Ok(())
}

fn check(dataset: &Dataset, path: &Path) -> Result<()> {
    if dataset.test.is_empty() {
        return Err(Error::input(path, "has no views to hold out", "give a data set of more views"));
    }
    Ok(())
}

/// Finished runs, in the order of the strategies.
#[derive(Serialize)]
struct Report<'a> {
    schema: &'static str,
    program: super::schema::Program,
    host: super::schema::Host,
    device: super::schema::Device,
    summary: &'a Summary,
    runs: &'a [Run],
}

/// Writes the results of the finished runs.
fn write(arguments: &Arguments, context: &Context, strategies: &[String], runs: &[Run]) -> Result<Summary> {
    let summary = Summary::new(strategies, runs, &arguments.until);
    let report = Report {
        schema: SCHEMA,
        program: machine::program(),
        host: machine::host(),
        device: machine::device(context),
        summary: &summary,
        runs,
    };
    let folder = &arguments.out;
    output::write_json(&folder.join(RESULT_FILE), &json!(report))?;
    output::write_text(&folder.join(TABLE_FILE), &runs::csv(runs))?;
    let name =
        arguments.dataset.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
    let title = format!("{name}, {} on {}", summary.iterations(), context.device_name());
    output::write_text(&folder.join(PLOT_FILE), &summary.plot(&title, &arguments.until))?;
    Ok(summary)
}

impl Arguments {
    /// Lists the trainings seed by seed, so that changes of the machine affect all strategies.
    fn jobs(&self) -> Result<Vec<Job>> {
        for (name, instead) in [("strategy", "--strategies"), ("seed", "--seeds")] {
            if self.train.has(name) {
                return Err(Error::argument(format!("--{name}"), format!("is {instead} here")));
            }
        }
        let mut jobs: Vec<Job> = Vec::new();
        for &seed in &self.seeds.0 {
            let strategies = self.strategies.iter().map(|name| Recipe::Strategy(name));
            let presets = self.presets.iter().map(|name| Recipe::Preset(name));
            for recipe in strategies.chain(presets) {
                let settings = self.train.settings(recipe, seed)?;
                let (option, strategy) = match recipe {
                    // The strategy's current name, also if an earlier one was given.
                    Recipe::Strategy(_) => ("--strategies", name_of(&settings)),
                    Recipe::Preset(name) => ("--presets", format!("preset-{name}")),
                };
                if jobs.iter().any(|job| job.strategy == strategy && job.seed == seed) {
                    let name = strategy.trim_start_matches("preset-");
                    return Err(Error::argument(option, format!("names '{name}' twice")));
                }
                jobs.push(Job { strategy, seed, settings });
            }
        }
        let data = self.data();
        let of = |job: &Job| Settings { data: data.clone(), train: job.settings.clone() };
        self.train.refuse_unused(&jobs.iter().map(of).collect::<Vec<_>>())?;
        Ok(jobs)
    }

    fn data(&self) -> DataSettings {
        DataSettings {
            source_path: self.dataset.clone(),
            images: self.images.clone(),
            depths: self.depths.clone().unwrap_or_default(),
            resolution: self.resolution,
            random_points: self.random_points,
            photo_points: self.photo_points,
            eval: true,
            ..DataSettings::default()
        }
    }
}

impl Shared<'_> {
    /// The points that a training starts from.
    fn points(&self, settings: &TrainSettings) -> Result<PointCloud> {
        let seed = u64::from(settings.seed);
        if !self.dataset.points.is_empty() {
            return Ok(self.dataset.points.clone());
        }
        let settings = Settings { data: self.data.clone(), train: settings.clone() };
        let mut dataset = self.dataset.clone();
        settings.settle_points(&mut dataset, self.memory, self.quiet, self.stop)?;
        Ok(dataset.initial_points(seed))
    }

    fn measure(&self, job: &Job, setup: Setup) -> Result<Run> {
        let settings = &job.settings;
        let mut watch = Stopwatch::start();
        let points = self.points(settings)?;
        let mut initial = ashsplat_files::initial_gaussians(&points, settings.sh_degree)?;
        settings.initialize(&mut initial);
        let extent = self.dataset.scene_extent;
        let new = || Trainer::new(self.context, self.train.clone(), &initial, extent, settings.clone());
        let mut trainer = watch.paused(new)?;
        let bar = counting("iterations", settings.iterations.into(), self.quiet);
        let due = runs::shares(settings.iterations, self.points);
        let mut points = Vec::with_capacity(due.len());
        while trainer.iteration() < settings.iterations {
            session::check(self.stop)?;
            let report = trainer.step()?;
            bar.inc(1);
            if due.contains(&report.iteration) {
                let cost = watch.cost(report.iteration);
                let (psnr, ssim) = watch.paused(|| quality(&mut trainer, &self.dataset.test))?;
                points.push(Point {
                    iteration: report.iteration,
                    seconds: cost.seconds,
                    cpu_seconds: cost.cpu_seconds,
                    psnr,
                    ssim,
                    gaussians: report.gaussians,
                });
            }
        }
        bar.finish_and_clear();
        let (strategy, seed) = (job.strategy.clone(), job.seed);
        let views = self.dataset.test.len();
        Ok(Run { schema: SCHEMA.to_owned(), strategy, seed, setup, held_out_views: views, points })
    }
}

/// Mean PSNR and SSIM of the current scene over the views.
fn quality(trainer: &mut Trainer, views: &[View]) -> Result<(f64, f64)> {
    let settings = RenderSettings { inverse_depth: false, ..trainer.render_settings() };
    let draw = |camera: &ashsplat::Camera| trainer.render(camera, &settings);
    let evaluation = eval::evaluate(views.iter().map(Ok), &Protocol::default(), More::default(), draw)?;
    if evaluation.views.is_empty() {
        return Err(Error::argument("held-out views", "masks hide all of them"));
    }
    Ok((evaluation.psnr(), evaluation.ssim()))
}
