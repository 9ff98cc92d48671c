//! The motion of a Gaussian's mean on the screen, the twin of `forward/screen_motion`.

use super::linear::apply;
use super::types::View;

/// Screen position of a mean (px, pixel centres at the integers) and its depth.
fn seen(mean: [f64; 3], view: &View) -> ([f64; 2], f64) {
    let rotated = apply(&view.camera_from_world, mean);
    let [x, y, z] = [0, 1, 2].map(|i| rotated[i] + view.translation[i]);
    let distance = if view.drawn.orthographic { 1.0 } else { z };
    let at = |k: usize, v: f64| view.focal_px[k] * v / distance + view.center_px[k] - 0.5;
    ([at(0, x), at(1, y)], z)
}

/// Position in `view` minus position in `before`, px, at most the picture's size. Zero if the mean was behind the
/// camera `before`.
pub fn screen_motion(mean: [f64; 3], view: &View, before: &View) -> [f64; 2] {
    let ([x, y], _) = seen(mean, view);
    let ([x0, y0], z0) = seen(mean, before);
    let [w, h] = view.size_px.map(f64::from);
    if z0 > 0.2 { [(x - x0).clamp(-w, w), (y - y0).clamp(-h, h)] } else { [0.0; 2] }
}
