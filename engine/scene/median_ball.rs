//! Position and size of the middle half of some points. Unlike a box, they do not depend on the farthest point.

use glam::DVec3;

/// Median of each axis, and median distance from there. None without points, and if the distance is not positive.
pub fn median_ball(points: &[DVec3]) -> Option<(DVec3, f64)> {
    let axis = |axis: usize| median(points.iter().map(|p| p[axis]).collect());
    let center = DVec3::new(axis(0), axis(1), axis(2));
    let radius = median(points.iter().map(|p| p.distance(center)).collect());
    (radius > 0.0 && radius.is_finite()).then_some((center, radius))
}

/// The upper median; 0 without values.
fn median(mut values: Vec<f64>) -> f64 {
    let middle = values.len() / 2;
    if values.is_empty() { 0.0 } else { *values.select_nth_unstable_by(middle, f64::total_cmp).1 }
}
