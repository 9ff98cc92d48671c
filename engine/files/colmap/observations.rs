//! Where the photos of a model show its points.

use std::collections::HashMap;

use glam::{DQuat, DVec3};

use super::model::Model;
use super::types::Observed;
use super::{binary, text};
use crate::depth_fit::DepthPoint;
use ashsplat::Result;

/// The points that each image of a model shows, by the image's id.
///
/// # Errors
/// As [`Model::read`].
pub fn observations(model: &Model) -> Result<HashMap<u32, Vec<DepthPoint>>> {
    let (images, points) = (model.file("images"), model.points_file());
    let observed =
        if model.source.text { text::observations(&images)? } else { binary::observations(&images)? };
    let positions = match &points {
        None => HashMap::new(),
        Some(file) if file.extension().is_some_and(|ending| ending == "txt") => text::positions(file)?,
        Some(file) => binary::positions(file)?,
    };
    let poses: HashMap<u32, (DQuat, DVec3)> = model
        .images
        .iter()
        .map(|image| {
            let [w, x, y, z] = image.quat;
            (image.id, (DQuat::from_xyzw(x, y, z, w).normalize(), DVec3::from_array(image.translation)))
        })
        .collect();
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
