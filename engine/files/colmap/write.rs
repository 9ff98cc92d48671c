//! Writes cameras.bin, images.bin and points3D.bin.

use std::io::{self, Write};
use std::path::Path;

use super::records::{ColmapCamera, ColmapImage};
use crate::atomic;
use ashsplat::scene::PointCloud;
use ashsplat::{Error, Result};

/// Writes cameras.bin, images.bin and points3D.bin into a folder, which it creates. It writes no observations and
/// no tracks; points get the ids 1, 2, ….
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
        let problem = format!("{name} needs {needs} parameters, not {has}");
        return Err(Error::argument(format!("camera {}", c.id), problem));
    }
    if let Some(image) = images.iter().find(|image| image.name.is_empty() || image.name.contains('\0')) {
        return Err(Error::argument(format!("image {}", image.id), "its name is empty or has a zero byte"));
    }
    Ok(())
}

fn write_cameras(w: &mut dyn Write, cameras: &[ColmapCamera]) -> io::Result<()> {
    w.write_all(&(cameras.len() as u64).to_le_bytes())?;
    for ColmapCamera { id, model, width, height, parameters } in cameras {
        w.write_all(&id.to_le_bytes())?;
        w.write_all(&model.number().to_le_bytes())?;
        w.write_all(&width.to_le_bytes())?;
        w.write_all(&height.to_le_bytes())?;
        doubles(w, parameters)?;
    }
    Ok(())
}

fn write_images(w: &mut dyn Write, images: &[ColmapImage]) -> io::Result<()> {
    w.write_all(&(images.len() as u64).to_le_bytes())?;
    for ColmapImage { id, camera_id, name, quat, translation } in images {
        w.write_all(&id.to_le_bytes())?;
        doubles(w, quat)?;
        doubles(w, translation)?;
        w.write_all(&camera_id.to_le_bytes())?;
        w.write_all(name.as_bytes())?;
        // NUL after the name, and 0 observations as u64.
        w.write_all(&[0; 9])?;
    }
    Ok(())
}

fn write_points(w: &mut dyn Write, points: &PointCloud) -> io::Result<()> {
    w.write_all(&(points.len() as u64).to_le_bytes())?;
    for (id, (position, color)) in (1u64..).zip(points.positions.iter().zip(&points.colors)) {
        w.write_all(&id.to_le_bytes())?;
        doubles(w, &position.map(f64::from))?;
        w.write_all(color)?;
        // No error, and no track.
        w.write_all(&[0; 16])?;
    }
    Ok(())
}

fn doubles(w: &mut dyn Write, values: &[f64]) -> io::Result<()> {
    values.iter().try_for_each(|value| w.write_all(&value.to_le_bytes()))
}
