//! Finds Gaussians that no picture can show, on the host and before any of them is on a device.
//!
//! The test is a bound, not the projection itself: a Gaussian counts as visible if a ball of its largest axis may reach a
//! pixel. So dropping the others changes no bit of any picture.

use crate::scene::camera::NEAR_PLANE;
use crate::scene::{Camera, Gaussians};
use glam::{DMat3, DVec2, DVec3};

/// Number of standard deviations beyond which alpha is below 1/255 for any opacity, even one that dropout raises.
const REACH: f64 = 4.0;
/// Margin for rounding, pixels.
const ROUNDING_PX: f64 = 1.0;
/// Margin for rounding, as a share of the numbers from which a position is computed.
const ROUNDING: f64 = 1e-6;
/// Margin of the linearisation beyond the picture, as a share of its size.
const BEYOND: f64 = 0.15;

/// A camera in double precision.
struct Sight {
    camera_from_world: DMat3,
    translation: DVec3,
    focal: DVec2,
    center: DVec2,
    size: DVec2,
    /// Minimum absolute slopes with which Gaussians are linearised. Above 0 only if the optical axis lies far outside the whole
    /// picture.
    least_slope: DVec2,
    is_orthographic: bool,
}

impl Sight {
    fn of(camera: &Camera) -> Self {
        let whole = camera.whole();
        let least = |focal: f32, center: f32, side: u32| {
            let [focal, center, side] = [focal.into(), center.into(), f64::from(side)];
            let outside = f64::max(-center, center - side);
            if outside > BEYOND * side { (outside + (1.0 + BEYOND) * side) / focal } else { 0.0 }
        };
        Self {
            least_slope: DVec2::new(
                least(whole.fx, whole.cx, whole.width),
                least(whole.fy, whole.cy, whole.height),
            ),
            camera_from_world: camera.camera_from_world.as_dmat3(),
            translation: camera.translation.as_dvec3(),
            focal: DVec2::new(camera.fx.into(), camera.fy.into()),
            center: DVec2::new(camera.cx.into(), camera.cy.into()),
            size: DVec2::new(camera.width.into(), camera.height.into()),
            is_orthographic: camera.is_orthographic(),
        }
    }

    /// True if the picture may show a Gaussian with this mean and largest axis (a standard deviation), world units, under a
    /// low-pass filter of this variance. True if a number is NaN.
    fn may_show(&self, mean: DVec3, axis: f64, low_pass_px2: f64) -> bool {
        let place = self.camera_from_world * mean + self.translation;
        let rounding = ROUNDING * (mean.abs().max_element() + self.translation.abs().max_element());
        if place.z < 0.999 * f64::from(NEAR_PLANE) - rounding {
            return false;
        }
        let (slope, per_unit) = match self.is_orthographic {
            true => (DVec2::ZERO, self.focal),
            false => (place.truncate() / place.z, self.focal / place.z),
        };
        let pixel = per_unit * place.truncate() + self.center;
        // |row of J W R S|² is at most |row of J W|² times the square of the largest axis.
        let slope = slope.abs().max(self.least_slope);
        let variance = per_unit * per_unit * (1.0 + slope * slope) * (axis * axis) + low_pass_px2;
        let rounding = ROUNDING_PX + ROUNDING * pixel.abs() + rounding * per_unit * (1.0 + slope);
        let half = REACH * DVec2::new(variance.x.sqrt(), variance.y.sqrt()) + rounding;
        !((pixel + half).cmplt(DVec2::ZERO).any() || (pixel - half).cmpgt(self.size).any())
    }
}

