//! A sparse model in memory, and the cameras that can be trained on.

use std::collections::{BTreeMap, HashSet};
use std::ffi::OsStr;
use std::path::{Path, PathBuf};

use glam::dvec2;

use super::find::ModelFolder;
use super::types::{ColmapCamera, ColmapImage};
use super::{binary, text};
use crate::ply;
use ashsplat::scene::camera::MAX_IMAGE_SIDE;
use ashsplat::scene::lens::{Distortion, Lens};
use ashsplat::scene::{Camera, SourcePoints};
use ashsplat::{Error, Result};

/// A sparse model.
#[derive(Clone, Debug, PartialEq)]
pub struct Model {
    /// The folder it was read from.
    pub source: ModelFolder,
    /// Cameras by id.
    pub cameras: BTreeMap<u32, ColmapCamera>,
    /// Registered images, in the file's order.
    pub images: Vec<ColmapImage>,
    /// The points with finite positions, in the file's order.
    pub points: SourcePoints,
    /// Oddities that did not prevent reading.
    pub warnings: Vec<String>,
}

impl Model {
    /// Reads a model. Any camera model is read; [`Model::camera_of`] checks whether it can be used.
    ///
    /// A missing list of points gives no points and a warning. Points at NaN are dropped with a warning.
    ///
    /// # Errors
    /// [`Error::Io`] when a file cannot be read, [`Error::Input`] when one is empty, damaged or cut short, or
    /// names a camera model that COLMAP does not have, or an id or name appears twice.
    pub fn read(source: &ModelFolder) -> Result<Self> {
        let ending = if source.text { "txt" } else { "bin" };
        let file = |part: &str| source.folder.join(format!("{part}.{ending}"));
        let (cameras, images) = if source.text {
            (text::cameras(&file("cameras"))?, text::images(&file("images"))?)
        } else {
            (binary::cameras(&file("cameras"))?, binary::images(&file("images"))?)
        };
        check_unique(&file("images"), &images)?;
        let mut warnings: Vec<String> = source.warning.iter().cloned().collect();
        let points = points(source, &mut warnings)?;
        Ok(Self {
            source: source.clone(),
            cameras: by_id(&file("cameras"), cameras)?,
            images,
            points,
            warnings,
        })
    }

    /// Path of the model's file for "cameras", "images" or "points3D".
    pub fn file(&self, part: &str) -> PathBuf {
        self.source.folder.join(format!("{part}.{}", if self.source.text { "txt" } else { "bin" }))
    }

    /// Path of the points' file, if there is one.
    pub(super) fn points_file(&self) -> Option<PathBuf> {
        points_file(&self.source)
    }

    /// Camera and pose of an image at the photo's size, without lens distortion, in the file's coordinates.
    ///
    /// # Errors
    /// [`Error::Input`] naming file and id when the camera does not exist, has an unsupported lens, no usable
    /// size or focal length, or the pose is not finite or a zero quaternion.
    pub fn camera_of(&self, image: &ColmapImage) -> Result<Camera> {
        let file = self.file("images");
        let Some(camera) = self.cameras.get(&image.camera_id) else {
            let problem = format!("image {} ({}) has camera {}", image.id, image.name, image.camera_id);
            return Err(Error::input(
                file,
                format!("{problem}, which cameras does not list"),
                "copy the whole model",
            ));
        };
        let intrinsics = self.lens(camera)?.intrinsics();
        let length = image.quat.iter().map(|q| q * q).sum::<f64>().sqrt();
        let finite = length.is_finite() && image.translation.iter().all(|t| t.is_finite());
        let result = Camera::from_colmap(image.quat, image.translation, intrinsics);
        if !finite || length == 0.0 || result.problem().is_some() {
            let what = if length == 0.0 { "is a zero quaternion" } else { "is not finite" };
            let problem = format!("image {} ({}): its pose {what}", image.id, image.name);
            return Err(Error::input(
                file,
                problem,
                "run COLMAP's mapper again, or remove the image from the model",
            ));
        }
        if let Some(what) = result.absurdity() {
            let problem = format!("image {} ({}): {what}", image.id, image.name);
            let remedy = "run COLMAP's mapper again, or remove the image from the model";
            return Err(Error::input(file, problem, remedy));
        }
        Ok(result)
    }

