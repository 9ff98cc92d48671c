//! Writes binary models.

use std::io::{self, Write};
use std::path::Path;

use glam::DQuat;

use super::types::{CameraModel, ColmapCamera, ColmapImage};
use crate::atomic;
use ashsplat::scene::{Camera, PointCloud};
use ashsplat::{Error, Result};

/// Writes cameras.bin, images.bin and points3D.bin into a folder, which it creates. It writes no observations and
/// no tracks; points get the ids 1, 2, ….
///
/// # Errors
/// [`Error::Argument`] when a camera has the wrong number of parameters or a name a zero byte, [`Error::Io`] naming
/// the file or folder when it cannot be written.
pub fn write(
    folder: impl AsRef<Path>,
    cameras: &[ColmapCamera],
    images: &[ColmapImage],
    points: &PointCloud,
) -> Result<()> {
    let folder = folder.as_ref();
    check(cameras, images)?;
    atomic::create_folder(folder)?;
    atomic::write(folder.join("cameras.bin"), |w| write_cameras(w, cameras))?;
    atomic::write(folder.join("images.bin"), |w| write_images(w, images))?;
    atomic::write(folder.join("points3D.bin"), |w| write_points(w, points))
}

fn check(cameras: &[ColmapCamera], images: &[ColmapImage]) -> Result<()> {
    if let Some(c) = cameras.iter().find(|c| c.parameters.len() != c.model.parameters()) {
        let (name, needs, has) = (c.model.name(), c.model.parameters(), c.parameters.len());
        return Err(Error::argument(
            format!("camera {}", c.id),
            format!("{name} needs {needs} parameters, not {has}"),
        ));
    }
    match images.iter().find(|image| image.name.is_empty() || image.name.contains('\0')) {
        Some(image) => {
            Err(Error::argument(format!("image {}", image.id), "its name is empty or has a zero byte"))
        }
        None => Ok(()),
    }
}

fn write_cameras(w: &mut dyn Write, cameras: &[ColmapCamera]) -> io::Result<()> {
    w.write_all(&(cameras.len() as u64).to_le_bytes())?;
    for camera in cameras {
        w.write_all(&camera.id.to_le_bytes())?;
        w.write_all(&camera.model.number().to_le_bytes())?;
        w.write_all(&camera.width.to_le_bytes())?;
        w.write_all(&camera.height.to_le_bytes())?;
        doubles(w, &camera.parameters)?;
    }
    Ok(())
}

fn write_images(w: &mut dyn Write, images: &[ColmapImage]) -> io::Result<()> {
    w.write_all(&(images.len() as u64).to_le_bytes())?;
    for image in images {
        w.write_all(&image.id.to_le_bytes())?;
        doubles(w, &image.quat)?;
        doubles(w, &image.translation)?;
        w.write_all(&image.camera_id.to_le_bytes())?;
        w.write_all(image.name.as_bytes())?;
        w.write_all(&[0])?;
        w.write_all(&0u64.to_le_bytes())?;
    }
    Ok(())
}

fn write_points(w: &mut dyn Write, points: &PointCloud) -> io::Result<()> {
    w.write_all(&(points.len() as u64).to_le_bytes())?;
    for (id, (position, color)) in (1u64..).zip(points.positions.iter().zip(&points.colors)) {
        w.write_all(&id.to_le_bytes())?;
        doubles(w, &position.map(f64::from))?;
        w.write_all(color)?;
        doubles(w, &[0.0])?;
        w.write_all(&0u64.to_le_bytes())?;
    }
    Ok(())
}

fn doubles(w: &mut dyn Write, values: &[f64]) -> io::Result<()> {
    values.iter().try_for_each(|value| w.write_all(&value.to_le_bytes()))
}

impl ColmapCamera {
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

impl ColmapImage {
    /// The registered image with the pose of `camera`.
    pub fn posed(id: u32, camera_id: u32, name: impl Into<String>, camera: &Camera) -> Self {
        let quat = DQuat::from_mat3(&camera.camera_from_world.as_dmat3()).normalize();
        let translation = camera.translation.as_dvec3().to_array();
        Self { id, camera_id, name: name.into(), quat: [quat.w, quat.x, quat.y, quat.z], translation }
    }
}
