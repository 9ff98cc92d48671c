//! `transforms.json`: the cameras of nerfstudio, instant-ngp and the synthetic NeRF scenes.
//!
//! Poses map the camera (x right, y up, z backward) to the world, which is used unchanged. Intrinsics are
//! shared or per frame: `fl_x fl_y cx cy w h` or `camera_angle_x`, and `k1 k2 k3 k4 p1 p2` with
//! `camera_model`.
//!
//! nerfstudio's converters of Polycam and Record3D (its `polycam_utils.py` and `record3d_utils.py`) write such a file: with
//! intrinsics per frame, `depth_file_path` and points of the GLB (`ply_file_path`), and with shared intrinsics, whose principal
//! point they put in the middle.

mod frame;

use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::path::{Path, PathBuf};

use glam::{DAffine3, DMat3, DVec3};
use serde_json::error::Category;
use serde_json::value::RawValue;
use serde_json::{Map, Value};

use crate::names::{Finder, MAX_PATH_BYTES, ending, entries, first_with, plain, stays_inside};
use crate::{cost, ply, regular_file, text};
use ashsplat::scene::SourcePoints;
use ashsplat::{Error, Result};

pub use frame::{Frame, Optics, lens_keys, opengl_rows};

/// Files of the synthetic NeRF scenes: for training, and for testing (the first that exists).
const SPLIT_FILES: [&str; 3] = ["transforms_train.json", "transforms_test.json", "transforms_val.json"];
/// The file of nerfstudio and instant-ngp.
const SINGLE_FILE: &str = "transforms.json";

/// Contents of the files.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Transforms {
    /// The file with the training views.
    pub source: PathBuf,
    /// The frames of all files, in their order. `test` is set if a file or list marks the frame as held out.
    pub frames: Vec<Frame>,
    /// True if the files specify the held-out frames.
    pub has_split: bool,
    /// The points, if there are any.
    pub points: SourcePoints,
    /// Number of frames that name a depth map. Depth maps are not read here.
    pub depth_maps: usize,
    /// Oddities that did not prevent reading.
    pub warnings: Vec<String>,
    /// One line about what was read.
    pub note: String,
}

/// The files of a data set; `None` if it is not of this kind, or ambiguous. Files with poses under similar names count:
/// `transform.json`, `transform_train.json`.
pub fn find(dataset: &Path) -> Option<Vec<PathBuf>> {
    if let Some(single) = Finder::default().file(dataset, SINGLE_FILE) {
        return Some(vec![single]);
    }
    let mut files = files_with_poses(dataset);
    let mut take = |word: &str, usual: &str| {
        let is_usual = |file: &PathBuf| name_of(file).eq_ignore_ascii_case(usual);
        let of_word = |file: &PathBuf| name_of(file).to_ascii_lowercase().contains(word);
        let all: Vec<PathBuf> = files.extract_if(.., |file| is_usual(file) || of_word(file)).collect();
        match (all.iter().find(|file| is_usual(file)), all.as_slice()) {
            (Some(usual), _) | (None, [usual]) => Ok(Some(usual.clone())),
            (None, []) => Ok(None),
            (None, _) => Err(()),
        }
    };
    let [train, test, val] = SPLIT_FILES.map(|usual| take(&usual[11..usual.len() - 5], usual));
    let (train, test, val) = (train.ok()?, test.ok()?, val.ok()?);
    match (train, files.as_slice(), test, val) {
        (Some(train), _, test, val) => Some([train].into_iter().chain(test.or(val)).collect()),
        (None, [only], None, None) => Some(vec![only.clone()]),
        (None, [], Some(only), None) | (None, [], None, Some(only)) => Some(vec![only]),
        _ => None,
    }
}

