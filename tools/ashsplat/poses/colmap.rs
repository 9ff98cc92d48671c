//! Runs COLMAP: finds its version, builds its commands, reads its progress.

use ashsplat::{Error, Result};
use ashsplat_program::child::{self, LoggedOutput};
use std::ffi::{OsStr, OsString};
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::atomic::AtomicBool;

const INSTALL: &str = "`apt install colmap` on Debian and Ubuntu, `brew install colmap` on macOS, the ZIP of \
                       https://github.com/colmap/colmap/releases on Windows, elsewhere `conda install -c conda-forge colmap`; \
                       --colmap gives its path";
/// Largest side of photographs for features on a processor, pixels. Beyond, memory and time grow and cameras hardly get
/// better.
const MAX_SIDE_WITHOUT_GPU: u32 = 2000;

/// Number of blocks of photographs that are compared with each other.
const BLOCKS: usize = 6;

#[derive(Clone, Debug, PartialEq)]
pub struct Colmap {
    program: OsString,
    /// "COLMAP 3.8"
    pub version: String,
    /// True if it can use a GPU.
    pub cuda: bool,
    /// Options that select the GPU. Newer versions have other names for them.
    gpu_of_features: Option<String>,
    gpu_of_matches: Option<String>,
    /// Options for the largest side of a photograph and for the most features. Newer versions have other names for them too.
    max_image_size: Option<String>,
    max_num_features: Option<String>,
}

impl Colmap {
    /// Asks the program for its version and options.
    ///
    /// # Errors
    /// [`Error::Argument`], with commands to install it.
    pub fn find(program: &OsStr) -> Result<Self> {
        let features = help(program, "feature_extractor")?;
        let matches = help(program, "exhaustive_matcher")?;
        Self::of_help(program, &features, &matches).ok_or_else(|| {
            let first_line = features.lines().find(|line| !line.trim().is_empty()).unwrap_or("nothing").trim();
            let name = program.to_string_lossy();
            Error::argument("COLMAP", format!("`{name} feature_extractor -h` says {first_line:?}, not what COLMAP says; COLMAP is installed by {INSTALL}"))
        })
    }

    fn of_help(program: &OsStr, features: &str, matches: &str) -> Option<Self> {
        features.contains("--ImageReader.camera_model").then(|| Self {
            program: program.to_owned(),
            version: version(features).unwrap_or_else(|| "COLMAP".to_owned()),
            cuda: features.contains("with CUDA"),
            gpu_of_features: option(features, "use_gpu"),
            gpu_of_matches: option(matches, "use_gpu"),
            max_image_size: option(features, "max_image_size"),
            max_num_features: option(features, "max_num_features"),
        })
    }

    /// Command that extracts features from the photographs of a list.
    pub fn features(&self, job: &Job, list: &Path, single_camera: bool) -> Vec<OsString> {
        let mut args = vec!["feature_extractor".into()];
        args.extend(job.database());
        args.extend(["--image_path".into(), job.photos.clone().into()]);
        args.extend(["--image_list_path".into(), list.into()]);
        args.extend(["--ImageReader.camera_model".into(), job.camera_model.clone().into()]);
        args.extend(["--ImageReader.single_camera".into(), switch(single_camera)]);
        args.extend(chosen(&self.max_num_features, job.max_features.to_string()));
        if !job.gpu {
            args.extend(chosen(&self.max_image_size, MAX_SIDE_WITHOUT_GPU.to_string()));
        }
        args.extend(chosen(&self.gpu_of_features, switch(job.gpu)));
        args
    }

    /// Command that compares `photographs` photographs.
    pub fn matches(&self, job: &Job, matcher: Matcher, photographs: usize) -> Vec<OsString> {
        let mut args = vec![matcher.command().into()];
        args.extend(job.database());
        if matcher == Matcher::Exhaustive {
            // COLMAP reports progress once per pair of blocks.
            let block = photographs.div_ceil(BLOCKS).clamp(4, 50).to_string();
            args.extend(["--ExhaustiveMatching.block_size".into(), block.into()]);
        }
        args.extend(chosen(&self.gpu_of_matches, switch(job.gpu)));
        args
    }

    /// Command that places the cameras; models go to `folder/0`, `folder/1`, …
    pub fn mapping(&self, job: &Job, folder: &Path) -> Vec<OsString> {
        let mut args = vec!["mapper".into()];
        args.extend(job.database());
        args.extend(["--image_path".into(), job.photos.clone().into()]);
        args.extend(["--output_path".into(), folder.into()]);
        if job.video {
            // Neighbouring frames are near each other. COLMAP's automatic_reconstructor uses this for videos.
            args.extend(["--Mapper.init_min_tri_angle".into(), "8".into()]);
        }
        args
    }

