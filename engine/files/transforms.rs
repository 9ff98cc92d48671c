//! `transforms.json`: the cameras of nerfstudio, instant-ngp and the synthetic NeRF scenes.
//!
//! Poses map the camera (x right, y up, z backward) to the world, which is used unchanged. Intrinsics are
//! shared or per frame: `fl_x fl_y cx cy w h` or `camera_angle_x`, and `k1 k2 k3 k4 p1 p2` with
//! `camera_model`.

mod frame;
mod split;

use std::path::{Path, PathBuf};

use glam::{DAffine3, DMat3, DVec3};
use serde_json::Value;

use super::names::{ending, plain, stays_inside};
use super::ply;
use super::regular_file::{self, TEXT_GROWTH};
use ashsplat::scene::SourcePoints;
use ashsplat::{Error, Result};

pub use frame::{Frame, Optics};

/// Files of the synthetic NeRF scenes: for training, and for testing (the first that exists).
const SPLIT_FILES: [&str; 3] = ["transforms_train.json", "transforms_test.json", "transforms_val.json"];

/// The one file of nerfstudio and instant-ngp.
const SINGLE_FILE: &str = "transforms.json";

/// The contents of the files.
#[derive(Clone, Debug, PartialEq)]
pub struct Transforms {
    /// The file with the training views.
    pub source: PathBuf,
    /// The frames of all files, in their order. `test` is set if a file or list marks the frame as held out.
    pub frames: Vec<Frame>,
    /// Whether the files specify the held-out frames.
    pub has_split: bool,
    /// The points, if there are any.
    pub points: SourcePoints,
    /// All oddities that did not prevent reading.
    pub warnings: Vec<String>,
}

/// The files of a data set; None if it is not of this kind.
pub fn find(dataset: &Path) -> Option<Vec<PathBuf>> {
    let file = |name: &str| Some(dataset.join(name)).filter(|path| path.is_file());
    if let Some(single) = file(SINGLE_FILE) {
        return Some(vec![single]);
    }
    let train = file(SPLIT_FILES[0])?;
    let held_out = SPLIT_FILES[1..].iter().find_map(|name| file(name));
    Some([train].into_iter().chain(held_out).collect())
}

impl Transforms {
    /// Reads the files of a data set, the training views first, and the points that they name.
    ///
    /// # Errors
    /// [`Error::Io`] when a file cannot be read; [`Error::Input`] naming file and frame when one is no such JSON, has
    /// no frames, no camera, a matrix that is no pose, or paths that lead out of the folder.
    pub fn read(files: &[PathBuf]) -> Result<Self> {
        let mut all = Self {
            source: files.first().cloned().unwrap_or_default(),
            frames: Vec::new(),
            has_split: files.len() > 1,
            points: SourcePoints::default(),
            warnings: Vec::new(),
        };
        let mut clouds = Vec::new();
        for (index, path) in files.iter().enumerate() {
            let document = parse(path)?;
            let before = all.frames.len();
            all.warnings.extend(frame::read_all(path, &document, &mut all.frames)?);
            all.frames[before..].iter_mut().for_each(|frame| frame.test |= index > 0);
            all.has_split |= all.frames.iter().any(|frame| frame.test);
            clouds.extend(cloud(path, &document)?);
        }
        if let Some((path, applied)) = clouds.into_iter().next() {
            all.points = ply::read_points(&path)?;
            all.place_points(&path, applied);
        }
        Ok(all)
    }

    /// Older files of nerfstudio hold points in the frame before `applied_transform`. The frame in which the
    /// cameras see more of them is used.
    fn place_points(&mut self, path: &Path, applied: Option<DAffine3>) {
        const SAMPLE: usize = 500;
        let Some(applied) = applied.filter(|a| !a.abs_diff_eq(DAffine3::IDENTITY, 1e-6)) else { return };
        let step = self.points.len().div_ceil(SAMPLE).max(1);
        let sample: Vec<DVec3> = self.points.positions.iter().copied().step_by(step).collect();
        let seen = |place: &dyn Fn(DVec3) -> DVec3| -> usize {
            let in_view = |frame: &Frame, point: DVec3| frame.sees(place(point));
            self.frames.iter().map(|frame| sample.iter().filter(|&&p| in_view(frame, p)).count()).sum()
        };
        let (as_stored, moved) = (seen(&|p| p), seen(&|p| applied.transform_point3(p)));
        if moved > as_stored + as_stored / 2 {
            for position in &mut self.points.positions {
                *position = applied.transform_point3(*position);
            }
            self.warnings.push(format!(
                "{}: the points lie in the frame before applied_transform, and were moved",
                path.display()
            ));
        }
    }
}

/// The JSON of a file, without a byte order mark.
fn parse(path: &Path) -> Result<Value> {
    let bytes = regular_file::read(path, TEXT_GROWTH)?;
    let text = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(&bytes);
    if text.trim_ascii().is_empty() {
        return Err(Error::input(path, "is empty", "download or copy it again"));
    }
    let document: Value = serde_json::from_slice(text).map_err(|e| {
        let remedy = "the file is damaged or cut short, or holds numbers that JSON does not have (NaN): write it again";
        Error::input(path, format!("is not JSON: {e}"), remedy)
    })?;
    if document.is_object() {
        return Ok(document);
    }
    Err(Error::input(path, "the top value is not an object with frames", "is it another kind of JSON?"))
}

/// The point cloud that a file names, or that lies next to it, and the transform that was applied to the
/// poses.
fn cloud(path: &Path, document: &Value) -> Result<Option<(PathBuf, Option<DAffine3>)>> {
    let applied = match &document["applied_transform"] {
        Value::Null => None,
        value => {
            let rows = frame::matrix(value).ok_or_else(|| {
                Error::input(
                    path,
                    "applied_transform is not a matrix of 3 or 4 rows of 4 numbers",
                    "write it again",
                )
            })?;
            let column = |c: usize| DVec3::from_array(std::array::from_fn(|r| rows[r][c]));
            let axes = DMat3::from_cols(column(0), column(1), column(2));
            Some(DAffine3::from_mat3_translation(axes, column(3)))
        }
    };
    let named = match &document["ply_file_path"] {
        Value::String(name) => {
            let file = below(name).map(|name| path.parent().unwrap_or(Path::new("")).join(name));
            let file = file.ok_or_else(|| {
                let problem = format!("ply_file_path {:?} leads out of the folder", ending(name));
                Error::input(path, problem, "copy the file into it")
            })?;
            if !file.is_file() {
                let remedy =
                    "copy it there, or remove ply_file_path: training then starts from random points";
                return Err(Error::input(file, "the point cloud of transforms.json is missing", remedy));
            }
            Some(file)
        }
        // The path at which the reference reads and writes the points of the synthetic scenes.
        _ => Some(path.with_file_name("points3d.ply")).filter(|file| file.is_file()),
    };
    Ok(named.map(|file| (file, applied)))
}

/// A plain path below a folder; None if it leads out of the folder.
fn below(name: &str) -> Option<String> {
    Some(plain(name)).filter(|name| stays_inside(name))
}

impl Frame {
    fn sees(&self, point: DVec3) -> bool {
        let p = self.camera_from_source * point + self.translation;
        // About 30 degrees to each side, because the field of view is not known yet.
        p.z > 0.0 && p.x.abs() < p.z * 0.6 && p.y.abs() < p.z * 0.6
    }
}
