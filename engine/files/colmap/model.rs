//! A sparse model in memory, the cameras that can be trained on, and the points that photos show.

use std::collections::{BTreeMap, HashMap, HashSet};
use std::ffi::OsStr;
use std::path::{Path, PathBuf};

use glam::{DMat3, DVec2, DVec3, dvec2};

use super::find::{self, ModelFolder};
use super::read::{self, Observed};
use super::records::{ColmapCamera, ColmapImage};
use crate::depth_fit::DepthPoint;
use crate::ply;
use ashsplat::scene::camera::MAX_IMAGE_SIDE;
use ashsplat::scene::distortion::{Distortion, PhotoLens};
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
    /// Finds and reads the model of a data set.
    pub fn of_dataset(dataset: impl AsRef<Path>) -> Result<Self> {
        Self::read(&find::find(dataset)?)
    }

    /// Reads a model. Any camera model is read; [`Model::camera_of`] checks whether it can be used.
    ///
    /// A missing list of points gives no points and a warning. Points at NaN are dropped with a warning.
    pub fn read(source: &ModelFolder) -> Result<Self> {
        let [cameras, images] = ["cameras", "images"].map(|part| source.file(part));
        let (all_cameras, all_images) = (read::cameras(&cameras)?, read::images(&images)?);
        check_unique(&images, &all_images)?;
        let mut warnings: Vec<String> = source.warning.iter().cloned().collect();
        let points = points(source, &mut warnings)?;
        let cameras = by_id(&cameras, all_cameras)?;
        Ok(Self { source: source.clone(), cameras, images: all_images, points, warnings })
    }

    /// Path of the model's file for "cameras", "images" or "points3D".
    pub fn file(&self, part: &str) -> PathBuf {
        self.source.file(part)
    }

    /// Camera and pose of an image at the photo's size, without lens distortion, in the file's coordinates.
    ///
    /// # Errors
    /// [`Error::Input`] naming file and id when the camera does not exist, has an unsupported lens, no usable
    /// size or focal length, or the pose is not finite or a zero quaternion.
    pub fn camera_of(&self, image: &ColmapImage) -> Result<Camera> {
        let file = self.file("images");
        let Some(camera) = self.cameras.get(&image.camera_id) else {
            let ColmapImage { id, name, camera_id, .. } = image;
            let problem = format!("image {id} ({name}) has camera {camera_id}, which cameras does not list");
            return Err(Error::input(file, problem, "copy the whole model"));
        };
        let intrinsics = self.lens(camera)?.intrinsics();
        let length = image.quat.iter().map(|q| q * q).sum::<f64>().sqrt();
        let finite = length.is_finite() && image.translation.iter().all(|t| t.is_finite());
        let result = Camera::from_colmap(image.quat, image.translation, intrinsics);
        let problem = match result.problem() {
            _ if length == 0.0 => Some("its pose is a zero quaternion".into()),
            None if finite => result.absurdity(),
            _ => Some("its pose is not finite".into()),
        };
        if let Some(problem) = problem {
            let problem = format!("image {} ({}): {problem}", image.id, image.name);
            let remedy = "run COLMAP's mapper again, or remove the image from the model";
            return Err(Error::input(file, problem, remedy));
        }
        Ok(result)
    }

    /// A camera and its lens at the size of its photos.
    pub fn lens(&self, camera: &ColmapCamera) -> Result<PhotoLens> {
        let file = self.file("cameras");
        let place = format!("camera {} ({})", camera.id, camera.model.name());
        let Some(([fx, fy, cx, cy], distortion)) = optics(camera) else {
            let remedy = match &self.source.list {
                None => format!("run: {}", undistort_command(&self.source.folder)),
                Some(_) => "export undistorted photos and their cameras".into(),
            };
            return Err(Error::input(file, format!("{place} has a lens that is not modelled"), remedy));
        };
        let side = |pixels: u64| u32::try_from(pixels).ok().filter(|s| (1..=MAX_IMAGE_SIDE).contains(s));
        let (Some(width), Some(height)) = (side(camera.width), side(camera.height)) else {
            let problem = format!("{place} has images of {}x{} pixels", camera.width, camera.height);
            return Err(Error::input(file, problem, format!("1 to {MAX_IMAGE_SIDE} a side are possible")));
        };
        let lens = PhotoLens { focal_px: dvec2(fx, fy), center_px: dvec2(cx, cy), width, height, distortion };
        let upright = Camera::with_pose(glam::Mat3::IDENTITY, glam::Vec3::ZERO, lens.intrinsics());
        let is_finite = camera.parameters.iter().all(|p| p.is_finite());
        let problem = match upright.problem() {
            _ if !is_finite => Some("a parameter is not finite".into()),
            problem => problem.or_else(|| lens.intrinsics().absurdity()),
        };
        if let Some(problem) = problem {
            return Err(Error::input(file, format!("{place}: {problem}"), "run COLMAP again"));
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
        ("FULL_OPENCV", &[fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6, n4]) => {
            let (k, d) = ([k1, k2, k3, n4], [k4, k5, k6]);
            ([fx, fy, cx, cy], Distortion::Brown { k, d, p: [p1, p2] })
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
        Some("ply") => ply::read_points(&file, warnings)?,
        _ => read::points(&file)?,
    };
    // The reference implementation keeps a copy of the points in this PLY.
    let ply = file.with_extension("ply");
    if points.is_empty() && ply.is_file() {
        points = ply::read_points(&ply, warnings)?;
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
            let problem = format!("camera id {id} appears twice");
            return Err(Error::input(file, problem, "export the model again"));
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

/// Positions of points by id, the file's coordinates.
type Positions = HashMap<u64, [f64; 3]>;

fn observed(model: &Model) -> Result<(Vec<Observed>, Positions)> {
    let positions = match points_file(&model.source) {
        // Points of a PLY have no ids.
        Some(file) if file.extension().is_none_or(|ending| ending != "ply") => read::positions(&file)?,
        _ => HashMap::new(),
    };
    Ok((read::observations(&model.file("images"))?, positions))
}

/// The points that each image of a model shows, by image id.
pub fn observations(model: &Model) -> Result<HashMap<u32, Vec<DepthPoint>>> {
    let (observed, positions) = observed(model)?;
    let pose = |image: &ColmapImage| (image.id, (image.rotation(), DVec3::from_array(image.translation)));
    let poses: HashMap<u32, (DMat3, DVec3)> = model.images.iter().map(pose).collect();
    let of_image = |(id, places): Observed| {
        let pose = poses.get(&id);
        let point = |(position_px, point): ([f64; 2], Option<u64>)| {
            let (rotation, translation) = pose?;
            let position = DVec3::from_array(*positions.get(&point?)?);
            let z = (*rotation * position + *translation).z;
            Some(DepthPoint { position_px, inverse_z: 1.0 / z }).filter(|point| point.inverse_z.is_finite())
        };
        (id, places.into_iter().filter_map(point).collect())
    };
    Ok(observed.into_iter().map(of_image).collect())
}

/// Positions of the points that each image of a model shows, by image id, in the file's coordinates. Each point appears
/// once, in the order of point ids.
pub fn tracks(model: &Model) -> Result<HashMap<u32, Vec<[f64; 3]>>> {
    let (observed, positions) = observed(model)?;
    let of_image = |(id, places): Observed| {
        let mut points: Vec<u64> = places.into_iter().filter_map(|(_, point)| point).collect();
        points.sort_unstable();
        points.dedup();
        (id, points.iter().filter_map(|point| positions.get(point).copied()).collect())
    };
    Ok(observed.into_iter().map(of_image).collect())
}

/// A warning if points do not lie where the photos show them, because poses, points or cameras were changed separately.
pub(crate) fn contradiction(model: &Model) -> Option<String> {
    /// Larger models are skipped: reading their observations would take too long.
    const MOST_BYTES: u64 = 32 << 20;
    const SAMPLE: usize = 1000;
    const LEAST: usize = 100;
    /// Share of the photo's larger side. The projection ignores distortion, whose median effect is smaller.
    const FAR: f64 = 0.05;
    let bytes = |file: PathBuf| std::fs::metadata(file).map_or(u64::MAX, |file| file.len());
    if bytes(model.file("images")).saturating_add(bytes(points_file(&model.source)?)) > MOST_BYTES {
        return None;
    }
    let (observed, positions) = observed(model).ok()?;
    let images: HashMap<u32, &ColmapImage> = model.images.iter().map(|image| (image.id, image)).collect();
    let all: Vec<_> = observed
        .into_iter()
        .flat_map(|(id, places)| places.into_iter().filter_map(move |(at, point)| Some((id, at, point?))))
        .collect();
    let error = |&(id, at, point): &(u32, [f64; 2], u64)| -> Option<f64> {
        let image = images.get(&id)?;
        let lens = model.lens(model.cameras.get(&image.camera_id)?).ok()?;
        let is_plane = !matches!(lens.distortion, Distortion::Fisheye { .. });
        let position = DVec3::from_array(*positions.get(&point)?);
        let p = image.rotation() * position + DVec3::from_array(image.translation);
        let there = lens.focal_px * (p.truncate() / p.z) + lens.center_px;
        let side = f64::from(lens.width.max(lens.height));
        is_plane.then(|| if p.z > 0.0 { there.distance(DVec2::from_array(at)) / side } else { f64::INFINITY })
    };
    let mut errors: Vec<f64> =
        all.iter().step_by(all.len().div_ceil(SAMPLE).max(1)).filter_map(error).collect();
    errors.sort_unstable_by(f64::total_cmp);
    let median = *errors.get(errors.len() / 2).filter(|_| errors.len() >= LEAST)?;
    (median > FAR).then(|| {
        format!(
            "{}: its points do not lie where its photos show them (in the median {:.0} % of a photo's side away): poses and points do \
             not belong together",
            model.source.folder.display(),
            (100.0 * median).min(999.0)
        )
    })
}
