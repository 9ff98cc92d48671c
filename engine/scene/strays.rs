//! Cameras far from all others. Usually their poses are wrong, and would determine an extent, an orbit or a box instead of the
//! scene.

use glam::{DVec3, Vec3};

/// Minimum distance of a stray from the median position, in median distances. Ordinary data sets stay below 2.4. If the extent
/// includes one distant camera of 40, quality falls by 0.1 dB at 5, 0.9 at 10 and 3.4 at 30.
const FAR: f64 = 8.0;

/// Number of other cameras within [`FAR`] that make a far camera no stray, but for example a block of a city.
const COMPANIONS: usize = 3;

/// Minimum number of cameras for finding strays.
const MIN_CAMERAS: usize = 5;

/// Maximum number of strays, because each is compared with all cameras.
const MAX_STRAYS: usize = 1000;

/// For each stray, its distance from the median position in median distances. At most a fifth of the cameras are strays, or
/// one; if more stand apart, none is.
pub fn strays(positions: &[Vec3]) -> Vec<Option<f64>> {
    let count = positions.len();
    let points: Vec<_> = positions.iter().map(|position| position.as_dvec3()).collect();
    let none = || vec![None; count];
    let Some((center, radius)) = median_ball(&points).filter(|_| count >= MIN_CAMERAS) else {
        return none();
    };
    let reach = FAR * radius;
    // Neighbours in the list usually are neighbours in space.
    let is_lonely = |index: usize| {
        let others = (1..count).flat_map(|step| [index.checked_sub(step), Some(index + step)]);
        let others = others.flatten().filter(|&other| other < count);
        others.filter(|&other| points[other].distance(points[index]) < reach).take(COMPANIONS).count()
            < COMPANIONS
    };
    let (mut found, mut strays) = (none(), 0);
    for (index, point) in points.iter().enumerate() {
        let distance = point.distance(center);
        if distance > reach && is_lonely(index) {
            found[index] = Some(distance / radius);
            strays += 1;
            if strays > (count / 5).clamp(1, MAX_STRAYS) {
                return none();
            }
        }
    }
    found
}

/// Returns all but the strays, in their order.
pub fn without_strays<T: Copy>(all: &[T], position: impl Fn(&T) -> Vec3) -> Vec<T> {
    let strays = strays(&all.iter().map(position).collect::<Vec<_>>());
    all.iter().zip(strays).filter(|(_, stray)| stray.is_none()).map(|(&one, _)| one).collect()
}

/// Index of the farthest camera and its distance from the median position in median distances, if it is unusually large.
pub fn far_camera(positions: &[Vec3]) -> Option<(usize, f64)> {
    let points: Vec<_> = positions.iter().map(|position| position.as_dvec3()).collect();
    let (center, radius) = median_ball(&points).filter(|_| points.len() >= MIN_CAMERAS)?;
    let distances = points.iter().map(|point| point.distance(center) / radius).enumerate();
    distances.max_by(|one, other| one.1.total_cmp(&other.1)).filter(|far| far.1 > FAR)
}

/// Position and size of the middle half of some points, which do not depend on the farthest one: the median of each axis,
/// and the median distance from there. None without points, and if the distance is not positive.
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