/// JSON files in a folder that have poses or a name of such files.
pub(crate) fn files_with_poses(folder: &Path) -> Vec<PathBuf> {
    /// Poses begin near the start of their file.
    const START_BYTES: u64 = 1 << 20;
    let has_poses = |path: &Path| {
        cost::step();
        let start = regular_file::start(path, START_BYTES).unwrap_or_default();
        String::from_utf8_lossy(&start).contains("\"transform_matrix\"")
    };
    // Editors on Windows may add `.txt`, which Windows hides.
    let is_json = |path: &PathBuf| {
        let name = name_of(path).to_ascii_lowercase();
        name.strip_suffix(".txt").unwrap_or(&name).ends_with(".json")
    };
    let is_usual = |path: &Path| SPLIT_FILES.iter().any(|name| name_of(path).eq_ignore_ascii_case(name));
    let of_poses = |path: &PathBuf| is_json(path) && path.is_file() && (is_usual(path) || has_poses(path));
    let mut files: Vec<PathBuf> = entries(folder).map(|entry| entry.path()).filter(of_poses).collect();
    files.sort_unstable();
    files
}

/// Names the data set's files with usual names that are not used. `used` is `None` for a COLMAP model.
pub(crate) fn unused(dataset: &Path, used: Option<&[PathBuf]>) -> Option<String> {
    let usual = [SINGLE_FILE].into_iter().chain(SPLIT_FILES).map(|name| dataset.join(name));
    let is_unused = |file: &PathBuf| file.is_file() && !used.is_some_and(|used| used.contains(file));
    let names: Vec<String> = usual.filter(is_unused).map(|file| name_of(&file).to_owned()).collect();
    // Other programs ignore a split's validation photographs too, so these need no warning.
    let has_news = names.iter().any(|name| name != SPLIT_FILES[2]);
    let instead = used.map_or("the COLMAP model", |files| files.first().map_or("", |file| name_of(file)));
    has_news.then(|| format!("{}: not used, because {instead} is", names.join(", ")))
}

fn name_of(path: &Path) -> &str {
    path.file_name().and_then(OsStr::to_str).unwrap_or_default()
}

impl Transforms {
    /// Reads the files of a data set, the training views first, and the points that they name.
    pub fn read(files: &[PathBuf]) -> Result<Self> {
        let source = files.first().cloned().unwrap_or_default();
        let mut all = Self { source, has_split: files.len() > 1, ..Self::default() };
        if let [file, ..] = files
            && ![SINGLE_FILE, SPLIT_FILES[0]].contains(&name_of(file))
        {
            all.warnings.push(format!("{}: taken for {SINGLE_FILE}, which is not there", file.display()));
        }
        let mut clouds = Vec::new();
        for (index, path) in files.iter().enumerate() {
            let text = text::read(path)?;
            if text.trim_ascii().is_empty() {
                return Err(Error::input(path, "is empty", "download or copy it again"));
            }
            let document = Document::parse(path, &text)?;
            let before = all.frames.len();
            let (warnings, depth_maps) = frame::read_all(path, &document, &mut all.frames)?;
            all.warnings.extend(warnings);
            all.depth_maps += depth_maps;
            all.frames[before..].iter_mut().for_each(|frame| frame.test |= index > 0);
            all.has_split |= all.frames.iter().any(|frame| frame.test);
            clouds.extend(cloud(path, &document.values, &mut all.warnings)?);
        }
        let cloud = clouds.into_iter().next();
        let points = cloud.as_ref().map_or("none", |(path, _)| name_of(path));
        let shared = all.frames.windows(2).all(|pair| pair[0].optics == pair[1].optics);
        let whose = if shared { "one camera" } else { "cameras of their own" };
        let (source, count) = (all.source.display(), all.frames.len());
        all.note = format!("{source}: poses of {count} frames with {whose}; points: {points}");
        if let Some((path, applied)) = cloud {
            all.points = ply::read_points(&path, &mut all.warnings)?;
            all.place_points(&path, applied);
        }
        Ok(all)
    }

    /// Chooses the frame of the points. Older files of nerfstudio hold them in the frame before `applied_transform` and
    /// `applied_scale`. The frame in which the cameras see more points is used.
    fn place_points(&mut self, path: &Path, applied: Option<DAffine3>) {
        const SAMPLE: usize = 500;
        const APPLIED: &str = "applied_transform (with applied_scale)";
        let Some(applied) = applied.filter(|a| !a.abs_diff_eq(DAffine3::IDENTITY, 1e-6)) else { return };
        let step = self.points.len().div_ceil(SAMPLE).max(1);
        let sample: Vec<DVec3> = self.points.positions.iter().copied().step_by(step).collect();
        let seen = |place: &dyn Fn(DVec3) -> DVec3| -> usize {
            let in_view = |frame: &Frame, point: DVec3| frame.sees(place(point));
            self.frames.iter().map(|frame| sample.iter().filter(|&&p| in_view(frame, p)).count()).sum()
        };
        let (as_stored, moved) = (seen(&|p| p), seen(&|p| applied.transform_point3(p)));
        let path = path.display();
        if moved > as_stored + as_stored / 2 {
            self.points.positions.iter_mut().for_each(|point| *point = applied.transform_point3(*point));
            self.warnings
                .push(format!("{path}: the points lie in the frame before {APPLIED}, and were moved"));
        } else if as_stored < moved + moved / 2 {
            self.warnings.push(format!(
                "{path}: the cameras see as many points before {APPLIED} as after it: the points stay where they are"
            ));
        }
    }
}

