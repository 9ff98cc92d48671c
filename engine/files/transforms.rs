//! `transforms.json`: the cameras of nerfstudio, instant-ngp and the synthetic NeRF scenes.
//!
//! Poses map the camera (x right, y up, z backward) to the world, which is used unchanged. Intrinsics are
//! shared or per frame: `fl_x fl_y cx cy w h` or `camera_angle_x`, and `k1 k2 k3 k4 p1 p2` with
//! `camera_model`.
//!
//! nerfstudio's converters of Polycam and Record3D (its `polycam_utils.py` and `record3d_utils.py`) write such a file: with
//! intrinsics per frame, `depth_file_path` and points of the GLB (`ply_file_path`), and with shared intrinsics, whose principal
//! point they put in the middle.

use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet, HashSet};
use std::ffi::OsStr;
use std::path::{Path, PathBuf};

use glam::{DAffine3, DMat3, DVec3, dvec2};
use serde_json::error::Category;
use serde_json::value::RawValue;
use serde_json::{Map, Value};

use crate::names::{
    Finder, MAX_PATH_BYTES, ending, entries, first_with, has_photo_ending, plain, stays_inside,
};
use crate::{cost, ply, regular_file, text};
use ashsplat::scene::camera::MAX_IMAGE_SIDE;
use ashsplat::scene::{Camera, PhotoLens, Projection, Readout, Shutter, SourcePoints};
use ashsplat::{Error, Result};

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
            let (warnings, depth_maps) = read_frames(path, &document, &mut all.frames)?;
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
            let rows = matrix(value)
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
const MAX_BYTES: usize = 1 << 16;

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
        if bytes > MAX_BYTES && (key == "file_path" || MASK_KEYS.contains(&key.as_str())) {
            let problem = format!("{key} has {bytes} bytes; {MAX_PATH_BYTES} are possible for a path");
            return Err(Error::input(path, problem, DAMAGED));
        }
        let is_used = bytes <= MAX_BYTES || LISTS.contains(&key.as_str());
        if is_used && key != "frames" {
            let parsed = serde_json::from_str(value.get());
            let problem = |e| Error::input(path, format!("{key} is not JSON: {e}"), DAMAGED);
            values.insert(key.clone(), parsed.map_err(problem)?);
        }
    }
    Ok(Value::Object(values))
}

/// Largest relative deviation of a pose's `R Rᵀ` from a multiple of the identity.
const ROTATION_TOLERANCE: f64 = 1e-3;
/// Pose at the last row of a rolling shutter, whose first has the usual one, and the order of its rows or columns. Both keys are
/// this project's own: nerfstudio has none.
const END_KEY: &str = "transform_matrix_end";
const SHUTTER_KEY: &str = "shutter";
/// Largest difference from 1 of a scale that is taken as 1.
const SCALE_ROUNDING: f64 = 1e-12;

/// A photo and its camera.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    /// The photo's path below the file's folder, as the file names it, with its extension.
    pub name: String,
    /// Path of the photo.
    pub photo_path: PathBuf,
    /// The photo's mask (`mask_path`), if the file names one.
    pub mask_path: Option<PathBuf>,
    /// Rotation from the file's coordinates to the camera's axes (x right, y down, z forward). With a rolling shutter, the pose is
    /// that halfway.
    pub camera_from_source: DMat3,
    /// Translation from the file's coordinates to the camera.
    pub translation: DVec3,
    /// Rolling shutter, if the file has a second pose. Its shift is in the file's units.
    pub shutter: Option<Shutter>,
    /// The frame's intrinsics.
    pub optics: Optics,
    /// Radius around the picture's middle beyond which a fisheye shows nothing (`fisheye_crop_radius`), pixels.
    pub rim_px: Option<f64>,
    /// True if the frame is held out.
    pub test: bool,
}

/// Intrinsics that may lack the photo's size.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Optics {
    /// Width and height, pixels, if the file has them.
    pub size: Option<[u32; 2]>,
    /// Focal lengths in x and y. A missing one equals the other: pixels are square.
    focal: [Option<Focal>; 2],
    /// Principal point, pixels; the image's centre by default.
    center: [Option<f64>; 2],
    projection: Projection,
    /// In the order that [`Projection`] lists.
    coefficients: [f64; 12],
}

