//! `ashsplat info`.

use ashsplat::ShStorage;
use ashsplat::frame::max_trained_gaussians;
use ashsplat::scene::{Bounds, Gaussians, WorldFrame};
use ashsplat::train::{Forecast, MomentsType, TrainSettings};
use ashsplat::vk::{Context, ContextOptions};
use ashsplat::{Error, Result};
use ashsplat_files::{Dataset, DatasetReport, Gallery, quoted, splats};
use ashsplat_program::args::{HostArguments, bytes, size};
use ashsplat_program::config::DataSettings;
use ashsplat_program::model::Model;
use ashsplat_program::progress::thousands;
use ashsplat_program::{model, session};
use clap::Args;
use glam::DVec3;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// Show the contents of a file of Gaussians, a model folder or a data set.
///
/// A data set is checked as by training: every photo is present, can be decoded and has the size of its camera. All problems
/// are listed, and the exit code is 2 if there are any.
#[derive(Args)]
pub struct Arguments {
    /// A file of Gaussians (PLY, compressed PLY, .splat, SPZ, glTF, SOG), a model folder or a data set
    #[arg(value_name = "PATH")]
    path: PathBuf,
    /// Folder of a data set's photos
    #[arg(short, long, value_name = "NAME", default_value = "images")]
    images: String,
    /// Sizes of a data set's photos as with train's -r
    #[arg(short, long, value_name = "N", allow_negative_numbers = true, default_value = "-1")]
    resolution: i32,
    /// Read a data set's photos as stored, or turned as their metadata (Exif) say
    #[arg(long, value_parser = ["auto", "stored", "upright"], value_name = "NAME", default_value = "auto")]
    orientation: String,
    /// Replace a data set's photos of lenses by those of pinholes
    #[arg(long)]
    undistort: bool,
    /// Treat transparent pixels of a data set's photos as train's --alpha does
    #[arg(long, value_parser = ["target", "mask", "ignore"], value_name = "USE", default_value = "target")]
    alpha: String,
    /// Count a data set's views as with --eval
    #[arg(long)]
    eval: bool,
    /// Drop the Gaussians whose parameters are not finite, instead of refusing the file
    #[arg(long)]
    drop_invalid: bool,
    /// Print how many Gaussians training on a data set can begin with in this much device memory, with a unit: 800M, 6G
    #[arg(long, value_name = "SIZE", value_parser = bytes)]
    max_memory: Option<u64>,
    #[command(flatten)]
    host: HostArguments,
    /// Print JSON
    #[arg(long)]
    json: bool,
    /// No progress
    #[arg(long)]
    quiet: bool,
}

/// Number of rows of a histogram.
const ROWS: usize = 10;
/// Length of a histogram's longest bar, characters.
const BAR: usize = 40;

pub fn run(arguments: &Arguments) -> Result<()> {
    let path = &arguments.path;
    if model::is_dataset(path) {
        return dataset(arguments);
    }
    let model = Model::locate(path, None)?;
    let scene = splats::read(&model.ply, &arguments.host.reading(arguments.drop_invalid))?;
    let summary = Summary::of(&scene.gaussians, &scene.frame);
    if arguments.json {
        outln!("{:#}", summary.json(&model.ply, &scene));
        return Ok(());
    }
    outln!("file       {}", model.ply.display());
    let antialiased = if scene.header.antialiased { ", trained with antialiasing" } else { "" };
    let kernel = scene.header.kernel_size.map_or_else(String::new, |size| format!(", kernel size {size}"));
    let order = if scene.header.distance_order { ", ordered by distance" } else { "" };
    outln!("format     {}{antialiased}{kernel}{order}", scene.header.format);
    summary.print();
    if scene.dropped > 0 {
        outln!("dropped    {} that are not finite", thousands(scene.dropped));
    }
    for warning in scene.warnings {
        outln!("warning    {warning}");
    }
    Ok(())
}

