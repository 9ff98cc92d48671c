//! Finds the model of a data set, or says what its folder has instead.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

use super::model::{Model, ModelFolder};
use super::records;
use crate::names::{has_video_ending, holds_photos, quoted};
use crate::{photogrammetry, transforms};
use ashsplat::{Error, Result};

impl Model {
    /// Finds and reads the model of a data set.
    pub fn of_dataset(dataset: impl AsRef<Path>) -> Result<Self> {
        Self::read(&find(dataset)?)
    }
}

/// Folder within a data set's in which `ashsplat poses` works until its cameras are found.
pub const UNFINISHED_POSES: &str = "poses.unfinished";
/// Log in a data set's folder: the COLMAP commands of `ashsplat poses`, and their output.
pub const POSES_LOG: &str = "poses.log";

const PARTS: [&str; 3] = ["cameras", "images", "points3D"];

/// Finds the model of a data set: `sparse/N`, `sparse`, or the folder itself. Among several `sparse/N`, the one with
/// the most registered images wins, then with the most points, then with the lowest name.
pub fn find(dataset: impl AsRef<Path>) -> Result<ModelFolder> {
    let dataset = dataset.as_ref();
    match fs::metadata(dataset) {
        Err(source) => return Err(Error::io(dataset, "read", source)),
        Ok(metadata) if !metadata.is_dir() => {
            let remedy = if dataset.extension().is_some_and(|ending| ending == "json") {
                "give the folder in which it lies".to_owned()
            } else if has_video_ending(dataset) {
                format!("{} makes a data set of a video", poses(dataset))
            } else {
                "give the folder that contains sparse/ and images/, or transforms.json".to_owned()
            };
            return Err(Error::input(dataset, "is not a folder, nor a ZIP", remedy));
        }
        Ok(_) => {}
    }
    match candidates(dataset)?.as_slice() {
        [] => Err(no_model(dataset)),
        [only] => describe(only.clone(), None),
        several => largest(several),
    }
}

/// True if a data set has a model at one of the places of [`find`].
pub fn exists(dataset: impl AsRef<Path>) -> bool {
    candidates(dataset.as_ref()).is_ok_and(|folders| !folders.is_empty())
}

/// The folders with models below `sparse`, or else `sparse` or the data set itself.
fn candidates(dataset: &Path) -> Result<Vec<PathBuf>> {
    let sparse = dataset.join("sparse");
    let mut below = subfolders(&sparse)?;
    below.retain(|folder| has_model(folder));
    if below.is_empty() {
        below = [sparse, dataset.to_owned()].into_iter().filter(|folder| has_model(folder)).take(1).collect();
    }
    Ok(below)
}

/// True if a folder has a model, or the cameras of a transforms.json or of a photogrammetry program.
pub fn is_data_set(folder: &Path) -> bool {
    exists(folder) || transforms::find(folder).is_some() || !photogrammetry::find(folder, "images").is_empty()
}

/// Largest age difference between two forms of a model that one program wrote.
const CONVERSION: Duration = Duration::from_secs(5);

/// Camera files of other programs, and these programs' names.
const FOREIGN_CAMERAS: [(&str, &str); 6] = [
    ("reconstruction.json", "OpenSfM"),
    ("opensfm/reconstruction.json", "OpenSfM"),
    ("sfm_data.json", "OpenMVG"),
    ("bundle.out", "Bundler"),
    ("poses_bounds.npy", "LLFF"),
    ("cameras.json", "a trained model"),
];

/// The error for a missing model. Its remedy depends on what the folder holds instead.
fn no_model(dataset: &Path) -> Error {
    let problem = "has no COLMAP model (sparse/0/cameras.bin or .txt) and no transforms.json";
    let place = dataset.display();
    let mut below = subfolders(dataset).unwrap_or_default();
    below.retain(|folder| is_data_set(folder));
    let files: Vec<String> =
        transforms::files_with_poses(dataset).iter().map(|file| file.display().to_string()).collect();
    let remedy = if !files.is_empty() {
        let files = files.join(", ");
        format!(
            "several files have poses ({files}): call one transforms.json, or transforms_train.json and transforms_test.json"
        )
    } else if let [only] = below.as_slice() {
        format!("give {}, which has one", only.display())
    } else if let Some(program) = app_of_raw_data(dataset) {
        format!(
            "raw data of {program} become a data set by `ns-process-data {program} --data {place} --output-dir OUT`"
        )
    } else if dataset.join(UNFINISHED_POSES).is_dir() {
        "its cameras are not found yet: run the same `ashsplat poses` once more, it goes on from there".into()
    } else if let Some((file, program)) =
        FOREIGN_CAMERAS.iter().find(|(file, _)| dataset.join(file).is_file())
    {
        format!(
            "{file} has the cameras of {program}, which is not read: export them for COLMAP, or as transforms.json"
        )
    } else if holds_photos(dataset) {
        format!("photos alone are not enough: {} finds their cameras", poses(dataset))
    } else {
        "give the folder that contains sparse/0 and images, as COLMAP or its image_undistorter leave it"
            .into()
    };
    Error::input(dataset, problem, remedy)
}