/// A focal length, or the angle that determines it.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Focal {
    Pixels(f64),
    /// Angle from edge to edge, radians.
    Angle(f64),
}

impl Focal {
    /// Focal length of a picture with this side, pixels.
    fn pixels(self, side: f64) -> f64 {
        match self {
            Self::Pixels(focal) => focal,
            Self::Angle(angle) => 0.5 * side / (0.5 * angle).tan(),
        }
    }
}

impl Optics {
    /// Width and height, or values proportional to them; `None` if the file has neither.
    pub(crate) fn sides(&self) -> Option<[f64; 2]> {
        let middle = || Some([self.center[0]?, self.center[1]?]);
        self.size.map(|size| size.map(f64::from)).or_else(middle)
    }

    /// The lens for photos of this size.
    pub fn lens(&self, width: u32, height: u32) -> PhotoLens {
        let sides = [f64::from(width), f64::from(height)];
        let pixels = |axis: usize| Some(self.focal[axis]?.pixels(sides[axis]));
        let [fx, fy] =
            [pixels(0).or(pixels(1)), pixels(1).or(pixels(0))].map(|focal| focal.unwrap_or(f64::NAN));
        let [cx, cy] = [0, 1].map(|axis| self.center[axis].unwrap_or(0.5 * sides[axis]));
        let Self { projection, coefficients, .. } = *self;
        if projection == Projection::Equirectangular {
            return PhotoLens::panorama(width, height);
        }
        let (focal_px, center_px) = (dvec2(fx, fy), dvec2(cx, cy));
        PhotoLens { focal_px, center_px, width, height, projection, coefficients }.without_zeros()
    }
}

/// Rows of `transform_matrix`: from the camera's axes, with y up and z backward, to the world of its centre.
pub fn opengl_rows(camera_from_world: DMat3, center: DVec3) -> [[f64; 4]; 4] {
    let axes = camera_from_world.transpose();
    let row = |r: usize| [axes.x_axis[r], -axes.y_axis[r], -axes.z_axis[r], center[r]];
    [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]]
}

/// The first three rows of a matrix of 3 or 4 rows with 4 finite numbers.
fn matrix(value: &Value) -> Option<[[f64; 4]; 3]> {
    let rows = value.as_array().filter(|rows| matches!(rows.len(), 3 | 4))?;
    let row = |row: &Value| -> Option<[f64; 4]> {
        let numbers: Option<Vec<f64>> = row.as_array()?.iter().map(Value::as_f64).collect();
        numbers?.try_into().ok().filter(|row: &[f64; 4]| row.iter().all(|v| v.is_finite()))
    };
    let rows: Option<Vec<[f64; 4]>> = rows.iter().map(row).collect();
    rows?.get(..3)?.try_into().ok()
}

