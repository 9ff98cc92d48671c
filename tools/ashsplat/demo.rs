//! `ashsplat demo`: from nothing to a trained scene in one command.

mod dataset;
mod lens;
mod sheet;

use crate::train::{Run, describe_start, print_next_steps};
use ashsplat::train::TrainSettings;
use ashsplat::{Error, Result};
use ashsplat_program::args::DeviceArguments;
use ashsplat_program::config::{DataSettings, Settings};
use ashsplat_program::look::settings_of;
use ashsplat_program::model::point_cloud_path;
use ashsplat_program::{output, session};
use clap::Args;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Make a small data set, train on it and show the result: a contact sheet of the held-out views (photo, render,
/// difference) and the PLY.
///
/// The data set is a procedural scene, photographed by ray casting from 40 sides, with a sparse, noisy point cloud, as a
/// COLMAP folder: `ashsplat train -s OUT/dataset` and every other program that reads COLMAP can use it too. With --scene city it
/// is a city of many houses in 162 small photographs from above: to be trained in blocks. --lots makes it smaller or larger.
#[derive(Args)]
pub struct Arguments {
    /// Folder for everything
    #[arg(short, long, value_name = "DIR", default_value = "out/demo")]
    out: PathBuf,
    /// Number of iterations; the schedule stretches with it
    #[arg(long, value_name = "N", default_value_t = ITERATIONS, value_parser = clap::value_parser!(u32).range(1..))]
    iterations: u32,
    #[command(flatten)]
    choices: dataset::Choices,
    /// Only write the data set
    #[arg(long)]
    dataset_only: bool,
    /// Seed of everything random
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u32,
    #[command(flatten)]
    device: DeviceArguments,
    /// No progress; only results and errors
    #[arg(long)]
    quiet: bool,
}

/// Default number of iterations; two processor cores without a GPU need little more than a minute.
const ITERATIONS: u32 = 1200;
const SHEET_FILE: &str = "contact_sheet.png";

pub fn run(arguments: &Arguments) -> Result<()> {
    arguments.choices.check()?;
    let start = Instant::now();
    let folder = &arguments.out;
    let data = folder.join("dataset");
    let write = || dataset::write(&data, &arguments.choices, u64::from(arguments.seed), arguments.quiet);
    if arguments.dataset_only {
        write()?;
        outln!("data set        {}", data.display());
        return Ok(());
    }
    // Opens the device first: without one, nothing should be written.
    let context = arguments.device.context()?;
    write()?;
    let settings = settings(&data, &folder.join("model"), arguments.iterations, arguments.seed);
    settings.train.check()?;
    let stop = session::stop_on_ctrl_c()?;
    let options = session::options(&settings.data, false, &arguments.device.host)?;
    let gallery = session::open(&settings.data, &options, &stop)?;
    let loaded = session::load(&gallery, arguments.quiet, &stop)?;
    if !arguments.quiet {
        errln!("{}", describe_start(&loaded, &context));
    }
    let model = settings.data.model_path.clone();
    let mut run = Run::prepare(&context, loaded, settings, arguments.quiet)?;
    run.repeat(&arguments.device, None, None);
    let interrupted = run.train(&stop)?;
    if !interrupted {
        write_sheet(&mut run, &folder.join(SHEET_FILE))?;
        run.report();
        outln!("data set        {}", data.display());
        outln!("PLY             {}", point_cloud_path(&model, arguments.iterations).display());
        outln!("contact sheet   {}", folder.join(SHEET_FILE).display());
        print_next_steps(&model, true);
        outln!("total           {:.1} s", start.elapsed().as_secs_f64());
    }
    arguments.device.report_validation(&context);
    if interrupted { Err(Error::Interrupted) } else { Ok(()) }
}

/// The settings of `ashsplat train --eval` with this number of iterations.
fn settings(dataset: &Path, model: &Path, iterations: u32, seed: u32) -> Settings {
    let data = DataSettings {
        source_path: dataset.to_owned(),
        model_path: model.to_owned(),
        eval: true,
        test_iterations: vec![iterations / 3, iterations * 2 / 3],
        save_iterations: Vec::new(),
        ..DataSettings::default()
    };
    Settings { data, train: TrainSettings { iterations, seed, ..TrainSettings::default() } }
}

fn write_sheet(run: &mut Run, path: &Path) -> Result<()> {
    let settings = settings_of(&run.settings);
    let Some(evaluation) = run.evaluations.last().map(|tested| &tested.evaluation) else { return Ok(()) };
    let quality: Vec<(f64, f64)> = evaluation.views.iter().map(|v| (v.psnr, v.ssim)).collect();
    let mut rows = Vec::with_capacity(quality.len());
    for (view, (psnr, ssim)) in run.views.test.clone().into_iter().zip(quality) {
        let frame = run.trainer.render(&view.camera, &settings)?;
        rows.push(sheet::Row { render: output::to_photo(&frame)?, photo: view.photo.photo()?, psnr, ssim });
    }
    output::write_png(path, &sheet::contact_sheet(&rows))
}
