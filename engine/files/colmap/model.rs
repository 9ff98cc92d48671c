//! A sparse model: cameras, registered images, points, and what rigs and frames say of them.

use std::collections::{BTreeMap, HashMap, HashSet};
use std::ffi::OsStr;
use std::path::{Path, PathBuf};

use glam::{DMat3, DVec2, DVec3, Mat3, Vec3};

use super::records::{self, ColmapCamera, ColmapImage, Observed, Pose};
use crate::depth_fit::ObservedPoint;
use crate::ply;
use ashsplat::scene::camera::MAX_IMAGE_SIDE;
use ashsplat::scene::{Camera, PhotoLens, SourcePoints};
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
    /// Other things that were read, one line each.
    pub notes: Vec<String>,
}

impl Model {
    /// Reads a model. Any camera model is read; [`Model::camera_of`] checks whether it can be used.
    ///
    /// A missing list of points gives no points and a warning. Points at NaN are dropped with a warning. Poses of rigs and
    /// frames are compared with those of the images, which are used.
    pub fn read(source: &ModelFolder) -> Result<Self> {
        let [cameras, images] = ["cameras", "images"].map(|part| source.file(part));
        let (all_cameras, all_images) = (records::cameras(&cameras)?, records::images(&images)?);
        check_unique(&images, &all_images)?;
        let mut warnings: Vec<String> = source.warning.iter().cloned().collect();
        let points = points(source, &mut warnings)?;
        let cameras = by_id(&cameras, all_cameras)?;
        let notes = compare_rigs(source, &all_images, &mut warnings)?.into_iter().collect();
        Ok(Self { source: source.clone(), cameras, images: all_images, points, warnings, notes })
    }

    /// Path of the model's file for "cameras", "images" or "points3D".
    pub fn file(&self, part: &str) -> PathBuf {
        self.source.file(part)
    }

    /// Camera and pose of an image at the photo's size, with its lens, in the file's coordinates.
    ///
    /// # Errors
    /// [`Error::Input`] naming file and id when the camera does not exist, has a lens that folds the picture, no usable
    /// size or focal length, or the pose is not finite or a zero quaternion.
    pub fn camera_of(&self, image: &ColmapImage) -> Result<Camera> {
        let file = self.file("images");
        let Some(camera) = self.cameras.get(&image.camera_id) else {
            let ColmapImage { id, name, camera_id, .. } = image;
            let problem = format!("image {id} ({name}) has camera {camera_id}, which cameras does not list");
            return Err(Error::input(file, problem, "copy the whole model"));
        };
        let lens = self.lens(camera)?;
        let length = image.quat.iter().map(|q| q * q).sum::<f64>().sqrt();
        let finite = length.is_finite() && image.translation.iter().all(|t| t.is_finite());
        let pose = Camera::from_colmap(image.quat, image.translation, lens.intrinsics());
        let result = lens.camera(pose.camera_from_world, pose.translation);
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
        let side = |pixels: u64| u32::try_from(pixels).ok().filter(|s| (1..=MAX_IMAGE_SIDE).contains(s));
        let (Some(width), Some(height)) = (side(camera.width), side(camera.height)) else {
            let problem = format!("{place} has images of {}x{} pixels", camera.width, camera.height);
            return Err(Error::input(file, problem, format!("1 to {MAX_IMAGE_SIDE} a side are possible")));
        };
        let Some(lens) =
            PhotoLens::of_colmap(camera.model.number() as u32, &camera.parameters, [width, height])
        else {
            let problem = format!("{place} has {} parameters", camera.parameters.len());
            return Err(Error::input(file, problem, "run COLMAP again"));
        };
        let upright = lens.camera(Mat3::IDENTITY, Vec3::ZERO);
        let is_finite = camera.parameters.iter().all(|p| p.is_finite());
        let problem = match upright.problem() {
            _ if !is_finite => Some("a parameter is not finite".into()),
            problem => problem.or_else(|| lens.intrinsics().absurdity()),
        };
        if let Some(problem) = problem {
            return Err(Error::input(file, format!("{place}: {problem}"), "compute the cameras again"));
        }
        Ok(lens)
    }
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
        _ => records::points(&file)?,
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
        Some(file) if file.extension().is_none_or(|ending| ending != "ply") => records::positions(&file)?,
        _ => HashMap::new(),
    };
    Ok((records::observations(&model.file("images"))?, positions))
}

