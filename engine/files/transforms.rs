//! `transforms.json`: the cameras of nerfstudio, instant-ngp and the synthetic NeRF scenes.
//!
//! Poses map the camera (x right, y up, z backward) to the world, which is used unchanged. Intrinsics are
//! shared or per frame: `fl_x fl_y cx cy w h` or `camera_angle_x`, and `k1 k2 k3 k4 p1 p2` with
//! `camera_model`.

mod frame;

use std::ffi::OsStr;
use std::fmt::Formatter;
use std::io::Read;
use std::path::{Path, PathBuf};

use glam::{DAffine3, DMat3, DVec3};
use serde::de::{DeserializeSeed, Deserializer, Error as _, IgnoredAny, MapAccess, SeqAccess, Visitor};
use serde_json::{Map, Number, Value};

use crate::names::{Finder, ending, entries, first_with, plain, stays_inside};
use crate::{cost, ply, regular_file, text};
use ashsplat::scene::SourcePoints;
use ashsplat::{Error, Result};

pub use frame::{Frame, Optics};

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
        let mut start = Vec::new();
        let read = regular_file::open(path).map(|(file, _)| file.take(START_BYTES).read_to_end(&mut start));
        read.is_ok() && String::from_utf8_lossy(&start).contains("\"transform_matrix\"")
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
            let (text, document) = parse(path)?;
            let before = all.frames.len();
            let (warnings, depth_maps) = frame::read_all(path, (&text, &document), &mut all.frames)?;
            all.warnings.extend(warnings);
            all.depth_maps += depth_maps;
            all.frames[before..].iter_mut().for_each(|frame| frame.test |= index > 0);
            all.has_split |= all.frames.iter().any(|frame| frame.test);
            clouds.extend(cloud(path, &document, &mut all.warnings)?);
        }
        if let Some((path, applied)) = clouds.into_iter().next() {
            all.points = ply::read_points_of(&path, &mut all.warnings)?;
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

/// The JSON text of a file, and its top-level values.
fn parse(path: &Path) -> Result<(String, Value)> {
    let text = text::read(path)?;
    if text.trim_ascii().is_empty() {
        return Err(Error::input(path, "is empty", "download or copy it again"));
    }
    let document = read_document(path, &text)?;
    if document.is_object() {
        return Ok((text, document));
    }
    Err(Error::input(path, "the top value is not an object with frames", "is it another kind of JSON?"))
}

fn not_json(path: &Path, text: &str, error: &serde_json::Error) -> Error {
    let damaged =
        "the file is damaged or cut short, or holds numbers that JSON does not have (NaN): write it again";
    let remedy = match has_decimal_comma(text, error) {
        true => "a number there has a decimal comma: write it with a point",
        false => damaged,
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
fn cloud_beside(path: &Path, warnings: &mut Vec<String>) -> Option<PathBuf> {
    /// The reference implementation uses the first name for the synthetic scenes.
    const USUAL: [&str; 8] =
        ["points3d", "sparse_pc", "pointcloud", "point_cloud", "points", "sparse", "input", "pcd"];
    let folder = path.parent().unwrap_or(Path::new(""));
    let mut finder = Finder::default();
    let mut found = USUAL.into_iter().filter_map(|name| finder.file(folder, &format!("{name}.ply")));
    if let Some(file) = found.next() {
        let others: String = found.map(|other| format!(", {} is not", other.display())).collect();
        if !file.ends_with("points3d.ply") || !others.is_empty() {
            let (path, file) = (path.display(), file.display());
            warnings.push(format!("{path}: has no ply_file_path: the points of {file} are used{others}"));
        }
        return Some(file);
    }
    if let Some(other) = first_with(folder, &["ply"]) {
        let (path, other) = (path.display(), other.display());
        let line =
            format!("{path}: has no ply_file_path: {other} is not used; name it there if it has the points");
        warnings.push(line);
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

/// A plain path below a folder; `None` if it leads out of the folder.
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

/// Largest number of keys in an object.
const MOST_KEYS: usize = 1000;
/// Number of kept elements per list, except the file's lists of names; a matrix has up to 4.
const MOST_ELEMENTS: usize = 8;
/// Largest depth of nested lists that are kept: a matrix.
const MOST_DEPTH: u32 = 2;

/// The top-level values of the file. Objects inside lists are empty, `frames` among them.
fn read_document(path: &Path, text: &str) -> Result<Value> {
    read_json(path, text, Pruned { depth: 0, keeps_names: true })
}

/// Passes the frames of a file to `each`, one by one.
fn each_frame(path: &Path, text: &str, each: &mut dyn FnMut(Value) -> Result<()>) -> Result<()> {
    let mut failed = None;
    let mut pass = |frame| each(frame).map_err(|error| failed = Some(error)).is_ok();
    let result = read_json(path, text, Frames(&mut pass));
    failed.map_or(result, Err)
}

fn read_json<'de, S: DeserializeSeed<'de>>(path: &Path, text: &'de str, seed: S) -> Result<S::Value> {
    let mut json = serde_json::Deserializer::from_str(text);
    let value = seed.deserialize(&mut json).and_then(|value| json.end().map(|()| value));
    value.map_err(|e| not_json(path, text, &e))
}

/// Reads a value without the contents of nested objects, and with shortened lists.
#[derive(Clone, Copy)]
struct Pruned {
    depth: u32,
    /// True if lists of strings keep all elements.
    keeps_names: bool,
}

impl<'de> DeserializeSeed<'de> for Pruned {
    type Value = Value;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Value, D::Error> {
        deserializer.deserialize_any(self)
    }
}

impl<'de> Visitor<'de> for Pruned {
    type Value = Value;

    fn expecting(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        f.write_str("a value")
    }

    fn visit_unit<E>(self) -> Result<Value, E> {
        Ok(Value::Null)
    }

    fn visit_bool<E>(self, value: bool) -> Result<Value, E> {
        Ok(value.into())
    }

    fn visit_i64<E>(self, value: i64) -> Result<Value, E> {
        Ok(value.into())
    }

    fn visit_u64<E>(self, value: u64) -> Result<Value, E> {
        Ok(value.into())
    }

    fn visit_f64<E>(self, value: f64) -> Result<Value, E> {
        Ok(Number::from_f64(value).into())
    }

    fn visit_str<E>(self, value: &str) -> Result<Value, E> {
        Ok(value.into())
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Value, A::Error> {
        let (mut kept, mut others) = (Vec::new(), 0);
        if self.depth > MOST_DEPTH {
            while list.next_element::<IgnoredAny>()?.is_some() {}
        }
        let inside = Self { depth: self.depth + 1, ..self };
        while let Some(value) = list.next_element_seed(inside)? {
            let is_name = self.keeps_names && self.depth == 1 && value.is_string();
            others += usize::from(!is_name);
            if is_name || others <= MOST_ELEMENTS {
                kept.push(value);
            }
        }
        Ok(Value::Array(kept))
    }

    fn visit_map<A: MapAccess<'de>>(self, mut object: A) -> Result<Value, A::Error> {
        let mut kept = Map::new();
        if self.depth > 0 {
            while object.next_entry::<IgnoredAny, IgnoredAny>()?.is_some() {}
        }
        while let Some(key) = object.next_key::<String>()? {
            kept.insert(key, object.next_value_seed(Self { depth: self.depth + 1, ..self })?);
            if kept.len() > MOST_KEYS {
                return Err(A::Error::custom(format!("an object has more than {MOST_KEYS} keys")));
            }
        }
        Ok(Value::Object(kept))
    }
}

/// Reads the object around the frames. Passes each frame on; `false` stops the reading.
struct Frames<'a>(&'a mut dyn FnMut(Value) -> bool);

/// Reads the list of frames.
struct FrameList<'a>(&'a mut dyn FnMut(Value) -> bool);

impl<'de> DeserializeSeed<'de> for Frames<'_> {
    type Value = ();

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        deserializer.deserialize_map(self)
    }
}

impl<'de> Visitor<'de> for Frames<'_> {
    type Value = ();

    fn expecting(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        f.write_str("an object")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut object: A) -> Result<(), A::Error> {
        let mut is_read = false;
        while let Some(key) = object.next_key::<String>()? {
            if key != "frames" {
                object.next_value::<IgnoredAny>()?;
            } else if std::mem::replace(&mut is_read, true) {
                return Err(A::Error::custom("the key `frames` comes twice"));
            } else {
                object.next_value_seed(FrameList(&mut *self.0))?;
            }
        }
        Ok(())
    }
}

impl<'de> DeserializeSeed<'de> for FrameList<'_> {
    type Value = ();

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        deserializer.deserialize_seq(self)
    }
}

impl<'de> Visitor<'de> for FrameList<'_> {
    type Value = ();

    fn expecting(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        f.write_str("a list")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<(), A::Error> {
        while let Some(frame) = list.next_element_seed(Pruned { depth: 0, keeps_names: false })? {
            if !(self.0)(frame) {
                return Err(A::Error::custom("stopped"));
            }
        }
        Ok(())
    }
}
