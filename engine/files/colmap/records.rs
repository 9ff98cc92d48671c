//! The records of a sparse model: cameras, registered images, rigs and their frames.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use glam::{DMat3, DQuat, DVec3};

use crate::names::{MAX_PATH_BYTES, ending, plain, stays_inside};
use ashsplat::scene::{COLMAP_MODELS, Camera, colmap_parameters};
use ashsplat::{Error, Result};

/// One of COLMAP's camera models.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CameraModel(usize);

impl CameraModel {
    /// Parameters f, cx, cy.
    pub const SIMPLE_PINHOLE: Self = Self(0);
    /// Parameters fx, fy, cx, cy.
    pub const PINHOLE: Self = Self(1);
    /// Parameters fx, fy, cx, cy, k1, k2, p1, p2.
    pub const OPENCV: Self = Self(4);
    /// Parameters fx, fy, cx, cy, k1, k2, k3, k4.
    pub const OPENCV_FISHEYE: Self = Self(5);
    /// Parameters width, height.
    pub const EQUIRECTANGULAR: Self = Self(17);
    /// Parameters fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6.
    pub const FULL_OPENCV: Self = Self(6);

    /// Model with COLMAP's number.
    pub fn from_number(number: i64) -> Option<Self> {
        usize::try_from(number).ok().filter(|&n| n < COLMAP_MODELS.len()).map(Self)
    }

    /// Model with COLMAP's name.
    pub fn from_name(name: &str) -> Option<Self> {
        COLMAP_MODELS.iter().position(|model| *model == name).map(Self)
    }

    /// COLMAP's name.
    pub fn name(self) -> &'static str {
        COLMAP_MODELS[self.0]
    }

    /// COLMAP's number.
    pub fn number(self) -> i32 {
        self.0 as i32
    }

    /// Number of its parameters.
    pub fn parameters(self) -> usize {
        colmap_parameters(self.0 as u32).unwrap_or(0)
    }
}

/// A camera without pose, as in the model.
#[derive(Clone, Debug, PartialEq)]
pub struct ColmapCamera {
    /// COLMAP's id; ids may have gaps.
    pub id: u32,
    /// The camera model.
    pub model: CameraModel,
    /// Width of its images, pixels.
    pub width: u64,
    /// Height of its images, pixels.
    pub height: u64,
    /// Focal lengths, principal point, distortion, in the model's order. FULL_OPENCV's may end with n4 (see
    /// [`Projection::Brown`](ashsplat::scene::Projection::Brown)), which COLMAP's files do not have.
    pub parameters: Vec<f64>,
}

impl ColmapCamera {
    /// The camera with the lens of `camera`.
    ///
    /// # Errors
    /// [`Error::Argument`] for a lens that no model of COLMAP has.
    pub fn of(id: u32, camera: &Camera) -> Result<Self> {
        let lens = camera.photo_lens().to_colmap();
        let none =
            || Error::argument("camera", format!("{} is no model of COLMAP", camera.projection.name()));
        let (model, parameters) = lens.ok_or_else(none)?;
        Ok(Self { model: CameraModel(model as usize), parameters, ..Self::pinhole(id, camera) })
    }

    /// The PINHOLE camera with the intrinsics of `camera`.
    pub fn pinhole(id: u32, camera: &Camera) -> Self {
        Self {
            id,
            model: CameraModel::PINHOLE,
            width: camera.width.into(),
            height: camera.height.into(),
            parameters: [camera.fx, camera.fy, camera.cx, camera.cy].map(f64::from).to_vec(),
        }
    }
}

/// A registered image.
#[derive(Clone, Debug, PartialEq)]
pub struct ColmapImage {
    /// COLMAP's id; ids may have gaps and are in no order.
    pub id: u32,
    /// Id of its camera.
    pub camera_id: u32,
    /// Path below the images folder.
    pub name: String,
    /// Rotation from world to camera as quaternion (w, x, y, z), not necessarily of unit length.
    pub quat: [f64; 4],
    /// Translation from the file's coordinates to the camera.
    pub translation: [f64; 3],
}

impl ColmapImage {
    /// The registered image with the pose of `camera`.
    pub fn posed(id: u32, camera_id: u32, name: impl Into<String>, camera: &Camera) -> Self {
        let quat = DQuat::from_mat3(&camera.camera_from_world.as_dmat3()).normalize();
        let translation = camera.translation.as_dvec3().to_array();
        Self { id, camera_id, name: name.into(), quat: [quat.w, quat.x, quat.y, quat.z], translation }
    }

    /// Rotation from the file's coordinates to the camera's axes.
    pub fn rotation(&self) -> DMat3 {
        let [w, x, y, z] = self.quat;
        DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize())
    }

    /// The photo's path below the images folder.
    ///
    /// # Errors
    /// [`Error::Input`] naming `model_file` when the name is absolute or leads out of the folder, or is longer than
    /// paths can be.
    pub fn photo_path(&self, images_folder: &Path, model_file: &Path) -> Result<PathBuf> {
        if self.name.len() > MAX_PATH_BYTES {
            let problem = format!("image {}: the name has {} bytes", self.id, self.name.len());
            return Err(Error::input(model_file, problem, format!("{MAX_PATH_BYTES} are possible")));
        }
        let name = plain(&self.name);
        if stays_inside(&name) {
            return Ok(images_folder.join(name));
        }
        let (id, name) = (self.id, ending(&self.name));
        let problem = format!("image {id}: the name {name:?} leads out of the images folder");
        Err(Error::input(model_file, problem, "names must be paths below the images folder"))
    }
}

/// A rotation as quaternion (w, x, y, z), and a translation.
#[derive(Clone, Copy)]
pub(super) struct Pose {
    pub(super) quat: [f64; 4],
    pub(super) translation: [f64; 3],
}

impl Pose {
    pub(super) const IDENTITY: Self = Self { quat: [1.0, 0.0, 0.0, 0.0], translation: [0.0; 3] };

    pub(super) fn of(image: &ColmapImage) -> Self {
        Self { quat: image.quat, translation: image.translation }
    }

    pub(super) fn axes(self) -> (DMat3, DVec3) {
        let [w, x, y, z] = self.quat;
        let rotation = DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize());
        (rotation, DVec3::from_array(self.translation))
    }
}

#[derive(Clone, Copy, PartialEq, Eq, Hash)]
pub(super) struct Sensor {
    /// False for an IMU or another sensor without images.
    pub(super) is_camera: bool,
    pub(super) id: u32,
}

/// Pose of each sensor in the rig; `None` if COLMAP does not know it.
pub(super) type Rig = HashMap<Sensor, Option<Pose>>;

/// Images that the sensors of a rig took at one time.
pub(super) struct Frame {
    pub(super) id: u32,
    pub(super) rig: u32,
    /// From the world to the rig.
    pub(super) pose: Pose,
    /// Each sensor with the id of its image.
    pub(super) data: Vec<(Sensor, u64)>,
}
