//! Appearance of a photograph: its exposure, and the effects of its lens on colours, vignetting and response.

use super::Camera;

/// An affine change of colours: `out[c] = Σ_k in[k] * rows[k][c] + rows[c][3]`, with colours as in photographs (sRGB, 0 to 1).
/// It is the reference implementation's exposure matrix, 3 rows of 4 numbers, whose last column is added. Nothing is clamped.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Exposure {
    /// The matrix, row by row.
    pub rows: [[f32; 4]; 3],
}

impl Default for Exposure {
    fn default() -> Self {
        Self::IDENTITY
    }
}

impl Exposure {
    /// Leaves colours unchanged.
    pub const IDENTITY: Self =
        Self { rows: [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]] };

    /// Returns the colour under this exposure.
    pub fn of(&self, color: [f32; 3]) -> [f32; 3] {
        let sum = |c: usize| (0..3).map(|k| color[k] * self.rows[k][c]).sum::<f32>() + self.rows[c][3];
        [sum(0), sum(1), sum(2)]
    }

    /// Changes the colours of a picture.
    pub fn apply(&self, picture: &mut [[f32; 3]]) {
        picture.iter_mut().for_each(|color| *color = self.of(*color));
    }
}

/// Vignetting and response of a camera, per channel. A colour `x`, as in photographs (sRGB, 0 to 1), becomes
/// `(x (1 + a₁ r² + a₂ r⁴ + a₃ r⁶))^γ`. r is the distance from the principal point in halves of the picture's diagonal. Below
/// [`LensEffects::MIN`] the response is a straight line from 0. Nothing is clamped. After PPISP (NVIDIA 2025), which has
/// these besides exposures.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LensEffects {
    /// Per channel: a₁, a₂, a₃, ln γ; all 0 without an effect.
    pub rows: [[f32; 4]; 3],
}

impl LensEffects {
    /// Limit below which the response is a straight line.
    pub const MIN: f32 = 1.0 / 1024.0;

    /// Vignetting factor of a channel at a squared distance from the principal point.
    pub fn vignetting(&self, channel: usize, r2: f32) -> f32 {
        let [a1, a2, a3, _] = self.rows[channel];
        1.0 + r2 * (a1 + r2 * (a2 + r2 * a3))
    }

    /// Exponents γ of the channels.
    pub fn response(&self) -> [f32; 3] {
        self.rows.map(|row| row[3].exp())
    }

    /// Returns the colour at a squared distance from the principal point.
    pub fn of(&self, color: [f32; 3], r2: f32) -> [f32; 3] {
        let gamma = self.response();
        [0, 1, 2].map(|c| {
            let t = color[c] * self.vignetting(c, r2);
            t * t.max(Self::MIN).powf(gamma[c] - 1.0)
        })
    }

    /// Changes the colours of a camera's picture.
    pub fn apply(&self, camera: &Camera, picture: &mut [[f32; 3]]) {
        self.apply_as_taken(camera, camera, picture);
    }

    /// Same as [`LensEffects::apply`], but for the picture of a camera at the place of `taken` with another field of view.
    /// Beyond the photograph's corners the vignetting stays constant.
    pub fn apply_as_taken(&self, taken: &Camera, camera: &Camera, picture: &mut [[f32; 3]]) {
        let plane = LensPlane::of(&taken.whole());
        let max_r2 = plane.corner();
        let scale = [taken.fx / camera.fx, taken.fy / camera.fy];
        let width = camera.width.max(1) as usize;
        let is_other = camera.projection != taken.projection || camera.coefficients != taken.coefficients;
        let other = is_other.then(|| (camera.rays(), taken.photo_lens()));
        for (index, color) in picture.iter_mut().enumerate() {
            let [px, py] = [(index % width) as f32 + 0.5, (index / width) as f32 + 0.5];
            let [x, y] = match &other {
                None => [(px - camera.cx) * scale[0], (py - camera.cy) * scale[1]],
                Some((rays, lens)) => match lens.position(rays([px, py]).as_dvec3()) {
                    Some(place) => (place - lens.center_px).as_vec2().to_array(),
                    None => [f32::MAX; 2],
                },
            };
            let r2 = (x * x + y * y) * plane.inverse_square;
            *color = self.of(*color, r2.min(max_r2));
        }
    }
}