fn dataset(arguments: &Arguments) -> Result<()> {
    let data = DataSettings {
        images: arguments.images.clone(),
        resolution: arguments.resolution,
        orientation: arguments.orientation.clone(),
        undistort: arguments.undistort,
        alpha: arguments.alpha.clone(),
        eval: arguments.eval,
        ..Default::default()
    };
    let options = session::options(&data, false, &arguments.host)?;
    let stop = session::stop_on_ctrl_c()?;
    let report = session::counted("checking photos", arguments.quiet, &stop, |progress| {
        Dataset::inspect(&arguments.path, &options, progress)
    });
    session::check(&stop)?;
    let fitting = match arguments.max_memory {
        Some(budget) if report.is_sound() => {
            let data = DataSettings { source_path: arguments.path.clone(), ..data };
            Some((budget, fitting(&session::open(&data, &options, &stop)?, budget)?))
        }
        _ => None,
    };
    if arguments.json {
        let mut all = dataset_json(&report);
        if let Some((_, fitting)) = &fitting {
            all["most_gaussians"] =
                fitting.iter().map(|&(storage, budget, _)| (storage.to_string(), json!(budget))).collect();
        }
        outln!("{all:#}");
    } else if report.model.is_some() {
        outln!("{}", report.to_string().trim_end());
    }
    match report.problems.as_slice() {
        [] => {
            if !arguments.json {
                if let Some((budget, fitting)) = fitting {
                    for (storage, gaussians, is_bound) in fitting {
                        let bound = if is_bound { " (its buffers hold no more)" } else { "" };
                        let (budget, gaussians) = (size(budget), thousands(gaussians.into()));
                        outln!(
                            "memory    training in {budget} can begin with {gaussians} Gaussians: {storage}{bound}"
                        );
                    }
                }
                let (dataset, model) = (&arguments.path, model::usual_folder(&arguments.path));
                let mut command =
                    format!("ashsplat train -s {} -m {}", quoted(&dataset.to_string_lossy()), quoted(&model));
                // A single photograph would be held out, so that none is left.
                if report.train_views + report.test_views > 1 {
                    command += " --eval";
                }
                if report.needs_random_points() {
                    command += " --random-points";
                }
                if arguments.images != "images" {
                    command += &format!(" --images {}", quoted(&arguments.images));
                }
                if arguments.resolution != -1 {
                    command += &format!(" -r {}", arguments.resolution);
                }
                if arguments.orientation != "auto" {
                    command += &format!(" --orientation {}", quoted(&arguments.orientation));
                }
                if arguments.undistort {
                    command += " --undistort";
                }
                if arguments.alpha != "target" {
                    command += &format!(" --alpha {}", arguments.alpha);
                }
                outln!("next      it can be trained on: {command}");
            }
            Ok(())
        }
        [only] => Err(Error::argument("data set", only.clone())),
        [first, rest @ ..] => Err(Error::argument("data set", format!("{first} (and {} more)", rest.len()))),
    }
}

