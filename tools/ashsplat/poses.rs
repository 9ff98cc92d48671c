//! `ashsplat poses`: from photographs or a video to a data set, by COLMAP.

mod cameras;
mod colmap;
mod sharpness;
mod source;
mod video;
mod workspace;

use ashsplat::scene::COLMAP_MODELS;
use ashsplat::{Error, Result};
use ashsplat_files::images::photo_size;
use ashsplat_files::{Photo, PhotoFileFormat, quoted};
use ashsplat_program::args::HostArguments;
use ashsplat_program::progress::{clock, counting_in, thousands};
use ashsplat_program::session;
use cameras::{Cameras, Reconstruction};
use clap::Args;
use colmap::{Colmap, Matcher};
use rayon::prelude::*;
use source::{PhotoInfo, Photos, Source};
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Instant;
use video::{FrameRequest, Reader, Video};
use workspace::Workspace;

/// Find the cameras of photographs or of a video: a data set for `ashsplat train`.
///
/// COLMAP, which must be installed, works in three stages: features, matches, mapping. A video also needs ffmpeg; the
/// sharpest frame of each of equal intervals is kept. Photographs stay unchanged in their place; a data set in another
/// folder gets hard links to them. Ctrl-C stops, and the same command continues with what was finished.
#[derive(Args)]
pub struct Arguments {
    /// A folder of photographs (JPEG, PNG), a folder with such a folder `images` in it, or a video
    #[arg(value_name = "FOLDER|VIDEO")]
    source: PathBuf,
    /// Folder of the data set [default: that in which the folder `images` lies; else NAME_dataset beside the source]
    #[arg(short, long, alias = "output", value_name = "DATASET")]
    out: Option<PathBuf>,
    /// Frames to take from a video [default: two per second, 40 at least and 150 at most]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(3..=10_000), conflicts_with = "every")]
    frames: Option<u32>,
    /// Take a frame of a video from every N seconds
    #[arg(long, value_name = "SECONDS", value_parser = seconds)]
    every: Option<f64>,
    /// Compare each photograph with all others, or with its neighbours by name; auto: with all others for up to 60
    /// photographs, with a GPU up to 200
    #[arg(long, value_parser = ["auto", "exhaustive", "sequential"], value_name = "NAME", default_value = "auto")]
    matcher: String,
    /// COLMAP's camera model; wide angles need OPENCV, fisheyes OPENCV_FISHEYE
    #[arg(long, value_parser = COLMAP_MODELS, value_name = "NAME", default_value = "SIMPLE_RADIAL")]
    camera_model: String,
    /// Which photographs share a camera: those of one size, camera and focal length in Exif (auto), all (one), or none
    /// (each)
    #[arg(long, value_parser = ["auto", "one", "each"], value_name = "NAME", default_value = "auto")]
    cameras: String,
    /// Most features in a photograph [default: 4096, with a GPU 8192]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(100..=100_000))]
    max_features: Option<u32>,
    /// Do not use a GPU, even if COLMAP could
    #[arg(long)]
    no_gpu: bool,
    /// COLMAP's program
    #[arg(long, value_name = "PROGRAM", default_value = "colmap")]
    colmap: OsString,
    /// ffmpeg's program
    #[arg(long, value_name = "PROGRAM", default_value = "ffmpeg")]
    ffmpeg: OsString,
    #[command(flatten)]
    host: HostArguments,
    /// No progress; only results and errors
    #[arg(long)]
    quiet: bool,
}

const MIN_PHOTOS: usize = 3;
/// Largest number of damaged photographs that are named.
const MAX_REPORTED: usize = 10;
/// Largest number of photographs that are all compared with each other, without and with a GPU.
const EXHAUSTIVE: [usize; 2] = [60, 200];
/// Largest number of names in a message.
const LISTED: usize = 5;

fn seconds(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(seconds) if (0.001..=3600.0).contains(&seconds) => Ok(seconds),
        _ => Err("expected seconds, 0.001 to 3600".into()),
    }
}

