//! Photos as a pinhole camera would have taken them.

use glam::dvec2;
use rayon::prelude::*;

use super::Photo;
use ashsplat::scene::camera::Intrinsics;
use ashsplat::scene::lens::Lens;

/// Resamples the photo of a lens for a pinhole camera: bilinear, black outside the photo.
///
/// `lens` has the photo's size. The rows are computed in parallel.
pub fn undistort(photo: &Photo, lens: &Lens, pinhole: &Intrinsics) -> Photo {
    let (width, height) = (pinhole.width as usize, pinhole.height as usize);
    let focal = dvec2(f64::from(pinhole.fx), f64::from(pinhole.fy));
    let center = dvec2(f64::from(pinhole.cx), f64::from(pinhole.cy));
    let mut rgb = vec![0; 3 * width * height];
    rgb.par_chunks_exact_mut(3 * width).enumerate().for_each(|(y, row)| {
        for (x, pixel) in row.as_chunks_mut::<3>().0.iter_mut().enumerate() {
            let point = (dvec2(x as f64 + 0.5, y as f64 + 0.5) - center) / focal;
            let place = lens.project(point) - 0.5;
            *pixel = bilinear(photo, place.x, place.y).unwrap_or([0; 3]);
        }
    });
    Photo { width: pinhole.width, height: pinhole.height, rgb }
}

/// The colour at a place, with the first pixel's centre at 0; `None` outside the centres of the border.
fn bilinear(photo: &Photo, x: f64, y: f64) -> Option<[u8; 3]> {
    let (left, top) = (x.floor(), y.floor());
    let (last_x, last_y) = (f64::from(photo.width) - 1.0, f64::from(photo.height) - 1.0);
    // The comparison is false for NaN.
    if !(left >= 0.0 && top >= 0.0 && left <= last_x && top <= last_y) || x > last_x || y > last_y {
        return None;
    }
    let (dx, dy) = (x - left, y - top);
    let row_bytes = 3 * photo.width as usize;
    let at = 3 * left as usize + row_bytes * top as usize;
    let (right, below) = (if dx > 0.0 { 3 } else { 0 }, if dy > 0.0 { row_bytes } else { 0 });
    Some(std::array::from_fn(|channel| {
        let value = |offset: usize| f64::from(photo.rgb[at + offset + channel]);
        let upper = (1.0 - dx) * value(0) + dx * value(right);
        let lower = (1.0 - dx) * value(below) + dx * value(below + right);
        ((1.0 - dy) * upper + dy * lower).round() as u8
    }))
}
