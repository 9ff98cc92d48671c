//! Observations: the places in photos that show a model's points.

use std::collections::HashMap;
use std::path::PathBuf;

use glam::{DMat3, DVec2, DVec3};

use super::model::Model;
use super::types::{ColmapImage, Observed};
use super::{binary, text};
use crate::depth_fit::DepthPoint;
use ashsplat::Result;
use ashsplat::scene::lens::Distortion;

/// Positions of points by id, the file's coordinates.
type Positions = HashMap<u64, [f64; 3]>;

/// Reads the observations of each image, and the points' positions.
fn read(model: &Model) -> Result<(Vec<Observed>, Positions)> {
    let (images, points) = (model.file("images"), model.points_file());
    let observed =
        if model.source.text { text::observations(&images)? } else { binary::observations(&images)? };
    let positions = match &points {
        None => HashMap::new(),
        Some(file) if file.extension().is_some_and(|ending| ending == "txt") => text::positions(file)?,
        // Points of a PLY have no ids.
        Some(file) if file.extension().is_some_and(|ending| ending == "ply") => HashMap::new(),
        Some(file) => binary::positions(file)?,
    };
    Ok((observed, positions))
}

/// The points that each image of a model shows, by image id.
///
/// # Errors
/// Same as [`Model::read`].
pub fn observations(model: &Model) -> Result<HashMap<u32, Vec<DepthPoint>>> {
    let (observed, positions) = read(model)?;
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
///
/// # Errors
/// Same as [`Model::read`].
pub fn tracks(model: &Model) -> Result<HashMap<u32, Vec<[f64; 3]>>> {
    let (observed, positions) = read(model)?;
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
    if bytes(model.file("images")).saturating_add(bytes(model.points_file()?)) > MOST_BYTES {
        return None;
    }
    let (observed, positions) = read(model).ok()?;
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