pub fn run(arguments: &Arguments) -> Result<()> {
    let start = Instant::now();
    let source = Source::of(&arguments.source, arguments.out.as_deref())?;
    arguments.check(&source)?;
    let place =
        std::path::absolute(&arguments.source).map_err(|e| Error::io(&arguments.source, "find", e))?;
    if place.to_str().is_none() {
        return Err(Error::input(
            place,
            "has a name that is not UTF-8",
            "rename it: COLMAP's lists are text",
        ));
    }
    let dataset = source.dataset();
    if let Some(workspace) = Workspace::ready(dataset)? {
        workspace.place()?;
        outln!(
            "{}: is complete now: an earlier run was killed while it moved the files there",
            dataset.display()
        );
        return Ok(());
    }
    let colmap = Colmap::find(&arguments.colmap)?;
    let stop = session::stop_on_ctrl_c()?;
    let linked = !matches!(&source, Source::Photos(photos) if photos.in_place);
    Workspace::check(dataset, linked)?;
    let (kind, summary) = arguments.prepare(&source, &stop)?;
    arguments.note(&format!("{summary}; the data set is {}", dataset.display()));
    let mut workspace = Workspace::open(dataset)?;
    let gpu = colmap.cuda && !arguments.no_gpu;
    let found = arguments.photographs(kind, &mut workspace, &stop).and_then(|(photos, infos)| {
        let cameras =
            Cameras { arguments, colmap: &colmap, stop: &stop, photos: &photos, infos: &infos, gpu };
        let found = cameras.find(&mut workspace)?;
        Ok((photos, found))
    });
    let (photos, found) = match found {
        Ok(found) => found,
        Err(error) => return Err(arguments.leave(workspace, error)),
    };
    let images = match (photos.in_place, photos.video) {
        (true, _) => None,
        (false, true) => Some(photos.folder.clone()),
        (false, false) => Some(arguments.link(&photos, &workspace)?),
    };
    workspace.finish(&found.model, images.as_deref())?;
    arguments.report(&photos, &found, dataset, start.elapsed().as_secs_f64());
    Ok(())
}

/// Photographs whose cameras are to be found.
struct PhotoFiles {
    folder: PathBuf,
    names: Vec<String>,
    in_place: bool,
    /// True for frames of a video, in the folder of the unfinished work.
    video: bool,
}