/// Appends the frames of a file. Returns the warnings, and the number of frames that name a depth map.
fn read_frames(
    path: &Path,
    document: &Document<'_>,
    frames: &mut Vec<Frame>,
) -> Result<(Vec<String>, usize)> {
    let Some(list) = &document.frames else {
        return Err(Error::input(path, "has no list `frames`", "is it a transforms.json?"));
    };
    if list.is_empty() {
        let remedy = "the cameras were not found: compute them again";
        return Err(Error::input(path, "the list `frames` is empty", remedy));
    }
    let (shown, document) = (path.display(), &document.values);
    let finder = RefCell::new(Finder::default());
    let split = Split::of(path, document)?;
    let (mut warnings, mut met) = (Vec::new(), HashSet::new());
    let (count, mut elsewhere, mut unused, mut depth_maps) = (list.len(), 0, 0, 0);
    let mut lens_keys = BTreeSet::new();
    unused_lens_keys(document, &mut lens_keys);
    let mut unused_keys = BTreeSet::new();
    if document["test_frames"].as_array().is_some_and(|frames| !frames.is_empty()) {
        unused_keys.insert("test_frames".to_owned());
    }
    let (mut times, mut contradiction) = (f64::INFINITY..f64::NEG_INFINITY, None);
    if !document[END_KEY].is_null() {
        unused_keys.insert(format!("{END_KEY} outside the frames"));
    }
    let mut uses_shutter = document[SHUTTER_KEY].is_null();
    for (index, raw) in list.iter().enumerate() {
        // A frame that is no object has no file_path.
        let value = values(path, serde_json::from_str(raw.get()).unwrap_or_default())?;
        let reader = FrameReader { path, index, frame: &value, document, finder: &finder };
        let (mut frame, led_out) = reader.read()?;
        elsewhere += usize::from(led_out);
        uses_shutter |= frame.shutter.is_some();
        unused_lens_keys(&value, &mut lens_keys);
        contradiction = contradiction.take().or_else(|| reader.contradiction(frame.optics.size));
        if let Some(time) = value["time"].as_f64() {
            times = times.start.min(time)..times.end.max(time);
        }
        depth_maps += usize::from(DEPTH_KEYS.iter().any(|key| value[key].is_string()));
        unused_keys.extend(value.as_object().into_iter().flatten().filter_map(|(key, value)| {
            let is_known = MASK_KEYS.contains(&key.as_str()) || DEPTH_KEYS.contains(&key.as_str());
            let names_file = value.is_string() && (key.contains("mask") || key.contains("depth"));
            (names_file && !is_known || key == "is_bad" && *value == true).then(|| key.clone())
        }));
        if frame.optics.projection == Projection::Fisheye {
            let (_, p) = reader.coefficients()?;
            lens_keys.extend(
                ["p1", "p2"].into_iter().zip(p).filter(|(_, p)| *p != 0.0).map(|(key, _)| key.into()),
            );
        }
        let names = [plain(value["file_path"].as_str().unwrap_or_default()), frame.name.clone()];
        let held_out = split.is_held_out(&names);
        met.extend(names);
        match held_out {
            None => unused += 1,
            Some(held_out) => {
                frame.test = held_out;
                frames.push(frame);
            }
        }
    }
    if !uses_shutter {
        unused_keys.insert(format!("{SHUTTER_KEY} without {END_KEY}"));
    }
    split.check(path, &met)?;
    if elsewhere > 0 {
        warnings.push(format!(
            "{shown}: {elsewhere} of {count} paths lead out of its folder: the photos in it whose paths end as theirs are taken"
        ));
    }
    if !lens_keys.is_empty() {
        let verb = if lens_keys.len() == 1 { "is" } else { "are" };
        let keys = Vec::from_iter(lens_keys).join(", ");
        warnings.push(format!(
            "{shown}: {keys} {verb} of the lens not used, and the photos are taken as if it were 0: undistort them first if they show it"
        ));
    }
    warnings.extend(contradiction);
    if !unused_keys.is_empty() {
        let keys = Vec::from_iter(unused_keys).join(", ");
        warnings.push(format!("{shown}: {keys}: such keys are not used"));
    }
    if times.start < times.end {
        let (start, end) = (times.start, times.end);
        warnings.push(format!(
            "{shown}: its frames are of times from {start} to {end}: the scene is taken as one that does not move"
        ));
    }
    if unused > 0 {
        let lists = split.used_lists();
        warnings.push(format!(
            "{shown}: {unused} of {count} frames are in none of the lists {lists} and are not used"
        ));
    }
    Ok((warnings, depth_maps))
}

/// Adds unsupported lens keys that have an effect in other programs.
fn unused_lens_keys(holder: &Value, keys: &mut BTreeSet<String>) {
    /// Skew and affinity of Metashape, further coefficients of OpenCV, and keys of nerfstudio and instant-ngp.
    const SHORT_KEYS: [&str; 13] =
        ["b1", "b2", "k5", "k6", "p3", "p4", "s1", "s2", "s3", "s4", "skew", "sk_x", "sk_y"];
    const KEYS: [&str; 3] = ["distortion", DISTORTION_PARAMS, "rolling_shutter"];
    fn is_set(value: &Value) -> bool {
        match value {
            Value::Number(number) => number.as_f64() != Some(0.0),
            Value::Array(values) => values.iter().any(is_set),
            Value::Object(_) => true,
            _ => false,
        }
    }
    let is_used = |key: &str, value: &Value| key == DISTORTION_PARAMS && numbers_of(value).is_some();
    let all = holder.as_object().into_iter().flatten();
    let has_effect =
        |key: &str| SHORT_KEYS.contains(&key) || KEYS.contains(&key) || key.starts_with("ftheta_");
    let unused = all.filter(|(key, value)| has_effect(key) && is_set(value) && !is_used(key, value));
    keys.extend(unused.map(|(key, _)| key.clone()));
}