const DAMAGED: &str =
    "the file is damaged or cut short, or holds numbers that JSON does not have (NaN): write it again";

fn not_json(path: &Path, text: &str, error: &serde_json::Error) -> Error {
    let remedy = match has_decimal_comma(text, error) {
        true => "a number there has a decimal comma: write it with a point",
        false => DAMAGED,
    };
    Error::input(path, format!("is not JSON: {error}"), remedy)
}

/// True if a JSON error comes from a decimal comma.
fn has_decimal_comma(text: &str, error: &serde_json::Error) -> bool {
    let line = text.lines().nth(error.line().saturating_sub(1)).unwrap_or_default().as_bytes();
    let before = &line[..error.column().min(line.len())];
    let number = before.iter().rposition(|byte| !byte.is_ascii_digit()).filter(|&at| before[at] == b',');
    number.is_some_and(|at| at + 1 < before.len() && before[..at].last().is_some_and(u8::is_ascii_digit))
}

/// The point cloud that a file names or that lies beside it, and the transform that was applied to the poses.
fn cloud(
    path: &Path,
    document: &Value,
    warnings: &mut Vec<String>,
) -> Result<Option<(PathBuf, Option<DAffine3>)>> {
    let error = |problem: &str| Error::input(path, problem, "write it again");
    let mut applied = match &document["applied_transform"] {
        Value::Null => None,
        value => {
            let rows = frame::matrix(value)
                .ok_or_else(|| error("applied_transform is not a matrix of 3 or 4 rows of 4 numbers"))?;
            let column = |c: usize| DVec3::from_array(std::array::from_fn(|r| rows[r][c]));
            let axes = DMat3::from_cols(column(0), column(1), column(2));
            Some(DAffine3::from_mat3_translation(axes, column(3)))
        }
    };
    if !document["applied_scale"].is_null() {
        let scale = document["applied_scale"].as_f64().filter(|scale| *scale > 0.0);
        let scale = scale.ok_or_else(|| error("applied_scale is not a number above 0"))?;
        applied = Some(DAffine3::from_scale(DVec3::splat(scale)) * applied.unwrap_or_default());
    }
    let named = match &document["ply_file_path"] {
        Value::String(name) => Some(named_cloud(path, name, warnings)?),
        _ => cloud_beside(path, warnings),
    };
    Ok(named.map(|file| (file, applied)))
}

/// Finds the point cloud that a file names, or one below its folder whose path ends the same.
fn named_cloud(path: &Path, named: &str, warnings: &mut Vec<String>) -> Result<PathBuf> {
    let (folder, mut finder) = (path.parent().unwrap_or(Path::new("")), Finder::default());
    let inside = below(named);
    if let Some(file) = inside.as_deref().and_then(|name| finder.file(folder, name)) {
        return Ok(file);
    }
    if let Some(file) = finder.file_by_end(folder, &plain(named)) {
        let (path, named, found) = (path.display(), ending(named), file.display());
        warnings.push(format!("{path}: ply_file_path {named:?} is not there; {found} is taken for it"));
        return Ok(file);
    }
    match inside {
        Some(name) => {
            let remedy = "copy it there, or remove ply_file_path: training then starts from random points";
            Err(Error::input(folder.join(name), "the point cloud of transforms.json is missing", remedy))
        }
        None => {
            let problem = format!("ply_file_path {:?} leads out of the folder", ending(named));
            Err(Error::input(path, problem, "copy the file into it"))
        }
    }
}