/// The source after the checks that precede any writing.
enum Kind<'a> {
    /// Photographs, with the names of the undamaged ones.
    Photos(&'a Photos, Vec<String>, Vec<PhotoInfo>),
    Video(&'a Path, Video, usize),
}

impl Arguments {
    fn reader<'a>(&'a self, path: &'a Path, stop: &'a AtomicBool) -> Reader<'a> {
        Reader { program: &self.ffmpeg, path, max_bytes: self.host.memory().limit(), stop }
    }

    fn note(&self, text: &str) {
        if !self.quiet {
            errln!("{text}");
        }
    }

    fn check(&self, source: &Source) -> Result<()> {
        let unused = [("--frames", self.frames.is_some()), ("--every", self.every.is_some())];
        let unused = unused.iter().find(|(_, given)| *given);
        match (source, unused) {
            (Source::Photos(_), Some((option, _))) => {
                Err(Error::argument(*option, "is for videos, and this is a folder of photographs"))
            }
            _ => Ok(()),
        }
    }

    /// Examines the photographs or the video. Also returns a summary.
    fn prepare<'a>(&self, source: &'a Source, stop: &AtomicBool) -> Result<(Kind<'a>, String)> {
        match source {
            Source::Photos(photos) => {
                let (count, folder) = (photos.names.len(), photos.folder.display());
                if count < MIN_PHOTOS {
                    let photographs = if count == 1 { "photograph" } else { "photographs" };
                    let problem = format!("has {count} {photographs}, too few to find their cameras");
                    let remedy = "take 20 or more, from all around, each overlapping the next by two thirds";
                    return Err(Error::input(&photos.folder, problem, remedy));
                }
                let (names, infos) = self.infos(photos, stop)?;
                let count = names.len();
                if let Some((others, one)) = &photos.others {
                    let they =
                        if *others == 1 { "1 picture is".into() } else { format!("{others} pictures are") };
                    errln!(
                        "warning: {folder}: {they} left out, {one} for example: only JPEG and PNG are read"
                    );
                }
                let place = match photos.in_place {
                    true => "they stay where they are".to_owned(),
                    false => format!("hard links to them go to {}", photos.dataset.join("images").display()),
                };
                let summary = format!("{count} photographs in {folder}; {place}");
                Ok((Kind::Photos(photos, names, infos), summary))
            }
            Source::Video(path, _) => {
                let video = self.reader(path, stop).probe()?;
                let request =
                    FrameRequest { frames: self.frames.map(|frames| frames as usize), every: self.every };
                let count = request.of(&video);
                if request.requested(&video).is_some_and(|requested| requested > count) {
                    errln!("warning: {}: {count} frames are taken, no more are possible", path.display());
                }
                if count < MIN_PHOTOS {
                    let problem = format!("{count} frames are too few to find their cameras");
                    return Err(Error::input(
                        path,
                        problem,
                        "give a longer video, or take frames more often",
                    ));
                }
                let (seconds, frames) = (video.seconds, thousands(video.frames as u64));
                let summary = format!("{} with {frames} frames in {seconds:.1} s", path.display());
                Ok((Kind::Video(path, video, count), summary))
            }
        }
    }

    /// Reads all photographs once, so that damage is found now and not after hours. Damaged ones are skipped if enough
    /// are sound.
    fn infos(&self, photos: &Photos, stop: &AtomicBool) -> Result<(Vec<String>, Vec<PhotoInfo>)> {
        let bar = counting_in("checking", "photographs", photos.names.len() as u64, self.quiet);
        let memory = self.host.memory();
        let info = |name: &String| {
            session::check(stop)?;
            let path = photos.folder.join(name);
            Photo::read_within(&path, [0.0; 3], &memory)?;
            bar.inc(1);
            Ok(PhotoInfo::of(&path, photo_size(&path)?))
        };
        let infos: Vec<Result<PhotoInfo>> = photos.names.par_iter().map(info).collect();
        bar.finish_and_clear();
        session::check(stop)?;
        let damaged = infos.iter().filter(|info| info.is_err()).count();
        let enough = infos.len() - damaged >= MIN_PHOTOS;
        let (mut sound, mut left_out) = ((Vec::new(), Vec::new()), 0);
        for (name, info) in photos.names.iter().zip(infos) {
            match info {
                Ok(info) => {
                    sound.0.push(name.clone());
                    sound.1.push(info);
                }
                // Too little memory or no permission is not the photograph's fault.
                Err(error @ Error::Input { .. }) if enough => {
                    left_out += 1;
                    if left_out <= MAX_REPORTED {
                        errln!("warning: left out: {error}");
                    }
                }
                Err(error) if damaged == 1 => return Err(error),
                Err(error) => {
                    let more = format!("{error} (and {} more)", damaged - 1);
                    return Err(Error::argument("photographs", more));
                }
            }
        }
        if left_out > MAX_REPORTED {
            errln!("warning: left out: {} more", left_out - MAX_REPORTED);
        }
        Ok(sound)
    }

    /// Returns the photographs as files; extracts a video's frames.
    fn photographs(
        &self,
        kind: Kind,
        workspace: &mut Workspace,
        stop: &AtomicBool,
    ) -> Result<(PhotoFiles, Vec<PhotoInfo>)> {
        let (path, video, count) = match kind {
            Kind::Photos(Photos { folder, in_place, .. }, names, infos) => {
                let (folder, in_place) = (folder.clone(), *in_place);
                return Ok((PhotoFiles { folder, names, in_place, video: false }, infos));
            }
            Kind::Video(path, video, count) => (path, video, count),
        };
        let key = format!("{count} of {}", cameras::fingerprint(path)?);
        let folder = workspace.path("frames");
        if !workspace.has_frames(&key) {
            let begin = Instant::now();
            workspace.note_frames(None)?;
            workspace.fresh_folder("frames")?;
            let bar = counting_in("frames", "seconds", video.seconds.ceil() as u64, self.quiet);
            let looked_at = |seconds: f64| bar.set_position(seconds as u64);
            let kept = self.reader(path, stop).pick(&video, count, &folder, &looked_at);
            bar.finish_and_clear();
            let kept = kept?;
            workspace.note_frames(Some(key))?;
            let each = video.seconds / count as f64;
            let took = time(begin.elapsed().as_secs_f64());
            self.note(&format!("frames      {took}: {kept}, the sharpest of every {each:.2} s"));
        } else {
            self.note("frames      there already");
        }
        let entries = std::fs::read_dir(&folder).map_err(|e| Error::io(&folder, "read", e))?;
        let mut names: Vec<String> =
            entries.flatten().filter_map(|e| e.file_name().into_string().ok()).collect();
        names.sort();
        let size = names.first().map(|name| photo_size(folder.join(name))).transpose()?.unwrap_or_default();
        let infos = vec![PhotoInfo { size, lens: String::new() }; names.len()];
        Ok((PhotoFiles { folder, names, in_place: false, video: true }, infos))
    }

    /// Cleans up after an unfinished run. Keeps COLMAP's log and what a second run can use.
    fn leave(&self, workspace: Workspace, error: Error) -> Error {
        let interrupted = matches!(error, Error::Interrupted);
        if !workspace.is_worth_keeping() && (interrupted || !workspace.path(workspace::LOG_FILE).exists()) {
            workspace.abandon();
            return error;
        }
        if interrupted {
            self.note(&format!(
                "interrupted: the same command goes on from here ({})",
                workspace.folder.display()
            ));
        }
        error
    }

    fn link(&self, photos: &PhotoFiles, workspace: &Workspace) -> Result<PathBuf> {
        let folder = workspace.fresh_folder("images")?;
        let copies = workspace::link_photos(&photos.folder, &photos.names, &folder)?;
        if copies > 0 {
            self.note(&format!("{copies} photographs were copied: there can be no hard links from there"));
        }
        Ok(folder)
    }

    /// Chooses the photographs to compare, with a note.
    fn matcher(&self, photographs: usize, gpu: bool) -> (Matcher, String) {
        let matcher = match self.matcher.as_str() {
            "exhaustive" => Matcher::Exhaustive,
            "sequential" => Matcher::Sequential,
            _ if photographs <= EXHAUSTIVE[usize::from(gpu)] => Matcher::Exhaustive,
            _ => Matcher::Sequential,
        };
        let summary = match matcher {
            Matcher::Exhaustive => {
                let pairs = thousands((photographs * photographs.saturating_sub(1) / 2) as u64);
                format!("exhaustive, {pairs} pairs")
            }
            Matcher::Sequential => {
                "sequential: each with its neighbours by name (--matcher exhaustive: with all)".into()
            }
        };
        (matcher, summary)
    }

    fn report(&self, photos: &PhotoFiles, found: &Reconstruction, dataset: &Path, seconds: f64) {
        let what = if photos.video { "frames" } else { "photographs" };
        let (all, registered) = (photos.names.len(), found.registered.len());
        if found.models > 1 {
            errln!(
                "warning: the {what} fall into {} groups without connection; the largest is the data set: more {what} between \
                 them would join them",
                found.models
            );
        }
        let missing: Vec<&str> = photos
            .names
            .iter()
            .map(String::as_str)
            .filter(|name| !found.registered.contains(*name))
            .collect();
        if !missing.is_empty() {
            let more = missing.len().saturating_sub(LISTED);
            let more = if more > 0 { format!(" and {more} more") } else { String::new() };
            let some = missing[..missing.len().min(LISTED)].join(", ");
            let remedy = if photos.video { " (--frames takes more)" } else { "" };
            errln!(
                "warning: no camera was found for {some}{more}: blurred, or too little overlap with the others{remedy}"
            );
        }
        outln!("registered      {registered} of {all} {what}");
        outln!("points          {}", thousands(found.points as u64));
        outln!("data set        {}", dataset.display());
        outln!("time            {}", time(seconds));
        let model = ashsplat_program::model::usual_folder(dataset);
        let (dataset, model) = (quoted(&dataset.to_string_lossy()), quoted(&model));
        outln!("check it        ashsplat info {dataset}");
        outln!("train           ashsplat train -s {dataset} -m {model} --eval");
        outln!("look at it      ashsplat view {model}");
    }
}

/// "4.2 s" or "12:34".
fn time(seconds: f64) -> String {
    if seconds < 60.0 { format!("{seconds:.1} s") } else { clock(seconds) }
}

struct StageBar {
    bar: indicatif::ProgressBar,
    /// Steps that earlier runs have done.
    before: AtomicU64,
}

impl StageBar {
    fn new(what: &'static str, unit: &'static str, total: usize, quiet: bool) -> Self {
        Self { bar: counting_in(what, unit, total as u64, quiet), before: AtomicU64::new(0) }
    }

    fn update(&self, progress: colmap::ColmapProgress) {
        match progress {
            colmap::ColmapProgress::Steps(done, all) => {
                if self.before.load(Ordering::Relaxed) == 0 && self.bar.length() < Some(all) {
                    self.bar.set_length(all);
                }
                self.bar.set_position(self.before.load(Ordering::Relaxed) + done);
            }
            colmap::ColmapProgress::Registered(count) => self.bar.set_position(count),
        }
    }
}

impl Drop for StageBar {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}
