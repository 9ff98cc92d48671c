//! Finds cameras that can hardly belong to their photos.

use std::path::Path;

use ashsplat::scene::lens::{Distortion, Lens};

/// Plausible angles of view from edge to edge, degrees: from long telephoto lenses to the widest pinhole.
const ANGLES: std::ops::RangeInclusive<f64> = 3.0..=150.0;

/// Largest plausible ratio of the focal lengths; pixels are square except with anamorphic lenses.
const ASPECT: f64 = 1.3;

/// Largest plausible offset of the principal point, in image sizes. A camera of photos of half the size is 0.25 off.
const OFF_CENTER: f64 = 0.2;

/// A warning about the named cameras if one is doubtful.
pub(super) fn warning<'a>(file: &Path, lenses: impl Iterator<Item = (String, &'a Lens)>) -> Option<String> {
    let mut doubts = lenses.filter_map(|(name, lens)| Some((name, doubt(lens)?)));
    let (name, what) = doubts.next()?;
    let others = match doubts.count() {
        0 => String::new(),
        others => format!(" (and {others} more)"),
    };
    Some(format!(
        "{}: {name} has {what}{others}: is it of photos of another size, or in other units?",
        file.display()
    ))
}

fn doubt(lens: &Lens) -> Option<String> {
    let (focal, center) = (lens.focal_px.to_array(), lens.center_px.to_array());
    let sides = [lens.width, lens.height].map(f64::from);
    for axis in 0..2 {
        let angle = 2.0 * (0.5 * sides[axis] / focal[axis]).atan().to_degrees();
        let plane = !matches!(lens.distortion, Distortion::Fisheye { .. });
        if plane && !ANGLES.contains(&angle) {
            return Some(format!(
                "a field of view of {angle:.1} degrees (focal length {} for {} pixels)",
                focal[axis], sides[axis]
            ));
        }
        if (center[axis] - 0.5 * sides[axis]).abs() > OFF_CENTER * sides[axis] {
            return Some(format!("its principal point at {} of {} pixels", center[axis], sides[axis]));
        }
    }
    let ratio = focal[0] / focal[1];
    let doubtful = !(ASPECT.recip()..=ASPECT).contains(&ratio);
    doubtful.then(|| format!("focal lengths of {} and {} pixels", focal[0], focal[1]))
}