    /// A camera and its lens at the size of its photos.
    ///
    /// # Errors
    /// Same as [`Model::camera_of`], except for images and poses.
    pub fn lens(&self, camera: &ColmapCamera) -> Result<Lens> {
        let file = self.file("cameras");
        let place = format!("camera {} ({})", camera.id, camera.model.name());
        let Some(([fx, fy, cx, cy], distortion)) = optics(camera) else {
            let problem = format!("{place} has a lens that is not modelled");
            return Err(Error::input(
                file,
                problem,
                format!("run: {}", undistort_command(&self.source.folder)),
            ));
        };
        let side = |pixels: u64| u32::try_from(pixels).ok().filter(|s| (1..=MAX_IMAGE_SIDE).contains(s));
        let (Some(width), Some(height)) = (side(camera.width), side(camera.height)) else {
            let problem = format!("{place} has images of {}x{} pixels", camera.width, camera.height);
            return Err(Error::input(file, problem, format!("1 to {MAX_IMAGE_SIDE} a side are possible")));
        };
        let lens = Lens { focal_px: dvec2(fx, fy), center_px: dvec2(cx, cy), width, height, distortion };
        let upright = Camera::with_pose(glam::Mat3::IDENTITY, glam::Vec3::ZERO, lens.intrinsics());
        if !camera.parameters.iter().all(|p| p.is_finite()) {
            return Err(Error::input(
                &file,
                format!("{place}: a parameter is not finite"),
                "run COLMAP again",
            ));
        }
        if let Some(problem) = upright.problem() {
            return Err(Error::input(&file, format!("{place}: {problem}"), "run COLMAP again"));
        }
        if let Some(problem) = lens.intrinsics().absurdity() {
            return Err(Error::input(&file, format!("{place}: {problem}"), "run COLMAP again"));
        }
        Ok(lens)
    }
}

/// Focal lengths, principal point and distortion; `None` for unsupported lenses.
fn optics(camera: &ColmapCamera) -> Option<([f64; 4], Distortion)> {
    let brown =
        |k: [f64; 3], d: [f64; 3], p: [f64; 2]| Distortion::Brown { k: [k[0], k[1], k[2], 0.0], d, p };
    let radial = |k1: f64, k2: f64| brown([k1, k2, 0.0], [0.0; 3], [0.0; 2]);
    let fisheye = |k: [f64; 4]| Distortion::Fisheye { k };
    Some(match (camera.model.name(), camera.parameters.as_slice()) {
        ("SIMPLE_PINHOLE", &[f, cx, cy]) => ([f, f, cx, cy], Distortion::None),
        ("PINHOLE", &[fx, fy, cx, cy]) => ([fx, fy, cx, cy], Distortion::None),
        ("SIMPLE_RADIAL", &[f, cx, cy, k]) => ([f, f, cx, cy], radial(k, 0.0)),
        ("RADIAL", &[f, cx, cy, k1, k2]) => ([f, f, cx, cy], radial(k1, k2)),
        ("OPENCV", &[fx, fy, cx, cy, k1, k2, p1, p2]) => {
            ([fx, fy, cx, cy], brown([k1, k2, 0.0], [0.0; 3], [p1, p2]))
        }
        ("FULL_OPENCV", &[fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6]) => {
            ([fx, fy, cx, cy], brown([k1, k2, k3], [k4, k5, k6], [p1, p2]))
        }
        ("OPENCV_FISHEYE", &[fx, fy, cx, cy, k1, k2, k3, k4]) => {
            ([fx, fy, cx, cy], fisheye([k1, k2, k3, k4]))
        }
        ("SIMPLE_RADIAL_FISHEYE", &[f, cx, cy, k]) => ([f, f, cx, cy], fisheye([k, 0.0, 0.0, 0.0])),
        ("RADIAL_FISHEYE", &[f, cx, cy, k1, k2]) => ([f, f, cx, cy], fisheye([k1, k2, 0.0, 0.0])),
        ("SIMPLE_FISHEYE", &[f, cx, cy]) => ([f, f, cx, cy], fisheye([0.0; 4])),
        ("FISHEYE", &[fx, fy, cx, cy]) => ([fx, fy, cx, cy], fisheye([0.0; 4])),
        _ => return None,
    })
}

