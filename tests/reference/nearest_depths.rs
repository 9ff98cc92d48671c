//! Depths for the 3D filter; the twin of `forward/nearest_depths`.

use super::linear::apply;
use super::types::{NEAR, View};

/// The least depth of a mean in the cameras that see it, including 15 % of the picture around it.
pub fn nearest_depth(mean: [f64; 3], cameras: &[View]) -> Option<f64> {
    let depths = cameras.iter().filter_map(|view| {
        let rotated = apply(&view.camera_from_world, mean);
        let [x, y, z] = [0, 1, 2].map(|i| rotated[i] + view.translation[i]);
        let inside = |position: f64, axis: usize| {
            let (size, px) =
                (f64::from(view.size_px[axis]), view.focal_px[axis] * position / z + view.center_px[axis]);
            (-0.15 * size..=1.15 * size).contains(&px)
        };
        (z > NEAR && inside(x, 0) && inside(y, 1)).then_some(z)
    });
    depths.reduce(f64::min)
}