/// Per Gaussian: true if any of the cameras may show it, under a low-pass filter of this variance on the screen (px²) and
/// without the 3D filter.
pub(super) fn seen(gaussians: &Gaussians, cameras: &[Camera], low_pass_px2: f64) -> Vec<bool> {
    let sights: Vec<Sight> = cameras.iter().map(Sight::of).collect();
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let each = gaussians.len().div_ceil(threads).max(1);
    let mut seen = vec![false; gaussians.len()];
    std::thread::scope(|scope| {
        for (part, seen) in seen.chunks_mut(each).enumerate() {
            let (first, sights) = (part * each, &sights);
            scope.spawn(move || {
                // The same cameras show neighbours.
                let mut last = 0;
                for (offset, seen) in seen.iter_mut().enumerate() {
                    let index = first + offset;
                    let [mean, scales] = [gaussians.means[index], gaussians.log_scales[index]];
                    let axis = scales.into_iter().fold(f32::NEG_INFINITY, f32::max);
                    let (mean, axis) = (DVec3::from_array(mean.map(f64::from)), f64::from(axis).exp());
                    let order = (last..sights.len()).chain(0..last.min(sights.len()));
                    let found =
                        order.into_iter().find(|&sight| sights[sight].may_show(mean, axis, low_pass_px2));
                    last = found.unwrap_or(last);
                    *seen = found.is_some();
                }
            });
        }
    });
    seen
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Intrinsics;
    use glam::{Vec3, vec3};

    fn seen_by(gaussians: &Gaussians, cameras: &[Camera]) -> Vec<bool> {
        seen(gaussians, cameras, 0.3)
    }

    fn gaussians(means: &[[f32; 3]], log_scale: f32) -> Gaussians {
        let count = means.len();
        Gaussians {
            sh_degree: 0,
            means: means.to_vec(),
            quats: vec![[1.0, 0.0, 0.0, 0.0]; count],
            log_scales: vec![[log_scale, -9.0, -9.0]; count],
            opacity_logits: vec![2.0; count],
            sh: vec![[0.0; 3]; count],
        }
    }

    fn camera() -> Camera {
        let intrinsics = Intrinsics::from_fov_x(std::f32::consts::FRAC_PI_2, 200, 100);
        Camera::look_at(vec3(0.0, 0.0, -5.0), Vec3::ZERO, Vec3::NEG_Y, intrinsics)
    }

    /// At depth 5, the picture is from -5 to 5 in x and -2.5 to 2.5 in y; a pixel is 0.05.
    #[test]
    fn what_lies_beside_or_behind_is_not_seen() {
        let means = [
            [0.0, 0.0, 0.0],
            [5.5, 0.0, 0.0],
            [-5.5, 0.0, 0.0],
            [0.0, 3.0, 0.0],
            [0.0, 0.0, -5.0],
            [0.0, 0.0, -9.0],
            [4.9, 2.4, 0.0],
        ];
        let small = seen_by(&gaussians(&means, -7.0), &[camera()]);
        assert_eq!(small, [true, false, false, false, false, false, true]);
        // With an axis of 0.2, four of them reach 0.8, and more with the slope.
        let large = seen_by(&gaussians(&means, 0.2_f32.ln()), &[camera()]);
        assert_eq!(large, [true, true, true, true, false, false, true]);
        assert_eq!(seen_by(&gaussians(&means, -7.0), &[]), [false; 7]);
        assert!(seen_by(&gaussians(&[], 0.0), &[camera()]).is_empty());
        // A low-pass filter of 10 px² reaches 4 times 3.2 pixels, which are 0.63.
        assert_eq!(seen(&gaussians(&means, -7.0), &[camera()], 10.0)[..4], [true, true, true, true]);
        // Linearised as at the edge of a picture that looks aside: x from 10 to 20, and 4 sqrt(1 + 4.3²) 0.2 beyond.
        let aside = Camera { cx: -200.0, ..camera() };
        let beside = [[6.5, 0.0, 0.0], [5.0, 0.0, 0.0]];
        assert_eq!(seen_by(&gaussians(&beside, 0.2_f32.ln()), &[aside]), [true, false]);
    }

    #[test]
    fn any_camera_counts_and_its_part_only() {
        let left = camera().part([0, 0], [64, 100]).expect("a part");
        let means = [[-3.0, 0.0, 0.0], [3.0, 0.0, 0.0]];
        assert_eq!(seen_by(&gaussians(&means, -7.0), &[left]), [true, false]);
        let right = camera().part([136, 0], [64, 100]).expect("a part");
        assert_eq!(seen_by(&gaussians(&means, -7.0), &[left, right]), [true, true]);
        // A unit is 100 pixels there, at any depth.
        let near = [[0.5, 0.0, 0.0], [3.0, 0.0, 0.0]];
        assert_eq!(seen_by(&gaussians(&near, -7.0), &[camera().orthographic()]), [true, false]);
        assert_eq!(seen_by(&gaussians(&[[f32::NAN; 3]], -7.0), &[left]), [true]);
    }
}
