//! The normal of a Gaussian, the twin of `forward/splat_normals`.

use super::cull::camera_position;
use super::linear::{apply, normalize_quat, rotation, transpose};
use super::types::{Gaussian, View};

/// The shortest axis in the camera's frame, turned towards the camera; and the cosine, negative, of its angle from the direction
/// of view times the distance.
pub fn splat_normal(gaussian: &Gaussian, view: &View) -> ([f64; 3], f64) {
    let scales = gaussian.log_scale;
    let shortest = (0..3).min_by(|&a, &b| scales[a].total_cmp(&scales[b])).expect("three axes");
    let axis = transpose(&rotation(normalize_quat(gaussian.quat).0))[shortest];
    let normal = apply(&view.camera_from_world, axis);
    let toward = if view.drawn.orthographic { [0.0, 0.0, 1.0] } else { camera_position(gaussian, view) };
    let away: f64 = (0..3).map(|i| normal[i] * toward[i]).sum();
    (normal.map(|x| if away > 0.0 { -x } else { x }), -away.abs())
}
