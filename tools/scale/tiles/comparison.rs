//! Difference between the pictures of a tile and of its finer tiles.

use ashsplat::scene::{Camera, Gaussians, Intrinsics};
use ashsplat::{Frame, RenderSettings, Renderer, Result};
use glam::{Vec3, vec3};

/// Side of the pictures, pixels.
const SIDE: u32 = 256;
/// Directions of view: four corners of a cube, which see every side.
const DIRECTIONS: [Vec3; 4] =
    [vec3(1.0, 1.0, 1.0), vec3(1.0, -1.0, -1.0), vec3(-1.0, 1.0, -1.0), vec3(-1.0, -1.0, 1.0)];
/// Distance of the camera, in radii of the tile.
const DISTANCE: f32 = 4.0;
/// On each axis, the outermost centres are strays at both ends: one in this many. Pictures need not show them.
const STRAYS: usize = 50;

/// Largest radius of a ball: single precision ends soon after.
const MAX_RADIUS: f32 = 1e37;

pub struct TileComparison {
    renderer: Renderer,
    settings: RenderSettings,
}

impl TileComparison {
    /// Compares tiles of a scene that is drawn with these settings, but always on black.
    pub fn new(renderer: Renderer, settings: RenderSettings) -> TileComparison {
        TileComparison { renderer, settings: RenderSettings { background: [0.0; 3], ..settings } }
    }

    /// Difference of two tiles' pictures, world units: the root of the squared difference (mean of the channels, 0 to 1),
    /// integrated over the plane through the tile's middle. Over four directions it is the root mean square.
    pub fn difference(&mut self, finer: &Gaussians, merged: &Gaussians) -> Result<f64> {
        let (centre, radius) = ball(finer);
        // Scaled to size 1, so that even a tiny tile lies beyond the near plane.
        let cameras = DIRECTIONS.map(|direction| camera(Vec3::ZERO, 1.0, direction));
        let [finer, merged] = [finer, merged].map(|own| of_size_1(own, centre, radius));
        let [a, b] = [self.pictures(&finer, &cameras)?, self.pictures(&merged, &cameras)?];
        let of_frames = |(a, b): (&Frame, &Frame)| squared_difference(&a.color, &b.color);
        let sum: f64 = a.iter().zip(&b).map(of_frames).sum();
        let pixel = 2.0 * f64::from(radius) / f64::from(SIDE);
        Ok(pixel * (sum / cameras.len() as f64).sqrt())
    }

    fn pictures(&mut self, gaussians: &Gaussians, cameras: &[Camera]) -> Result<Vec<Frame>> {
        self.renderer.upload(gaussians)?;
        cameras.iter().map(|camera| self.renderer.render(camera, &self.settings)).collect()
    }
}

/// The Gaussians scaled so that their ball has radius 1 around 0.
fn of_size_1(gaussians: &Gaussians, centre: Vec3, radius: f32) -> Gaussians {
    let mut own = gaussians.clone();
    own.means.iter_mut().for_each(|mean| *mean = ((Vec3::from_array(*mean) - centre) / radius).to_array());
    own.log_scales.as_flattened_mut().iter_mut().for_each(|scale| *scale -= radius.ln());
    own
}

/// Squared difference summed over pixels, as the mean of the channels.
fn squared_difference(a: &[[f32; 3]], b: &[[f32; 3]]) -> f64 {
    let channels = a.as_flattened().iter().zip(b.as_flattened());
    channels.map(|(a, b)| f64::from(a.clamp(0.0, 1.0) - b.clamp(0.0, 1.0)).powi(2)).sum::<f64>() / 3.0
}

/// The ball around the centres, without strays.
fn ball(gaussians: &Gaussians) -> (Vec3, f32) {
    let ends = [0, 1, 2].map(|axis| {
        let mut places: Vec<f32> = gaussians.means.iter().map(|mean| mean[axis]).collect();
        places.sort_unstable_by(f32::total_cmp);
        let out = places.len() / STRAYS;
        [places[out], places[places.len() - 1 - out]]
    });
    let [min, max] = [0, 1].map(|end| Vec3::from_array(ends.map(|ends| ends[end])));
    let centre = 0.5 * (min + max);
    // If all centres nearly coincide, the median size of the Gaussians counts.
    let largest = |scales: &[f32; 3]| scales.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    let mut sizes: Vec<f32> = gaussians.log_scales.iter().map(largest).collect();
    sizes.sort_unstable_by(f32::total_cmp);
    let own = sizes[sizes.len() / 2].exp();
    let reach = 0.5 * min.as_dvec3().distance(max.as_dvec3()) as f32;
    (centre, reach.max(own).clamp(f32::MIN_POSITIVE, MAX_RADIUS))
}

/// A camera that sees the ball around a tile; its diameter is the side of the picture.
fn camera(centre: Vec3, radius: f32, direction: Vec3) -> Camera {
    let eye = centre + DISTANCE * radius * direction.normalize();
    let fov = 2.0 * (1.0 / DISTANCE).atan();
    Camera::look_at(eye, centre, Vec3::NEG_Y, Intrinsics::from_fov_x(fov, SIDE, SIDE))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn strays_do_not_make_the_ball() {
        let mut gaussians = Gaussians::with_capacity(0, 101);
        gaussians.means = (0..100).map(|i| [i as f32 / 99.0, 0.0, 0.0]).chain([[1e6, 0.0, 0.0]]).collect();
        gaussians.log_scales = vec![[-5.0; 3]; 101];
        let (centre, radius) = ball(&gaussians);
        assert!((centre.x - 0.5).abs() < 0.02 && (0.45..0.5).contains(&radius), "{centre} {radius}");
        // A large Gaussian does not change the ball either.
        gaussians.log_scales[5] = [8.0; 3];
        assert_eq!(ball(&gaussians), (centre, radius));
        gaussians.means = vec![[3.0, 2.0, 1.0]; 101];
        assert_eq!(ball(&gaussians), (vec3(3.0, 2.0, 1.0), (-5.0_f32).exp()));
        let camera = camera(Vec3::ZERO, 2.0, DIRECTIONS[1]);
        let across = DIRECTIONS[1].normalize().any_orthonormal_vector() * 2.0;
        let (x, y, z) = camera.project(across);
        let off = (x - 128.0).hypot(y - 128.0);
        assert!((off - 128.0).abs() < 0.1 && (z - 8.0).abs() < 1e-4, "{off} {z}");
    }
}