    /// Runs COLMAP with these arguments; its output is appended to `log`.
    ///
    /// # Errors
    /// Same as [`child::run_logged`].
    pub fn run(
        &self,
        args: &[OsString],
        log: &Path,
        stop: &AtomicBool,
        progress: &(dyn Fn(ColmapProgress) + Sync),
    ) -> Result<LoggedOutput> {
        let mut command = Command::new(&self.program);
        // Without it, COLMAP opens windows, even without a display.
        command.args(args).env("QT_QPA_PLATFORM", "offscreen");
        let text: Vec<_> = args.iter().map(|word| word.to_string_lossy()).collect();
        let file = File::options().create(true).append(true).open(log);
        file.and_then(|mut file| writeln!(file, "$ {} {}", self.program.to_string_lossy(), text.join(" ")))
            .map_err(|e| Error::io(log, "write", e))?;
        let update = |line: &str| ColmapProgress::of(line).into_iter().for_each(progress);
        child::run_logged(command, log, stop, &update)
    }
}

#[derive(Clone, Debug)]
pub struct Job {
    pub database: PathBuf,
    /// The folder of the photographs.
    pub photos: PathBuf,
    pub camera_model: String,
    pub max_features: u32,
    pub gpu: bool,
    pub video: bool,
}

impl Job {
    fn database(&self) -> [OsString; 2] {
        ["--database_path".into(), self.database.clone().into()]
    }
}

fn switch(on: bool) -> OsString {
    if on { "1".into() } else { "0".into() }
}

