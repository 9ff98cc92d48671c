//! Loads data sets for commands.

use crate::args::HostArguments;
use crate::blocks::job::Job;
use crate::config::DataSettings;
use crate::progress::counting;
use ashsplat::scene::WorldFrame;
use ashsplat::{Error, Result};
use ashsplat_files::cameras_json::NamedCamera;
use ashsplat_files::{Dataset, DatasetOptions, Gallery, Progress};
use clap::Args;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};

/// Which data set a command uses, and how.
#[derive(Args)]
pub struct DataArguments {
    /// Data set [default: that of the training]
    #[arg(short, long, value_name = "DATASET")]
    source_path: Option<PathBuf>,
    /// Folder of the photos within the data set [default: as in training, else images]
    #[arg(short, long, value_name = "NAME")]
    images: Option<String>,
    /// 1, 2, 4 or 8 divides the photos' size; another number is their width; -1 reduces wider photos to 1600 [default: as in
    /// training, else -1]
    #[arg(short, long, value_name = "N", allow_negative_numbers = true)]
    resolution: Option<i32>,
    /// Photos as they are stored, or turned as their metadata (Exif) say [default: as in training, else auto]
    #[arg(long, value_parser = ["auto", "stored", "upright"], value_name = "NAME")]
    orientation: Option<String>,
    /// Replace photos of lenses by those of pinholes [default: as in training]
    #[arg(long, num_args = 0..=1, require_equals = true, default_missing_value = "true", value_name = "BOOL")]
    undistort: Option<bool>,
    /// Transparent pixels show the background (target), do not count (mask), or have their stored colours (ignore) [default: as in
    /// training, else target]
    #[arg(long, value_parser = ["target", "mask", "ignore"], value_name = "USE")]
    alpha: Option<String>,
    /// Hold out every 8th view (by name) [default: as in training]
    #[arg(long)]
    eval: bool,
}

impl DataArguments {
    /// Same as [`DataArguments::applied_to`], but for a data set from another argument, and for the whole scene.
    pub fn applied_to_dataset(&self, dataset: Option<&Path>, trained: &DataSettings) -> Result<DataSettings> {
        let source_path = dataset.map_or_else(|| trained.source_path.clone(), Path::to_owned);
        let whole =
            DataSettings { source_path, job: String::new(), train_test_exp: false, ..trained.clone() };
        self.applied_to(&whole)
    }

    /// The settings of a training, overridden by the arguments.
    pub fn applied_to(&self, trained: &DataSettings) -> Result<DataSettings> {
        let mut data = trained.clone();
        if let Some(source) = &self.source_path {
            data.source_path.clone_from(source);
            // The job lists the photos of another data set.
            data.job.clear();
        }
        data.images = self.images.clone().unwrap_or(data.images);
        data.resolution = self.resolution.unwrap_or(data.resolution);
        data.orientation = self.orientation.clone().unwrap_or(data.orientation);
        data.undistort = self.undistort.unwrap_or(data.undistort);
        data.alpha = self.alpha.clone().unwrap_or(data.alpha);
        data.eval |= self.eval;
        if data.source_path.as_os_str().is_empty() {
            return Err(Error::argument(
                "-s/--source-path",
                "is missing, and the model does not say where its data set is",
            ));
        }
        if self.source_path.is_none() && data.source_path.is_relative() && !data.source_path.exists() {
            let problem = "is the model's data set, as named in another folder, and not here";
            return Err(Error::input(&data.source_path, problem, "name the data set with -s"));
        }
        Ok(data)
    }
}

/// Loading options for these settings. All photos are held in memory, within the budget of `host`.
pub fn options(data: &DataSettings, white_background: bool, host: &HostArguments) -> Result<DatasetOptions> {
    Ok(DatasetOptions {
        resolution: data.resolution.to_string().parse()?,
        images: data.images.clone(),
        orientation: data.orientation.parse()?,
        undistort: data.undistort,
        alpha: data.alpha.parse()?,
        level: data.level.parse()?,
        eval: data.eval,
        eval_split: data.eval_split.into(),
        train_test_exp: data.train_test_exp,
        white_background,
        host_memory: host.memory(),
        ..Default::default()
    })
}