/// The points that each image of a model shows, by image id.
pub fn observations(model: &Model) -> Result<HashMap<u32, Vec<ObservedPoint>>> {
    let (observed, positions) = observed(model)?;
    let pose = |image: &ColmapImage| (image.id, (image.rotation(), DVec3::from_array(image.translation)));
    let poses: HashMap<u32, (DMat3, DVec3)> = model.images.iter().map(pose).collect();
    let of_image = |(id, places): Observed| {
        let pose = poses.get(&id);
        let point = |(position_px, point): ([f64; 2], Option<u64>)| {
            let (rotation, translation) = pose?;
            let position = DVec3::from_array(*positions.get(&point?)?);
            let z = (*rotation * position + *translation).z;
            Some(ObservedPoint { position_px, inverse_z: 1.0 / z })
                .filter(|point| point.inverse_z.is_finite())
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
    const MAX_BYTES: u64 = 32 << 20;
    const SAMPLE: usize = 1000;
    const MIN_POINTS: usize = 100;
    /// Share of the photo's larger side.
    const FAR: f64 = 0.05;
    let bytes = |file: PathBuf| std::fs::metadata(file).map_or(u64::MAX, |file| file.len());
    if bytes(model.file("images")).saturating_add(bytes(points_file(&model.source)?)) > MAX_BYTES {
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
        let position = DVec3::from_array(*positions.get(&point)?);
        let p = image.rotation() * position + DVec3::from_array(image.translation);
        let side = f64::from(lens.width.max(lens.height));
        Some(lens.project(p).map_or(f64::INFINITY, |there| there.distance(DVec2::from_array(at)) / side))
    };
    let mut errors: Vec<f64> =
        all.iter().step_by(all.len().div_ceil(SAMPLE).max(1)).filter_map(error).collect();
    errors.sort_unstable_by(f64::total_cmp);
    let median = *errors.get(errors.len() / 2).filter(|_| errors.len() >= MIN_POINTS)?;
    (median > FAR).then(|| {
        format!(
            "{}: its points do not lie where its photos show them (in the median {:.0} % of a photo's side away): poses and points do \
             not belong together",
            model.source.folder.display(),
            (100.0 * median).min(999.0)
        )
    })
}

/// Warns where the rigs of a model (from COLMAP 3.12 on) contradict its images. Returns a note of the rigs if any has several
/// sensors.
///
/// The pose of an image is written twice: in `images`, and as its frame's `rig_from_world` followed by its sensor's
/// `sensor_from_rig`. "Newer output reconstructions' `cameras` and `images` files are fully compatible with old outputs"
/// (COLMAP's documentation, "Sparse Reconstruction"), so those of `images` are used, and the others are compared with them.
fn compare_rigs(
    source: &ModelFolder,
    images: &[ColmapImage],
    warnings: &mut Vec<String>,
) -> Result<Option<String>> {
    let [rigs_file, frames_file, used] = ["rigs", "frames", "images"].map(|part| source.file(part));
    if !rigs_file.is_file() || !frames_file.is_file() {
        return Ok(None);
    }
    let (rigs, frames) = (records::rigs(&rigs_file)?, records::frames(&frames_file)?);
    let used = used.file_name().unwrap_or_default().display();
    let max = rigs.values().map(HashMap::len).max().unwrap_or(0);
    let note = (max > 1).then(|| {
        let (file, rigs, frames) = (rigs_file.display(), rigs.len(), frames.len());
        format!("{file}: {rigs} rigs of up to {max} sensors, {frames} frames: the poses are those of {used}")
    });
    let by_id: HashMap<u64, &ColmapImage> = images.iter().map(|image| (image.id.into(), image)).collect();
    let tolerance = Tolerance::of(images);
    let (mut first, mut others) = (None, 0);
    for frame in &frames {
        let rig = rigs.get(&frame.rig);
        for (sensor, data) in frame.data.iter().filter(|(sensor, _)| sensor.is_camera) {
            let problem = match (rig.and_then(|rig| rig.get(sensor)), by_id.get(data)) {
                _ if rig.is_none() => format!("has the rig {}, which does not exist", frame.rig),
                (None, _) => format!("has camera {}, which its rig {} does not have", sensor.id, frame.rig),
                (Some(None), _) => {
                    format!("has camera {}, which has no pose in its rig {}", sensor.id, frame.rig)
                }
                (_, None) => format!("has image {data}, which {used} does not list"),
                (_, Some(image)) if image.camera_id != sensor.id => {
                    format!(
                        "has image {data} of camera {}, in {used} it is of camera {}",
                        sensor.id, image.camera_id
                    )
                }
                (Some(&Some(pose)), Some(image)) => match tolerance.covers(image, pose, frame.pose) {
                    true => continue,
                    false => {
                        format!("and its rig give image {data} ({}) another pose than {used}", image.name)
                    }
                },
            };
            match first {
                None => first = Some(format!("frame {} {problem}", frame.id)),
                Some(_) => others += 1,
            }
        }
    }
    if let Some(first) = first {
        let more = if others > 0 { format!(" (and {others} more such images)") } else { String::new() };
        let file = frames_file.display();
        warnings.push(format!("{file}: {first}{more}: the poses of {used} are used"));
    }
    Ok(note)
}

/// Largest distance between two positions of a camera that are taken as one.
struct Tolerance(f64);

impl Tolerance {
    /// Largest difference of two rotations' entries, and of two positions as a share of the cameras' extent.
    const SHARE: f64 = 1e-3;
    /// Rounding of positions far from the origin.
    const ROUNDING: f64 = 1e-9;

    fn of(images: &[ColmapImage]) -> Self {
        let centers: Vec<DVec3> = images.iter().map(|image| center(Pose::of(image).axes())).collect();
        let farthest = |from: DVec3| centers.iter().map(|c| c.distance(from)).fold(0.0, f64::max);
        let extent = centers.first().map_or(0.0, |&first| farthest(first));
        Self(Self::SHARE * extent + Self::ROUNDING * (1.0 + farthest(DVec3::ZERO)))
    }

    fn covers(&self, image: &ColmapImage, sensor_from_rig: Pose, rig_from_world: Pose) -> bool {
        let ((sensor, offset), (rig, translation)) = (sensor_from_rig.axes(), rig_from_world.axes());
        let (own, other) = (Pose::of(image).axes(), (sensor * rig, sensor * translation + offset));
        own.0.abs_diff_eq(other.0, Self::SHARE) && center(own).distance(center(other)) <= self.0
    }
}

/// A camera's place, from its rotation and translation.
fn center((rotation, translation): (DMat3, DVec3)) -> DVec3 {
    -(rotation.transpose() * translation)
}

/// A folder with a sparse model.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ModelFolder {
    /// The folder that holds cameras, images and points3D.
    pub folder: PathBuf,
    /// The file of another program that has the cameras instead; its path is also `folder`.
    pub list: Option<PathBuf>,
    /// True for text files, false for binary ones.
    pub text: bool,
    /// A message if the choice was not obvious.
    pub warning: Option<String>,
}

impl ModelFolder {
    /// Path of the file for "cameras", "images" or "points3D".
    pub(super) fn file(&self, part: &str) -> PathBuf {
        let of_colmap = || self.folder.join(format!("{part}.{}", if self.text { "txt" } else { "bin" }));
        self.list.clone().unwrap_or_else(of_colmap)
    }
}