/// Position of a camera's picture relative to its optical axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct LensPlane {
    /// Principal point, pixels, with the first pixel's centre at 0.
    pub center_px: [f32; 2],
    /// 1 / the square of half the diagonal.
    pub inverse_square: f32,
    /// Width and height, pixels.
    pub size_px: [f32; 2],
}

impl LensPlane {
    pub(crate) fn of(camera: &Camera) -> Self {
        let whole = camera.whole();
        let [width, height] = [whole.width, whole.height].map(|side| side.max(1) as f32);
        let inverse_square = 4.0 / (width * width + height * height);
        Self { center_px: [camera.cx - 0.5, camera.cy - 0.5], inverse_square, size_px: [width, height] }
    }

    /// Squared distance of the farthest corner of the picture of [`LensPlane::size_px`].
    fn corner(&self) -> f32 {
        let farthest = |axis: usize| {
            let from_edge = self.center_px[axis] + 0.5;
            from_edge.abs().max((self.size_px[axis] - from_edge).abs())
        };
        (farthest(0).powi(2) + farthest(1).powi(2)) * self.inverse_square
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Intrinsics;
    use glam::Vec3;

    #[test]
    fn rows_are_of_the_incoming_channels_and_the_last_column_is_added() {
        let rows = [[1.0, 2.0, 0.0, 0.5], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 3.0, -1.0]];
        assert_eq!(Exposure { rows }.of([0.25, 0.5, 1.0]), [0.75, 1.0, 2.0]);
        let mut picture = [[0.1, 0.2, 0.3]];
        Exposure::IDENTITY.apply(&mut picture);
        assert_eq!(picture, [[0.1, 0.2, 0.3]]);
    }

    #[test]
    fn no_effects_change_nothing() {
        let picture = [[0.1, 0.5, 0.9], [0.0, -0.2, 1.7]];
        for color in picture {
            assert_eq!(LensEffects::default().of(color, 0.7), color);
        }
    }

    #[test]
    fn corners_are_at_the_distance_one() {
        let camera = Camera::look_at(Vec3::NEG_Z, Vec3::ZERO, Vec3::NEG_Y, Intrinsics::from_fov_x(0.7, 4, 2));
        let mut effects = LensEffects::default();
        // The corner pixel's centre is half a pixel inside: 1.5² + 0.5² of 2² + 1².
        effects.rows[0] = [-1.0, 0.0, 0.0, 0.0];
        effects.rows[2] = [0.0, 0.0, 0.0, 2.0_f32.ln()];
        let mut picture = [[1.0, 1.0, 0.5]; 8];
        effects.apply(&camera, &mut picture);
        let [red, green, blue] = picture[0];
        assert!((red - 0.5).abs() < 1e-6 && green == 1.0 && (blue - 0.25).abs() < 1e-6, "{:?}", picture[0]);
        assert!((picture[1][0] - 0.9).abs() < 1e-6, "{:?}", picture[1]);
        assert_eq!(picture[7][0], picture[0][0]);
        // The same photograph at twice its size, in the middle of a picture three times as wide.
        let wide = Camera {
            width: 24,
            height: 4,
            fx: 2.0 * camera.fx,
            fy: 2.0 * camera.fy,
            cx: 12.0,
            cy: 2.0,
            ..camera
        };
        let mut picture = vec![[1.0, 1.0, 0.5]; 96];
        effects.apply_as_taken(&camera, &wide, &mut picture);
        // Half a photograph's pixel: 0.25² + 0.25² of 2² + 1².
        assert!((picture[24 + 11][0] - 0.975).abs() < 1e-6, "{:?}", picture[35]);
        assert!(picture[0][0].abs() < 1e-6, "beyond the corner: {:?}", picture[0]);
    }
}