/// Keys of the path of a frame's mask; the first is nerfstudio's.
const MASK_KEYS: [&str; 3] = ["mask_path", "mask_file_path", "mask_filename"];
/// Keys of the path of a frame's depth map, of nerfstudio and instant-ngp.
const DEPTH_KEYS: [&str; 2] = ["depth_file_path", "depth_path"];
/// nerfstudio's list of k1, k2, k3, k4, p1 and p2, which takes precedence over single keys.
const DISTORTION_PARAMS: &str = "distortion_params";

fn numbers_of(params: &Value) -> Option<[f64; 6]> {
    let numbers: Option<Vec<f64>> = params.as_array()?.iter().map(Value::as_f64).collect();
    numbers?.try_into().ok()
}

struct FrameReader<'a> {
    path: &'a Path,
    index: usize,
    frame: &'a Value,
    document: &'a Value,
    finder: &'a RefCell<Finder>,
}

impl FrameReader<'_> {
    fn error(&self, problem: impl std::fmt::Display) -> Error {
        let problem = format!("frame {}: {problem}", self.index);
        Error::input(self.path, problem, "correct the file or compute it again")
    }

    /// Reads the frame. The flag is true if its path led out of the folder.
    fn read(&self) -> Result<(Frame, bool)> {
        let Some(file_path) = self.frame["file_path"].as_str() else {
            return Err(self.error("has no file_path"));
        };
        let (name, photo_path, led_out) = self.photo(file_path)?;
        let mask = MASK_KEYS.iter().find_map(|&key| Some((key, self.frame[key].as_str()?)));
        let mask_path = mask.map(|(key, name)| self.mask(key, name)).transpose()?;
        let ((camera_from_source, translation), shutter) = self.motion()?;
        let optics = self.optics()?;
        let rim_px = self.number("fisheye_crop_radius")?.filter(|radius| *radius > 0.0);
        let frame = Frame {
            name,
            photo_path,
            mask_path,
            camera_from_source,
            translation,
            shutter,
            optics,
            rim_px,
            test: false,
        };
        Ok((frame, led_out))
    }

    fn mask(&self, key: &str, name: &str) -> Result<PathBuf> {
        self.check_length(key, name)?;
        let mut finder = self.finder.borrow_mut();
        let inside = below(name);
        let found = inside.as_deref().and_then(|name| finder.file(self.folder(), name));
        let found = found.or_else(|| finder.file_by_end(self.folder(), &plain(name)));
        found.or_else(|| Some(self.folder().join(inside?))).ok_or_else(|| self.leaves(name))
    }

    fn folder(&self) -> &Path {
        self.path.parent().unwrap_or(Path::new(""))
    }

    fn check_length(&self, key: &str, name: &str) -> Result<()> {
        match name.len() {
            0..=MAX_PATH_BYTES => Ok(()),
            bytes => {
                Err(self.error(format!("{key} is a path of {bytes} bytes; {MAX_PATH_BYTES} are possible")))
            }
        }
    }

    fn leaves(&self, name: &str) -> Error {
        let name = ending(name);
        self.error(format!("the path {name:?} leads out of the folder, and nothing in it has that name"))
    }

    /// The photo's name and path, and true if the name led out of the folder. Without an extension, it is a PNG's.
    fn photo(&self, named: &str) -> Result<(String, PathBuf, bool)> {
        self.check_length("file_path", named)?;
        let mut finder = self.finder.borrow_mut();
        let mut name = plain(named);
        let led_out = !stays_inside(&name);
        let found = match led_out {
            false => finder.photo(self.folder(), &name).unwrap_or_else(|| self.folder().join(&name)),
            true => {
                // The path is from another machine or folder: searches for the photo's name here.
                let found = finder.photo_by_end(self.folder(), &name).map_err(|two| {
                    let [first, second] = two.map(|photo| photo.display().to_string());
                    self.error(format!("the path {:?} may mean {first} or {second}", ending(named)))
                })?;
                let path = found.ok_or_else(|| self.leaves(named))?;
                let end = path.strip_prefix(self.folder()).unwrap_or(&path);
                name = plain(&end.to_string_lossy());
                path
            }
        };
        let path = match found.is_file() || has_photo_ending(&found) {
            true => found,
            false => PathBuf::from(format!("{}.png", found.display())),
        };
        if !has_photo_ending(Path::new(&name)) {
            let ending = path.extension().unwrap_or_default().to_string_lossy();
            name = format!("{name}.{ending}");
        }
        Ok((name, path, led_out))
    }

    /// Reads the pose, and with one at the last row that halfway and the rolling shutter.
    fn motion(&self) -> Result<((DMat3, DVec3), Option<Shutter>)> {
        let first = self.pose("transform_matrix")?;
        if self.frame[END_KEY].is_null() {
            return Ok((first, None));
        }
        let last = self.pose(END_KEY)?;
        let orders = [&self.frame[SHUTTER_KEY], &self.document[SHUTTER_KEY]];
        let readout = match orders.into_iter().find(|order| !order.is_null()) {
            None => Readout::default(),
            Some(order) => {
                let wrong = |problem: String| self.error(format!("{SHUTTER_KEY}: {problem}"));
                Readout::named(order.as_str().unwrap_or(&order.to_string())).map_err(wrong)?
            }
        };
        let (halfway, shutter) = Shutter::between(first, last, readout);
        Ok((halfway, Some(shutter)))
    }

    fn pose(&self, key: &str) -> Result<(DMat3, DVec3)> {
        let value = &self.frame[key];
        if value.is_null() {
            return Err(self.error(format!("has no {key}")));
        }
        let Some(rows) = matrix(value) else {
            return Err(self.error(format!("{key} is not of 3 or 4 rows of 4 finite numbers")));
        };
        let last: Vec<f64> = value[3].as_array().into_iter().flatten().filter_map(Value::as_f64).collect();
        if last.iter().zip([0.0, 0.0, 0.0, 1.0]).any(|(given, right)| (given - right).abs() > SCALE_ROUNDING)
        {
            let problem = format!("the last row of {key} is {last:?} and not 0, 0, 0, 1: is it transposed?");
            return Err(self.error(problem));
        }
        let column = |c: usize| DVec3::from_array(std::array::from_fn(|r| rows[r][c]));
        let axes = DMat3::from_cols(column(0), column(1), column(2));
        let scale = axes.determinant().cbrt();
        // A rotation up to the rounding of doubles is used bit for bit.
        let rotation = if (scale - 1.0).abs() < SCALE_ROUNDING { axes } else { axes * (1.0 / scale) };
        let off = rotation * rotation.transpose() - DMat3::IDENTITY;
        // Also refuses a scale of 0, which gives NaN.
        if !(scale > 0.0 && off.to_cols_array().iter().all(|v| v.abs() < ROTATION_TOLERANCE)) {
            return Err(self.error(format!("{key} is no rotation with a translation")));
        }
        // Converts from y up, z backward to y down, z forward.
        let camera_from_source = DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0)) * rotation.transpose();
        // Same order as for COLMAP's files, so that both layouts of a camera give the same bits.
        Ok((camera_from_source, -(camera_from_source * column(3))))
    }

    /// Reads a number of the frame, or else of the file. Other types are errors.
    fn number(&self, key: &str) -> Result<Option<f64>> {
        let holders = [("", &self.frame[key]), ("the file's ", &self.document[key])];
        let Some((holder, value)) = holders.into_iter().find(|(_, value)| !value.is_null()) else {
            return Ok(None);
        };
        let number = value.as_f64().filter(|v| v.is_finite());
        number.map(Some).ok_or_else(|| self.error(format!("{holder}{key} is not a number")))
    }

    fn optics(&self) -> Result<Optics> {
        let mut size = [0; 2];
        for (side, key) in size.iter_mut().zip(["w", "h"]) {
            if let Some(pixels) = self.number(key)? {
                let sides = 1.0..=f64::from(MAX_IMAGE_SIDE);
                *side = if sides.contains(&pixels) { pixels as u32 } else { 0 };
                if *side == 0 {
                    let problem = format!("{key} is {pixels}; 1 to {MAX_IMAGE_SIDE} pixels are possible");
                    return Err(self.error(problem));
                }
            }
        }
        let size = (size[0] > 0 && size[1] > 0).then_some(size);
        let focal = [self.focal("fl_x", "camera_angle_x")?, self.focal("fl_y", "camera_angle_y")?];
        let (projection, coefficients) = self.lens()?;
        // The size of a panorama says all.
        if focal == [None; 2] && projection != Projection::Equirectangular {
            return Err(self.error("has no camera: neither fl_x nor camera_angle_x, nor has the file"));
        }
        let center = [self.number("cx")?, self.number("cy")?];
        Ok(Optics { size, focal, center, projection, coefficients })
    }

    /// A warning if a focal length and an angle contradict each other, both of the frame or both of the document.
    fn contradiction(&self, size: Option<[u32; 2]>) -> Option<String> {
        /// Ratio from which the difference is visible.
        const SHOWS: f64 = 1.02;
        let ways = [("fl_x", "camera_angle_x"), ("fl_y", "camera_angle_y")];
        size?.into_iter().zip(ways).find_map(|(side, (pixels, angle))| {
            let holder = if self.frame[pixels].is_null() { self.document } else { self.frame };
            let (focal, radians) = (holder[pixels].as_f64()?, holder[angle].as_f64()?);
            let other = Focal::Angle(radians).pixels(side.into());
            let ratio = focal / other;
            (ratio.max(ratio.recip()) > SHOWS).then(|| {
                let (path, index) = (self.path.display(), self.index);
                format!(
                    "{path}: frame {index}: {pixels} is {focal}, {angle} means {other:.1}: {pixels} is used"
                )
            })
        })
    }

    fn focal(&self, pixels: &str, angle: &str) -> Result<Option<Focal>> {
        match self.number(pixels)? {
            Some(focal) if focal > 0.0 => return Ok(Some(Focal::Pixels(focal))),
            Some(focal) => return Err(self.error(format!("{pixels} is {focal}, which is not positive"))),
            None => {}
        }
        match self.number(angle)? {
            Some(value) if value > 0.0 && value < std::f64::consts::PI => Ok(Some(Focal::Angle(value))),
            Some(value) => Err(self.error(format!(
                "{angle} is {value} radians; more than 0 and less than pi are possible (are these degrees?)"
            ))),
            None => Ok(None),
        }
    }

    fn coefficients(&self) -> Result<([f64; 4], [f64; 2])> {
        let lists = [&self.frame[DISTORTION_PARAMS], &self.document[DISTORTION_PARAMS]];
        if let Some([k1, k2, k3, k4, p1, p2]) = lists.into_iter().find_map(numbers_of) {
            return Ok(([k1, k2, k3, k4], [p1, p2]));
        }
        let mut k = [0.0; 4];
        for (k, key) in k.iter_mut().zip(["k1", "k2", "k3", "k4"]) {
            *k = self.number(key)?.unwrap_or(0.0);
        }
        Ok((k, [self.number("p1")?.unwrap_or(0.0), self.number("p2")?.unwrap_or(0.0)]))
    }

    fn lens(&self) -> Result<(Projection, [f64; 12])> {
        let ([k1, k2, k3, k4], [p1, p2]) = self.coefficients()?;
        let model =
            [&self.frame["camera_model"], &self.document["camera_model"]].into_iter().find_map(Value::as_str);
        let is_fisheye = self.frame["is_fisheye"] == true || self.document["is_fisheye"] == true;
        let mut coefficients = [0.0; 12];
        let projection = match model {
            Some("OPENCV_FISHEYE" | "FISHEYE" | "SIMPLE_FISHEYE") => Projection::Fisheye,
            Some("OPENCV" | "RADIAL" | "SIMPLE_RADIAL" | "PINHOLE" | "SIMPLE_PINHOLE" | "PERSPECTIVE")
            | None => match is_fisheye {
                true => Projection::Fisheye,
                false => Projection::Brown,
            },
            Some("EQUIRECTANGULAR") => return Ok((Projection::Equirectangular, coefficients)),
            Some(other) => return Err(self.error(format!("camera_model {other:?} is not known"))),
        };
        match projection {
            Projection::Fisheye => {
                [coefficients[0], coefficients[1], coefficients[4], coefficients[5]] = [k1, k2, k3, k4]
            }
            // Their k4 is a fourth coefficient of the numerator, unlike COLMAP's.
            _ => coefficients[..9].copy_from_slice(&[k1, k2, p1, p2, k3, 0.0, 0.0, 0.0, k4]),
        }
        Ok((projection, coefficients))
    }
}