/// Storages of a training, and the most Gaussians that it can begin with in this much device memory; true if the device's buffers
/// hold no more.
fn fitting(gallery: &Gallery, budget: u64) -> Result<[(&'static str, u32, bool); 3]> {
    let context = Context::new(&ContextOptions { max_memory: Some(budget), ..ContextOptions::default() })?;
    let usual = TrainSettings::default();
    let settings = [
        ("default", usual.clone()),
        ("--sh-storage f32", TrainSettings { sh_storage: ShStorage::F32, ..usual.clone() }),
        (
            "--sh-storage f32 --moments f32",
            TrainSettings { sh_storage: ShStorage::F32, moments: MomentsType::F32, ..usual },
        ),
    ];
    let photos = gallery.train_photos();
    let in_buffers = max_trained_gaussians(context.limits());
    let mut found = [("", 0, false); 3];
    for (found, (storage, settings)) in found.iter_mut().zip(&settings) {
        let forecast = Forecast {
            settings,
            photos: &photos,
            photo_memory: gallery.file_memory(),
            gaussians: 0,
            frozen: 0,
            capacities: None,
        };
        let gaussians = forecast.max_gaussians(&context)?;
        *found = (storage, gaussians, gaussians == in_buffers);
    }
    Ok(found)
}

fn dataset_json(report: &DatasetReport) -> Value {
    let frame = &report.frame;
    let in_source =
        |bounds: Bounds| corners_json([bounds.min, bounds.max].map(|corner| frame.source(corner)));
    json!({
        "model": report.model,
        "cameras": report.cameras,
        "images": report.images,
        "sound_photos": report.sound_photos,
        "train_views": report.train_views,
        "test_views": report.test_views,
        "points": report.points,
        "origin": frame.origin.to_array(),
        "unit": frame.unit,
        "point_bounds": report.point_bounds.map(in_source),
        "camera_bounds": report.camera_bounds.map(in_source),
        "scene_extent": (frame.unit * f64::from(report.scene_extent)) as f32,
        "problems": report.problems,
        "warnings": report.warnings,
        "notes": report.notes,
    })
}

fn corners_json([min, max]: [DVec3; 2]) -> Value {
    json!({ "min": min.to_array(), "max": max.to_array() })
}

struct Summary {
    count: usize,
    sh_degree: u32,
    bounds: Option<[DVec3; 2]>,
    central: Option<[DVec3; 2]>,
    scales: Histogram,
    opacities: Histogram,
    densities: Histogram,
}

impl Summary {
    fn of(gaussians: &Gaussians, frame: &WorldFrame) -> Summary {
        let statistics = gaussians.statistics();
        let corners = |Bounds { min, max }: Bounds| [min, max].map(|corner| frame.source(corner));
        let opacities = gaussians.opacity_logits.iter().map(|logit| 1.0 / (1.0 + (-logit).exp()));
        // A Gaussian's size is its largest scale. The decadic logarithm spreads sizes evenly.
        let largest = |scales: &[f32; 3]| scales.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        let scales = gaussians.log_scales.iter().map(|s| largest(s) / std::f32::consts::LN_10);
        let density = |index| gaussians.log_density(index) / std::f32::consts::LN_10;
        Summary {
            count: statistics.count,
            sh_degree: statistics.sh_degree,
            bounds: statistics.bounds.map(corners),
            central: statistics.central_bounds.map(corners),
            scales: Histogram::spanning(scales.collect()),
            opacities: Histogram::between(0.0, 1.0, opacities.collect()),
            densities: Histogram::spanning((0..gaussians.len()).map(density).collect()),
        }
    }

    fn print(&self) {
        outln!("Gaussians  {}", thousands(self.count as u64));
        outln!("SH degree  {}", self.sh_degree);
        for (name, bounds) in [("extent", self.bounds), ("central", self.central)] {
            if let Some([min, max]) = bounds {
                // Keeps three digits of lengths below one unit.
                let digits = (2.0 - (max - min).max_element().log10().floor()).clamp(3.0, 12.0) as usize;
                outln!("{name:<10} from {min:.digits$} to {max:.digits$}");
            }
        }
        outln!("largest scale (the file's units)");
        self.scales.print(|edge| format!("{:.2e}", 10f32.powf(edge)));
        outln!("opacity");
        self.opacities.print(|edge| format!("{edge:.2}"));
        outln!("density: opacity / (1 - opacity) / largest scale (floaters have the least)");
        self.densities.print(|edge| format!("{:.2e}", 10f32.powf(edge)));
    }

    fn json(&self, path: &Path, scene: &splats::Scene) -> Value {
        json!({
            "file": path,
            "gaussians": self.count,
            "format": scene.header.format.to_string(),
            "antialiased": scene.header.antialiased,
            "kernel_size": scene.header.kernel_size,
            "distance_order": scene.header.distance_order,
            "dropped": scene.dropped,
            "sh_degree": self.sh_degree,
            "bounds": self.bounds.map(corners_json),
            "central_bounds": self.central.map(corners_json),
            "log10_largest_scale": self.scales.json(),
            "opacity": self.opacities.json(),
            "log10_density": self.densities.json(),
        })
    }
}

struct Histogram {
    low: f32,
    high: f32,
    counts: [usize; ROWS],
}

impl Histogram {
    fn between(low: f32, high: f32, values: Vec<f32>) -> Histogram {
        let mut counts = [0; ROWS];
        let width = ((high - low) / ROWS as f32).max(f32::MIN_POSITIVE);
        for value in values {
            // Saturates, so that values outside count in the first or last row.
            counts[(((value - low) / width) as usize).min(ROWS - 1)] += 1;
        }
        Histogram { low, high, counts }
    }

    fn spanning(values: Vec<f32>) -> Histogram {
        let finite = || values.iter().copied().filter(|v| v.is_finite());
        let (low, high) =
            (finite().fold(f32::INFINITY, f32::min), finite().fold(f32::NEG_INFINITY, f32::max));
        if low > high {
            return Histogram { low: 0.0, high: 0.0, counts: [0; ROWS] };
        }
        Histogram::between(low, high, values)
    }

    fn edge(&self, index: usize) -> f32 {
        self.low + (self.high - self.low) * index as f32 / ROWS as f32
    }

    fn print(&self, label: impl Fn(f32) -> String) {
        let max = self.counts.iter().copied().max().unwrap_or(0).max(1);
        for (row, &count) in self.counts.iter().enumerate() {
            let bar = "#".repeat((count * BAR).div_ceil(max));
            let (from, to) = (label(self.edge(row)), label(self.edge(row + 1)));
            outln!("  {from:>9} to {to:>9} {:>10} {bar}", thousands(count as u64));
        }
    }

    fn json(&self) -> Value {
        let edges: Vec<f32> = (0..=ROWS).map(|index| self.edge(index)).collect();
        json!({ "edges": edges, "counts": self.counts })
    }
}
