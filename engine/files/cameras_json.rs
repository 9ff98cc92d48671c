//! `cameras.json`, the list of cameras that the reference implementation writes next to a model.

use std::fs;
use std::path::Path;

use glam::{DMat3, DVec3};
use serde::{Deserialize, Serialize};

use super::{atomic, cost, host_memory};
use ashsplat::scene::{Camera, Intrinsics};
use ashsplat::{Error, Result};

/// One camera with the name of its picture.
#[derive(Clone, Debug, PartialEq)]
pub struct NamedCamera {
    /// Name of the picture.
    pub name: String,
    /// The camera.
    pub camera: Camera,
}

/// The file's own form: position and the rows of the rotation from camera to world.
#[derive(Serialize, Deserialize)]
struct Entry {
    id: usize,
    img_name: String,
    width: u32,
    height: u32,
    position: [f64; 3],
    rotation: [[f64; 3]; 3],
    fy: f32,
    fx: f32,
    /// Missing in the reference implementation's file, which supports centred cameras only.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    cx: Option<f32>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    cy: Option<f32>,
    /// Only of an orthographic camera, whose fx and fy are pixels per unit.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    projection: Option<Rays>,
}

#[derive(Clone, Copy, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Rays {
    Perspective,
    Orthographic,
}

impl Entry {
    fn new(id: usize, name: &str, camera: &Camera) -> Self {
        let world_from_camera = camera.camera_from_world.transpose();
        Self {
            id,
            img_name: name.to_owned(),
            width: camera.width,
            height: camera.height,
            position: camera.exact_position().to_array(),
            rotation: [0, 1, 2].map(|row| world_from_camera.row(row).as_dvec3().to_array()),
            fy: camera.fy,
            fx: camera.fx,
            cx: Some(camera.cx),
            cy: Some(camera.cy),
            projection: camera.is_orthographic().then_some(Rays::Orthographic),
        }
    }

    fn camera(&self) -> Camera {
        let camera_from_world = DMat3::from_cols_array_2d(&self.rotation);
        let intrinsics = Intrinsics {
            fx: self.fx,
            fy: self.fy,
            cx: self.cx.unwrap_or(0.5 * self.width as f32),
            cy: self.cy.unwrap_or(0.5 * self.height as f32),
            width: self.width,
            height: self.height,
        };
        let camera = Camera::at(DVec3::from_array(self.position), camera_from_world, intrinsics);
        match self.projection {
            Some(Rays::Orthographic) => camera.orthographic(),
            Some(Rays::Perspective) | None => camera,
        }
    }
}

/// Writes cameras in the reference implementation's form: id, img_name, width, height, position and rotation
/// (camera to world, rows), fy, fx. It adds cx and cy, which the reference's readers ignore, and for
/// orthographic cameras `"projection": "orthographic"`.
///
/// # Errors
/// [`Error::Io`] naming the file.
pub fn write<'a>(
    path: impl AsRef<Path>,
    cameras: impl IntoIterator<Item = (&'a str, &'a Camera)>,
) -> Result<()> {
    let entries: Vec<Entry> =
        cameras.into_iter().enumerate().map(|(id, (name, camera))| Entry::new(id, name, camera)).collect();
    atomic::write(path, |writer| Ok(serde_json::to_writer(writer, &entries)?))
}

/// Reads cameras that [`write()`] or the reference implementation wrote. Without cx and cy, the principal point is
/// in the middle.
///
/// # Errors
/// [`Error::Io`] when the file cannot be read, [`Error::Input`] when it is no such list or a camera is unusable.
pub fn read(path: impl AsRef<Path>) -> Result<Vec<NamedCamera>> {
    let path = path.as_ref();
    host_memory::check_text_file(path)?;
    let text = fs::read(path).map_err(|source| Error::io(path, "read", source))?;
    let entries: Vec<Entry> = serde_json::from_slice(&text).map_err(|e| {
        Error::input(
            path,
            format!("is not a list of cameras: {e}"),
            "expected [{id, img_name, width, height, position, rotation, fx, fy}, …]",
        )
    })?;
    let check = |entry: &Entry| {
        cost::step();
        let camera = entry.camera();
        if let Some(problem) = camera.problem() {
            return Err(Error::input(
                path,
                format!("camera {}: {problem}", entry.id),
                "correct it in the file",
            ));
        }
        Ok(NamedCamera { name: entry.img_name.clone(), camera })
    };
    entries.iter().map(check).collect()
}
