//! Normal and slope of depth of a Gaussian, the twin of `forward/splat_surfaces`.

use super::cull::camera_position;
use super::linear::{apply, dot, normalize_quat, rotation, transpose};
use super::project::intermediate;
use super::types::{Gaussian, View};

/// Returns the shortest axis in the camera's frame, turned towards the camera, and its scalar product with the vector to the
/// Gaussian, which is negative.
pub fn splat_normal(gaussian: &Gaussian, view: &View) -> ([f64; 3], f64) {
    let scales = gaussian.log_scale;
    let shortest = (0..3).min_by(|&a, &b| scales[a].total_cmp(&scales[b])).expect("three axes");
    let axis = transpose(&rotation(normalize_quat(gaussian.quat).0))[shortest];
    let normal = apply(&view.camera_from_world, axis);
    let toward = if view.drawn.orthographic { [0.0, 0.0, 1.0] } else { camera_position(gaussian, view) };
    let away = dot(normal, toward);
    (normal.map(|x| if away > 0.0 { -x } else { x }), -away.abs())
}

/// Change of the depth of largest density per px, world units. None before the near plane.
pub fn depth_slope(gaussian: &Gaussian, view: &View) -> Option<[f64; 2]> {
    let on_the_way = intermediate(gaussian, view)?;
    let with_z = apply(&on_the_way.cov3d, view.camera_from_world[2]);
    let [x, y] = [0, 1].map(|row| dot(on_the_way.jr[row], with_z));
    let [a, b, c] = on_the_way.cov2d_undilated;
    let (a, c) = (a + on_the_way.dilation_px2, c + on_the_way.dilation_px2);
    let determinant = a * c - b * b;
    Some([(c * x - b * y) / determinant, (a * y - b * x) / determinant])
}