/// Opens a data set; a ZIP stays unpacked as long as the value lives. `stop` ends it. For a block's training, only the
/// block's photos are kept. The frame is the division's unless another one is given.
pub fn open(data: &DataSettings, options: &DatasetOptions, stop: &AtomicBool) -> Result<Gallery> {
    let progress = Progress { report: None, interrupted: Some(stop) };
    let job = Job::of(&data.job)?;
    let of_division = job.as_ref().map(|job| job.file.division.frame());
    let options = DatasetOptions { frame: options.frame.or(of_division), ..options.clone() };
    let mut gallery = Gallery::open(&data.source_path, &options, progress)?;
    if let Some(job) = job {
        job.choose_photos(&data.source_path, &mut gallery)?;
    }
    Ok(gallery)
}

/// Loads a data set with a progress bar. `stop` ends it.
pub fn load(gallery: &Gallery, quiet: bool, stop: &AtomicBool) -> Result<Dataset> {
    counted("reading photos", quiet, stop, |progress| gallery.load(progress))
}

/// Runs work that reports its progress, with a bar from the first report on. `stop` ends it.
pub fn counted<T>(
    what: &'static str,
    quiet: bool,
    stop: &AtomicBool,
    work: impl FnOnce(Progress<'_>) -> T,
) -> T {
    let shown = OnceLock::new();
    let report = |done: usize, total: usize| {
        shown.get_or_init(|| counting(what, total as u64, quiet)).set_position(done as u64);
    };
    let done = work(Progress { report: Some(&report), interrupted: Some(stop) });
    shown.get().inspect(|bar| bar.finish_and_clear());
    done
}

pub fn warn(warnings: &[String]) {
    for warning in warnings {
        errln!("warning: {warning}");
    }
}

/// The cameras of a data set by name, at the photos' own sizes, in a frame of coordinates, as [`gallery`] opens it; photos are not
/// read. Ctrl-C stops the call, so that nothing of an unpacked ZIP is left. Afterwards, Ctrl-C ends the program at once.
pub fn cameras(dataset: &Path, trained: &DataSettings, frame: &WorldFrame) -> Result<Vec<NamedCamera>> {
    let stop = stop_on_ctrl_c()?;
    let cameras = gallery(dataset, trained, frame, &stop)?.cameras();
    end_at_once(&stop)?;
    Ok(cameras)
}

/// Opens a data set in a frame of coordinates. Level, orientation, transparency, lenses and, where the data set has it, the photos'
/// folder are as in a training with these settings. `stop` ends it.
pub fn gallery(
    dataset: &Path,
    trained: &DataSettings,
    frame: &WorldFrame,
    stop: &AtomicBool,
) -> Result<Gallery> {
    let progress = Progress { report: None, interrupted: Some(stop) };
    let mut options = DatasetOptions {
        frame: Some(*frame),
        level: trained.level.parse()?,
        undistort: trained.undistort,
        alpha: trained.alpha.parse()?,
        orientation: trained.orientation.parse()?,
        ..Default::default()
    };
    // Another data set need not have the folder.
    if !dataset.is_dir() || dataset.join(&trained.images).is_dir() {
        options.images.clone_from(&trained.images);
    }
    Gallery::open(dataset, &options, progress)
}

/// Makes Ctrl-C end the program at once, because the flag is not read any more. An earlier Ctrl-C
/// takes effect here.
pub fn end_at_once(stop: &AtomicBool) -> Result<()> {
    if stop.swap(true, Ordering::Relaxed) { Err(Error::Interrupted) } else { Ok(()) }
}

/// Returns [`Error::Interrupted`] if `stop` is set.
pub fn check(stop: &AtomicBool) -> Result<()> {
    if stop.load(Ordering::Relaxed) { Err(Error::Interrupted) } else { Ok(()) }
}

/// Exit code after Ctrl-C, as shells report a process ended by SIGINT.
pub const INTERRUPTED: u8 = 130;

/// A flag that Ctrl-C raises; a second Ctrl-C ends the program at once.
pub fn stop_on_ctrl_c() -> Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    let flag = stop.clone();
    let handler = move || {
        if flag.swap(true, Ordering::Relaxed) {
            std::process::exit(i32::from(INTERRUPTED));
        }
    };
    ctrlc::set_handler(handler).map_err(|e| Error::argument("Ctrl-C", format!("cannot be caught: {e}")))?;
    Ok(stop)
}

/// Runs `work` and turns a panic into an error. What `work` holds must be valid after a panic at any point.
pub fn guarded<T>(work: impl FnOnce() -> Result<T>) -> Result<T> {
    // The panic has already printed its place.
    catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|_| Err(Error::argument("a panic", "told above")))
}

/// Locks a mutex whose holders leave no half-made change when they panic.
pub fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