/// nerfstudio's name of the app that left its raw data in a folder.
fn app_of_raw_data(folder: &Path) -> Option<&'static str> {
    let of_record3d = folder.join("rgb").is_dir() && folder.join("metadata.json").is_file();
    let of_polycam = folder.join("keyframes").is_dir();
    of_polycam.then_some("polycam").or_else(|| of_record3d.then_some("record3d"))
}

/// The command that finds the cameras of photos or of a video, quoted for a shell.
fn poses(source: &Path) -> String {
    format!("`ashsplat poses {}`", quoted(&source.to_string_lossy()))
}

fn describe(folder: PathBuf, warning: Option<String>) -> Result<ModelFolder> {
    let missing = |ending| PARTS[..2].iter().find(|part| !folder.join(format!("{part}.{ending}")).is_file());
    let text = match (missing("bin"), missing("txt")) {
        (None, _) => false,
        (_, None) => true,
        (Some(part), _) => {
            let problem = format!("the model has no {part}.bin (nor a whole text model)");
            return Err(Error::input(&folder, problem, "copy the whole model of COLMAP"));
        }
    };
    // A program that writes one form leaves the other form unchanged.
    let changed = |part: &str, ending| {
        fs::metadata(folder.join(format!("{part}.{ending}"))).and_then(|file| file.modified()).ok()
    };
    let unused = || {
        let is_newer = |part: &&&str| {
            let later = changed(part, "bin").map(|time| time + CONVERSION);
            !text && later.is_some() && changed(part, "txt") > later
        };
        let part = PARTS.iter().find(is_newer)?;
        Some(format!("{}: {part}.txt is newer than {part}.bin, which is used", folder.display()))
    };
    let warning = warning.or_else(unused);
    Ok(ModelFolder { folder, list: None, text, warning })
}

fn largest(candidates: &[PathBuf]) -> Result<ModelFolder> {
    // max_by_key returns the last of equal ones, so that the reversed order returns the first.
    let sizes = candidates.iter().rev().map(|folder| (claimed_size(folder), folder));
    let Some(((images, _), folder)) = sizes.max_by_key(|(size, _)| *size) else {
        return Err(Error::argument("candidates", "there are none"));
    };
    let warning =
        format!("{} models; using {}, the largest ({images} images)", candidates.len(), folder.display());
    describe(folder.clone(), Some(warning))
}

/// Registered images and points by the counts in the model's files; 0 if they cannot be read.
fn claimed_size(folder: &Path) -> (u64, u64) {
    let Ok(found) = describe(folder.to_owned(), None) else { return (0, 0) };
    let images = match found.text {
        true => records::images(&found.file(PARTS[1])).map_or(0, |images| images.len() as u64),
        false => records::claimed_count(&found.file(PARTS[1])),
    };
    (images, records::claimed_count(&found.file(PARTS[2])))
}

fn has_model(folder: &Path) -> bool {
    let file =
        |part: &&str| ["bin", "txt"].iter().any(|ending| folder.join(format!("{part}.{ending}")).is_file());
    PARTS[..2].iter().any(file)
}

/// Subfolders, `2` before `10`; empty if the folder does not exist.
fn subfolders(folder: &Path) -> Result<Vec<PathBuf>> {
    let entries = match fs::read_dir(folder) {
        Ok(entries) => entries,
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(source) => return Err(Error::io(folder, "read", source)),
    };
    let mut found: Vec<PathBuf> =
        entries.filter_map(|e| e.ok().map(|e| e.path())).filter(|p| p.is_dir()).collect();
    found.sort_by_cached_key(|path| {
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        (name.parse().unwrap_or(u64::MAX), name)
    });
    Ok(found)
}