/// The command that converts a distorted model to pinhole images and a pinhole model.
pub fn undistort_command(model: &Path) -> String {
    let dataset =
        model.ancestors().find(|a| a.file_name().is_some_and(|n| n == "sparse")).and_then(Path::parent);
    let dataset = dataset.unwrap_or(model).display().to_string();
    let model = model.display();
    format!(
        "colmap image_undistorter --image_path {dataset}/images --input_path {model} --output_path {dataset}/undistorted, \
         and train on {dataset}/undistorted"
    )
}

fn points_file(source: &ModelFolder) -> Option<PathBuf> {
    let exists =
        |ending: &str| Some(source.folder.join(format!("points3D.{ending}"))).filter(|p| p.is_file());
    let in_text = source.text.then(|| exists("txt")).flatten();
    in_text.or_else(|| exists("bin")).or_else(|| exists("txt")).or_else(|| exists("ply"))
}

fn points(source: &ModelFolder, warnings: &mut Vec<String>) -> Result<SourcePoints> {
    let Some(file) = points_file(source) else {
        warnings.push(format!("{}: has no points3D file; no points are known", source.folder.display()));
        return Ok(SourcePoints::default());
    };
    let mut points = match file.extension().and_then(OsStr::to_str) {
        Some("txt") => text::points(&file)?,
        Some("ply") => ply::read_points_of(&file, warnings)?,
        _ => binary::points(&file)?,
    };
    // The reference implementation keeps a copy of the points in this PLY.
    let ply = file.with_extension("ply");
    if points.is_empty() && ply.is_file() {
        points = ply::read_points_of(&ply, warnings)?;
    }
    let all = points.len();
    if ply.is_file() && ply::claimed_points(&ply).is_ok_and(|count| count != all as u64) {
        let (ply, file) = (ply.display(), file.display());
        warnings
            .push(format!("{ply}: has other points than {file}, which are used; remove that to use these"));
    }
    let finite: Vec<bool> = points.positions.iter().map(|p| p.as_vec3().is_finite()).collect();
    points.retain(&finite);
    if points.len() < all {
        let dropped = all - points.len();
        warnings
            .push(format!("{}: {dropped} of {all} points are not finite and were left out", file.display()));
    }
    Ok(points)
}

fn by_id(file: &Path, cameras: Vec<ColmapCamera>) -> Result<BTreeMap<u32, ColmapCamera>> {
    let mut by_id = BTreeMap::new();
    for camera in cameras {
        let id = camera.id;
        if by_id.insert(id, camera).is_some() {
            return Err(Error::input(
                file,
                format!("camera id {id} appears twice"),
                "export the model again",
            ));
        }
    }
    Ok(by_id)
}

fn check_unique(file: &Path, images: &[ColmapImage]) -> Result<()> {
    let (mut ids, mut names) = (HashSet::new(), HashSet::new());
    for image in images {
        let what = match (ids.insert(image.id), names.insert(image.name.as_str())) {
            (true, true) => continue,
            (false, _) => format!("image id {}", image.id),
            (_, false) => format!("image name {:?}", image.name),
        };
        let remedy = "give each image its own, with the folder of its camera before the name";
        return Err(Error::input(file, format!("{what} appears twice"), remedy));
    }
    Ok(())
}