/// An option and its value, if this version has the option.
fn chosen(option: &Option<String>, value: impl Into<OsString>) -> Vec<OsString> {
    option.iter().map(OsString::from).zip([value.into()]).flat_map(|(name, value)| [name, value]).collect()
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Matcher {
    /// Each with every other.
    Exhaustive,
    /// Each with its neighbours by name.
    Sequential,
}

impl Matcher {
    pub fn unit(self) -> &'static str {
        match self {
            Matcher::Exhaustive => "blocks of pairs",
            Matcher::Sequential => "photographs",
        }
    }

    fn command(self) -> &'static str {
        match self {
            Self::Exhaustive => "exhaustive_matcher",
            Self::Sequential => "sequential_matcher",
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ColmapProgress {
    /// Finished steps, and all steps.
    Steps(u64, u64),
    /// Number of photographs with a camera.
    Registered(u64),
}

impl ColmapProgress {
    fn of(line: &str) -> Option<Self> {
        if line.contains("Registering image") {
            // "Registering image #5 (3)"; in newer versions "(num_reg_frames=3)".
            let (_, last) = line.rsplit_once('(')?;
            return number(last).map(Self::Registered);
        }
        // "Processed file [3/11]", "Matching image [3/11]", "Matching block [1/2, 2/2]", in newer versions "Processing …".
        let known = [
            "Processed file [",
            "Matching image [",
            "Matching block [",
            "Processing image [",
            "Processing block [",
        ];
        let rest = known.iter().find_map(|words| Some(line.split_once(words)?.1))?;
        let inside = rest.split_once(']')?.0;
        let mut parts = inside.split(',').map(|part| {
            let (done, all) = part.split_once('/')?;
            Some((number(done)?, number(all)?))
        });
        match (parts.next()??, parts.next()) {
            ((done, all), None) => Some(Self::Steps(done, all)),
            ((row, rows), Some(column)) => {
                let (column, columns) = column?;
                Some(Self::Steps(
                    row.saturating_sub(1).saturating_mul(columns).saturating_add(column),
                    rows.saturating_mul(columns),
                ))
            }
        }
    }
}

/// The first number in a text.
fn number(text: &str) -> Option<u64> {
    let start = text.find(|c: char| c.is_ascii_digit())?;
    let digits = &text[start..];
    let end = digits.find(|c: char| !c.is_ascii_digit()).unwrap_or(digits.len());
    digits[..end].parse().ok()
}

/// Help of a COLMAP command, from stdout or stderr.
fn help(program: &OsStr, command: &str) -> Result<String> {
    let result = Command::new(program)
        .args([command, "-h"])
        .env("QT_QPA_PLATFORM", "offscreen")
        .stdin(Stdio::null())
        .output();
    let output = result.map_err(|e| {
        let name = program.to_string_lossy();
        Error::argument("poses", format!("{}: {INSTALL}", child::not_started(&name, &e)))
    })?;
    Ok([output.stdout, output.stderr].map(|bytes| String::from_utf8_lossy(&bytes).into_owned()).join("\n"))
}

/// "COLMAP 3.8" from "COLMAP 3.8 (Commit Unknown on Unknown without CUDA)".
fn version(help: &str) -> Option<String> {
    let start = help.find("COLMAP ")?;
    let words: Vec<&str> = help[start..].split_whitespace().take(2).collect();
    words.get(1).is_some_and(|word| word.starts_with(|c: char| c.is_ascii_digit())).then(|| words.join(" "))
}

/// The option "--GROUP.name" of any group.
fn option(help: &str, name: &str) -> Option<String> {
    let is_it = |word: &&str| {
        word.strip_prefix("--").and_then(|word| word.split_once('.')).is_some_and(|(_, rest)| rest == name)
    };
    help.split_whitespace().find(is_it).map(str::to_owned)
}

#[cfg(test)]
mod tests {
    use super::*;

    const OLD: &str = "COLMAP 3.8 (Commit Unknown on Unknown without CUDA)\n\nOptions can\n  --ImageReader.camera_model arg \
                       (=SIMPLE_RADIAL)\n  --SiftExtraction.num_threads arg (=-1)\n  --SiftExtraction.use_gpu arg (=1)\n  \
                       --SiftExtraction.max_image_size arg (=3200)\n  --SiftExtraction.max_num_features arg (=8192)\n";
    const NEW: &str = "I20260105 12:00:00.000000 1 option_manager.cc:80] COLMAP 3.13.0 (Commit 1a2b3c on 2025-11-07 with CUDA)\n\
                       --ImageReader.camera_model arg\n  --FeatureExtraction.use_gpu arg (=1)\n  \
                       --FeatureExtraction.max_image_size arg (=3200)\n  --SiftExtraction.max_num_features arg (=8192)\n";

    fn args(args: Vec<OsString>) -> String {
        let args: Vec<String> = args.into_iter().map(|word| word.into_string().expect("text")).collect();
        args.join(" ")
    }

    fn job(gpu: bool, video: bool) -> Job {
        Job {
            database: "w/database.db".into(),
            photos: "my photos".into(),
            camera_model: "OPENCV".into(),
            max_features: 4096,
            gpu,
            video,
        }
    }

    #[test]
    fn names_of_options_follow_the_version() {
        let program = OsStr::new("colmap");
        let old = Colmap::of_help(program, OLD, "  --SiftMatching.use_gpu arg (=1)").expect("COLMAP");
        assert_eq!((old.version.as_str(), old.cuda), ("COLMAP 3.8", false));
        let new = Colmap::of_help(program, NEW, "--FeatureMatching.use_gpu arg").expect("COLMAP");
        assert_eq!((new.version.as_str(), new.cuda), ("COLMAP 3.13.0", true));
        assert_eq!(
            args(old.features(&job(false, false), Path::new("w/list"), true)),
            "feature_extractor --database_path w/database.db --image_path my photos --image_list_path w/list \
             --ImageReader.camera_model OPENCV --ImageReader.single_camera 1 --SiftExtraction.max_num_features 4096 \
             --SiftExtraction.max_image_size 2000 --SiftExtraction.use_gpu 0"
        );
        let features = args(new.features(&job(true, false), Path::new("w/list"), false));
        assert!(features.ends_with(
            "single_camera 0 --SiftExtraction.max_num_features 4096 --FeatureExtraction.use_gpu 1"
        ));
        let features = args(new.features(&job(false, false), Path::new("w/list"), false));
        assert!(features.ends_with(
            "--SiftExtraction.max_num_features 4096 --FeatureExtraction.max_image_size 2000 --FeatureExtraction.use_gpu 0"
        ));
        assert_eq!(
            args(new.matches(&job(false, true), Matcher::Sequential, 90)),
            "sequential_matcher --database_path w/database.db --FeatureMatching.use_gpu 0"
        );
        let without = Colmap::of_help(program, "COLMAP 9\n--ImageReader.camera_model", "").expect("COLMAP");
        assert_eq!(
            args(without.matches(&job(true, false), Matcher::Exhaustive, 60)),
            "exhaustive_matcher --database_path w/database.db --ExhaustiveMatching.block_size 10"
        );
        assert!(
            args(without.features(&job(false, false), Path::new("l"), true)).ends_with("single_camera 1")
        );
        let mapping = |video| args(old.mapping(&job(false, video), Path::new("w/sparse")));
        assert!(mapping(false).ends_with("--image_path my photos --output_path w/sparse"));
        assert!(mapping(true).ends_with("--Mapper.init_min_tri_angle 8"));
        assert_eq!(Colmap::of_help(program, "usage: colmap [-h]", ""), None);
    }

    #[test]
    fn progress_is_read_from_all_versions() {
        let progress = ColmapProgress::of;
        assert_eq!(progress("Processed file [3/11]"), Some(ColmapProgress::Steps(3, 11)));
        assert_eq!(
            progress("I20260105 12:00:00 1 feature_extraction.cc:258] Processed file [3/11]"),
            Some(ColmapProgress::Steps(3, 11))
        );
        assert_eq!(progress("Matching block [2/3, 1/3] in 6.997s"), Some(ColmapProgress::Steps(4, 9)));
        assert_eq!(
            progress("I1 pairing.cc:1] Processing block [3/3, 3/3]"),
            Some(ColmapProgress::Steps(9, 9))
        );
        assert_eq!(progress("Matching image [7/50] in 0.1s"), Some(ColmapProgress::Steps(7, 50)));
        assert_eq!(progress("Registering image #5 (3)"), Some(ColmapProgress::Registered(3)));
        assert_eq!(
            progress("I1 a.cc:1] Registering image #5 (num_reg_frames=12)"),
            Some(ColmapProgress::Registered(12))
        );
        for other in
            ["", "  Name: [3/11]", "Processed file [x/11]", "Matching block [1/1, 1]", "Registering image"]
        {
            assert_eq!(progress(other), None, "{other}");
        }
    }
}
