//! Where the photos of a model show its points.

use std::collections::HashMap;

use glam::{DMat3, DVec3};

use super::model::Model;
use super::types::{ColmapImage, Observed};
use super::{binary, text};
use crate::depth_fit::DepthPoint;
use ashsplat::Result;

/// Positions of points by their ids, the file's coordinates.
type Positions = HashMap<u64, [f64; 3]>;

/// What each image shows, and the points.
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

/// The points that each image of a model shows, by the image's id.
///
/// # Errors
/// As [`Model::read`].
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

/// The positions, in the file's coordinates, of the points that each image of a model shows, by the image's id: once each, in the order of the
/// points' ids.
///
/// # Errors
/// As [`Model::read`].
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