/// Returns a camera's lens as the file has it: `camera_model`, `k1` to `k4`, `p1` and `p2`. None for lenses that it cannot hold.
pub fn lens_keys(camera: &Camera) -> Option<(&'static str, [f32; 4], [f32; 2])> {
    let [k1, k2, p1, p2, k3, k4, third, fourth, n4, ..] = camera.coefficients;
    match camera.projection {
        Projection::Perspective => Some(("PINHOLE", [0.0; 4], [0.0; 2])),
        Projection::Brown if [k4, third, fourth] == [0.0; 3] => Some(("OPENCV", [k1, k2, k3, n4], [p1, p2])),
        Projection::Fisheye if [p1, p2, third, fourth] == [0.0; 4] => {
            Some(("OPENCV_FISHEYE", [k1, k2, k3, k4], [0.0; 2]))
        }
        Projection::Equirectangular => Some(("EQUIRECTANGULAR", [0.0; 4], [0.0; 2])),
        _ => None,
    }
}

/// Keys of the name lists. The first held-out list that exists is used; they come last.
const LISTS: [&str; 3] = ["train_filenames", "test_filenames", "val_filenames"];

/// The names of each list; empty for a list that is missing.
struct Split([HashSet<String>; 3]);

impl Split {
    fn of(path: &Path, document: &Value) -> Result<Self> {
        let names = |key: &str| match &document[key] {
            Value::Null => Some(HashSet::new()),
            Value::Array(names) => names.iter().map(|name| Some(plain(name.as_str()?))).collect(),
            _ => None,
        };
        let mut lists: [HashSet<String>; 3] = Default::default();
        for (list, key) in lists.iter_mut().zip(LISTS) {
            let wrong = || Error::input(path, format!("{key} is not a list of names"), "correct the file");
            *list = names(key).ok_or_else(wrong)?;
        }
        Ok(Self(lists))
    }

    /// True if the frame with this path or name is held out; `None` if it is not used. Without a training list, frames in
    /// no list are training frames.
    fn is_held_out(&self, names: &[String; 2]) -> Option<bool> {
        let [train, test, val] = self.0.each_ref().map(|list| names.iter().any(|name| list.contains(name)));
        match if self.0[1].is_empty() { val } else { test } {
            true => Some(true),
            false if train || self.0[0].is_empty() && !val => Some(false),
            false => None,
        }
    }

    /// Refuses a list with a name that no frame has.
    fn check(&self, path: &Path, met: &HashSet<String>) -> Result<()> {
        for (list, key) in self.0.iter().zip(LISTS) {
            if let Some(name) = list.difference(met).min() {
                let problem = format!("{key} names {name:?}, which no frame has as its file_path");
                return Err(Error::input(path, problem, "correct the list or add the frame"));
            }
        }
        Ok(())
    }

    fn used_lists(&self) -> String {
        let held_out = if self.0[1].is_empty() { 2 } else { 1 };
        let used = [0, held_out].into_iter().filter(|&at| !self.0[at].is_empty());
        used.map(|at| LISTS[at]).collect::<Vec<_>>().join(" and ")
    }
}
