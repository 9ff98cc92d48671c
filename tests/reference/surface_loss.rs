//! Losses that shape surfaces: the twins of `loss/surface_depth`, `loss/surface_planarity` and `loss/surface_alignment`. Their
//! gradients are finite differences.

use super::linear::{dot, rotation};
use super::types::{Gaussian, View};

/// Inverse depth of each pixel from the sum of weights / z and the coverage. None where less than half is covered.
pub fn surface_depths(sums: &[f64], coverages: &[f64]) -> Vec<Option<f64>> {
    let depth = |(&sum, &coverage): (&f64, &f64)| (coverage > 0.5).then(|| sum / coverage);
    sums.iter().zip(coverages).map(depth).collect()
}

/// Sum of the bends of all pixels. Differences are divided by the inverse depths of `scales`.
pub fn planarity(depths: &[Option<f64>], scales: &[Option<f64>], size: [usize; 2], stride: usize) -> f64 {
    let [width, height] = size.map(|side| side as isize);
    let index = |x: isize, y: isize| {
        ((0..width).contains(&x) && (0..height).contains(&y)).then_some((y * width + x) as usize)
    };
    let mut sum = 0.0;
    for (x, y) in (0..height).flat_map(|y| (0..width).map(move |x| (x, y))) {
        for [dx, dy] in [[stride as isize, 0], [0, stride as isize]] {
            let at = |side: isize| index(x + side * dx, y + side * dy).and_then(|pixel| depths[pixel]);
            let scale = index(x, y).and_then(|pixel| scales[pixel]);
            if let (Some(before), Some(here), Some(after), Some(scale)) = (at(-1), at(0), at(1), scale) {
                let square = ((before - 2.0 * here + after) / (0.02 * scale)).powi(2);
                sum += square / (1.0 + square);
            }
        }
    }
    sum
}

/// The surface at a Gaussian's mean.
pub struct Surface {
    /// Unit normal in the world.
    normal: [f64; 3],
    share: f64,
    /// Index of the shortest axis.
    shortest: usize,
    /// Pixels per unit of the shortest axis.
    px_per_unit: f64,
}

impl Surface {
    /// None where the picture has no surface around the mean.
    pub fn at(
        gaussian: &Gaussian,
        view: &View,
        (mean2d_px, conic, opacity): ([f64; 2], [f64; 3], f64),
        depths: &[Option<f64>],
        stride: usize,
    ) -> Option<Surface> {
        let [width, height] = view.size_px.map(|side| side as usize);
        let side = stride as f64;
        let inside =
            |axis: usize| (side..=[width, height][axis] as f64 - side - 1.0).contains(&mean2d_px[axis]);
        if !inside(0) || !inside(1) {
            return None;
        }
        let at = mean2d_px.map(|x| (x + 0.5).floor());
        let depth = |x: f64, y: f64| depths[(at[1] + y) as usize * width + (at[0] + x) as usize];
        let here = depth(0.0, 0.0)?;
        let slope = [
            (depth(side, 0.0)? - depth(-side, 0.0)?) / (2.0 * side),
            (depth(0.0, side)? - depth(0.0, -side)?) / (2.0 * side),
        ];
        // Pixel centres at the integers.
        let offset = [0, 1].map(|axis| at[axis] - (view.center_px[axis] - 0.5));
        let normal = [
            slope[0] * view.focal_px[0],
            slope[1] * view.focal_px[1],
            here - offset[0] * slope[0] - offset[1] * slope[1],
        ];
        let length = dot(normal, normal).sqrt();
        let rows = view.camera_from_world;
        let normal = [0, 1, 2].map(|k| (0..3).map(|row| rows[row][k] * normal[row]).sum::<f64>() / length);
        let inverse_depth = here + slope[0] * (mean2d_px[0] - at[0]) + slope[1] * (mean2d_px[1] - at[1]);
        let z = dot(view.camera_from_world[2], gaussian.mean) + view.translation[2];
        let away = (z * inverse_depth - 1.0) / 0.05;
        let area = 2.0 * std::f64::consts::PI / (conic[0] * conic[2] - conic[1] * conic[1]).sqrt();
        let share = area * opacity.min(1.0) * (-away * away).exp();
        let shortest =
            (0..3).fold(0, |shortest, k| match gaussian.log_scale[k] < gaussian.log_scale[shortest] {
                true => k,
                false => shortest,
            });
        Some(Surface { normal, share, shortest, px_per_unit: view.focal_px[0] / z })
    }

    /// `weights`: of the turn and the flattening.
    pub fn loss(&self, gaussian: &Gaussian, weights: [f64; 2]) -> f64 {
        let length = gaussian.quat.iter().map(|x| x * x).sum::<f64>().sqrt();
        let axes = rotation(gaussian.quat.map(|x| x / length));
        let along = dot([0, 1, 2].map(|row| axes[row][self.shortest]), self.normal);
        let thickness = gaussian.log_scale[self.shortest].exp() * self.px_per_unit;
        self.share * (weights[0] * (1.0 - along * along) + weights[1] * thickness)
    }
}
