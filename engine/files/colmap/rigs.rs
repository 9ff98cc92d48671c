//! Rigs of cameras and the frames that they took, from COLMAP 3.12 on.
//!
//! The pose of an image is written twice: in `images`, and as its frame's `rig_from_world` followed by its sensor's
//! `sensor_from_rig`. "Newer output reconstructions' `cameras` and `images` files are fully compatible with old outputs"
//! (COLMAP's documentation, "Sparse Reconstruction"), so those of `images` are used, and the others are compared with them.

use std::collections::HashMap;

use glam::{DMat3, DVec3};

use super::find::ModelFolder;
use super::read;
use super::records::{ColmapImage, Pose};
use ashsplat::Result;

/// Warns where the rigs of a model contradict its images. Returns a note of the rigs if any has several sensors.
pub(super) fn compare(
    source: &ModelFolder,
    images: &[ColmapImage],
    warnings: &mut Vec<String>,
) -> Result<Option<String>> {
    let [rigs_file, frames_file, used] = ["rigs", "frames", "images"].map(|part| source.file(part));
    if !rigs_file.is_file() || !frames_file.is_file() {
        return Ok(None);
    }
    let (rigs, frames) = (read::rigs(&rigs_file)?, read::frames(&frames_file)?);
    let used = used.file_name().unwrap_or_default().display();
    let most = rigs.values().map(HashMap::len).max().unwrap_or(0);
    let note = (most > 1).then(|| {
        let (file, rigs, frames) = (rigs_file.display(), rigs.len(), frames.len());
        format!("{file}: {rigs} rigs of up to {most} sensors, {frames} frames: the poses are those of {used}")
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