/// Finds a point cloud with a usual name beside a file that names none.
pub(crate) fn cloud_beside(path: &Path, warnings: &mut Vec<String>) -> Option<PathBuf> {
    /// The reference implementation uses the first name for the synthetic scenes.
    const USUAL: [&str; 8] =
        ["points3d", "sparse_pc", "pointcloud", "point_cloud", "points", "sparse", "input", "pcd"];
    let folder = path.parent().unwrap_or(Path::new(""));
    let (lacks, remedy) = match path.extension().is_some_and(|ending| ending == "json") {
        true => ("has no ply_file_path", "name it there"),
        false => ("names no points", "call it points3d.ply"),
    };
    let mut finder = Finder::default();
    let mut found = USUAL.into_iter().filter_map(|name| finder.file(folder, &format!("{name}.ply")));
    if let Some(file) = found.next() {
        let others: String = found.map(|other| format!(", {} is not", other.display())).collect();
        if !file.ends_with("points3d.ply") || !others.is_empty() {
            let (path, file) = (path.display(), file.display());
            warnings.push(format!("{path}: {lacks}: the points of {file} are used{others}"));
        }
        return Some(file);
    }
    if let Some(other) = first_with(folder, &["ply"]) {
        let (path, other) = (path.display(), other.display());
        warnings.push(format!("{path}: {lacks}: {other} is not used; {remedy} if it has the points"));
    }
    let of_colmap = ["colmap/sparse/0", "sparse/0"].map(|place| folder.join(place));
    if let Some(model) = of_colmap.iter().find(|model| model.join("points3D.bin").is_file()) {
        let points = folder.join("points3D.ply");
        let (model, points) = (model.display(), points.display());
        warnings.push(format!(
            "{model}: its points are not used; `colmap model_converter --input_path {model} --output_path {points} --output_type PLY` \
             puts them where they are"
        ));
    }
    None
}

fn below(name: &str) -> Option<String> {
    Some(plain(name)).filter(|name| stays_inside(name))
}

impl Frame {
    fn sees(&self, point: DVec3) -> bool {
        let p = self.camera_from_source * point + self.translation;
        // About 30 degrees to each side: the field of view is not known yet.
        p.z > 0.0 && p.x.abs() < p.z * 0.6 && p.y.abs() < p.z * 0.6
    }
}

/// Longest value that is kept, bytes, except for the lists of names. A longer one has no known key, and would take up to
/// 200 times its bytes of memory.
const MOST_BYTES: usize = 1 << 16;

/// A file whose frames are not parsed yet.
struct Document<'a> {
    /// All values except the frames.
    values: Value,
    /// `None` without a list of frames.
    frames: Option<Vec<&'a RawValue>>,
}

impl<'a> Document<'a> {
    fn parse(path: &Path, text: &'a str) -> Result<Self> {
        let raw: RawObject<'_> = serde_json::from_str(text).map_err(|e| match e.classify() {
            Category::Data => {
                let problem = "the top value is not an object with frames";
                Error::input(path, problem, "is it another kind of JSON?")
            }
            _ => not_json(path, text, &e),
        })?;
        let frames = raw.get("frames").and_then(|list| serde_json::from_str(list.get()).ok());
        Ok(Self { values: values(path, raw)?, frames })
    }
}

type RawObject<'a> = BTreeMap<String, &'a RawValue>;

/// Parses the values of an object, except the frames and what is too long to be of use.
fn values(path: &Path, raw: RawObject<'_>) -> Result<Value> {
    let mut values = Map::new();
    for (key, value) in raw {
        let bytes = value.get().len();
        if bytes > MOST_BYTES && (key == "file_path" || frame::MASK_KEYS.contains(&key.as_str())) {
            let problem = format!("{key} has {bytes} bytes; {MAX_PATH_BYTES} are possible for a path");
            return Err(Error::input(path, problem, DAMAGED));
        }
        let is_used = bytes <= MOST_BYTES || frame::LISTS.contains(&key.as_str());
        if is_used && key != "frames" {
            let parsed = serde_json::from_str(value.get());
            let problem = |e| Error::input(path, format!("{key} is not JSON: {e}"), DAMAGED);
            values.insert(key.clone(), parsed.map_err(problem)?);
        }
    }
    Ok(Value::Object(values))
}
