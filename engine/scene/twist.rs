//! Small changes of a camera's pose.

use glam::{DMat3, DVec3};

use super::Camera;

/// Number of terms of the series. The rest is below double precision for turns of up to a circle.
const TERMS: u32 = 40;

/// Six parameters ξ = (ν, ω) that move a camera: its pose from world to camera becomes `exp(ξ^) T`.
///
/// Both are in the camera's own frame (x right, y down, z forward). `omega` turns about the camera's centre, by its length in
/// radians; `nu` is a displacement in world units (Barfoot 2017, section 7.1). The scene moves by them, and the camera the
/// other way.
///
/// # Examples
/// ```
/// use ashsplat::Camera;
/// use ashsplat::scene::{Intrinsics, Twist};
/// use glam::{DVec3, Vec3};
///
/// let intrinsics = Intrinsics::from_fov_x(0.8, 64, 48);
/// let camera = Camera::look_at(Vec3::new(0.0, 0.0, -2.0), Vec3::ZERO, Vec3::NEG_Y, intrinsics);
/// let nearer = Twist { nu: DVec3::new(0.0, 0.0, -0.5), omega: DVec3::ZERO }.applied_to(&camera);
/// assert!((nearer.position() - Vec3::new(0.0, 0.0, -1.5)).length() < 1e-6);
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Twist {
    /// Displacement of the scene, world units.
    pub nu: DVec3,
    /// Turn of the scene: axis times angle, radians.
    pub omega: DVec3,
}

impl Twist {
    /// Creates a twist from (ν, ω).
    pub fn from_array(xi: [f64; 6]) -> Self {
        let [a, b, c, d, e, f] = xi;
        Self { nu: DVec3::new(a, b, c), omega: DVec3::new(d, e, f) }
    }

    /// Returns (ν, ω).
    pub fn to_array(self) -> [f64; 6] {
        let ([a, b, c], [d, e, f]) = (self.nu.to_array(), self.omega.to_array());
        [a, b, c, d, e, f]
    }

    /// Returns the rotation and the translation of `exp(ξ^)`.
    pub fn exp(self) -> (DMat3, DVec3) {
        let Self { nu, omega } = self;
        // Each column, and the translation, is the solution of a linear equation, computed by its series.
        let turned = |start: DVec3| -> DVec3 {
            let (mut sum, mut term) = (start, start);
            for k in 1..TERMS {
                term = omega.cross(term) / f64::from(k);
                sum += term;
            }
            sum
        };
        let (mut translation, mut term) = (nu, nu);
        for k in 2..TERMS {
            term = omega.cross(term) / f64::from(k);
            translation += term;
        }
        (DMat3::from_cols(turned(DVec3::X), turned(DVec3::Y), turned(DVec3::Z)), translation)
    }

    /// Returns the camera at `exp(ξ^) T`.
    #[must_use]
    pub fn applied_to(self, camera: &Camera) -> Camera {
        let (rotation, translation) = self.exp();
        let camera_from_world = rotation * camera.camera_from_world.as_dmat3();
        let translation = rotation * camera.translation.as_dvec3() + translation;
        Camera {
            camera_from_world: camera_from_world.as_mat3(),
            translation: translation.as_vec3(),
            ..*camera
        }
    }

    /// dL/dξ from g = dL/dδ of `exp(δ^) exp(ξ^) T` at δ = 0: `J_l(ξ)ᵀ g`, with the left Jacobian of SE(3)
    /// (Barfoot 2017, section 7.1.5).
    #[must_use]
    pub fn gradient_of(self, g: Self) -> Self {
        let (mut sum, mut term) = (g, g);
        for k in 2..TERMS {
            let moved = -self.omega.cross(term.nu) / f64::from(k);
            let turned = -(self.nu.cross(term.nu) + self.omega.cross(term.omega)) / f64::from(k);
            term = Self { nu: moved, omega: turned };
            sum = Self { nu: sum.nu + moved, omega: sum.omega + turned };
        }
        sum
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TWIST: Twist = Twist { nu: DVec3::new(0.3, -0.2, 0.5), omega: DVec3::new(-0.4, 0.9, 0.2) };

    #[test]
    fn a_twist_turns_by_its_length_about_itself() {
        let (rotation, _) = TWIST.exp();
        let expected = DMat3::from_axis_angle(TWIST.omega.normalize(), TWIST.omega.length());
        assert!(rotation.abs_diff_eq(expected, 1e-14));
        // A screw does not change the part along its axis.
        let along = Twist { nu: TWIST.omega * 0.7, ..TWIST }.exp().1;
        assert!(along.abs_diff_eq(TWIST.omega * 0.7, 1e-14));
        // Half the screw, twice.
        let half = Twist { nu: TWIST.nu / 2.0, omega: TWIST.omega / 2.0 }.exp();
        let twice = (half.0 * half.0, half.0 * half.1 + half.1);
        let whole = TWIST.exp();
        assert!(twice.0.abs_diff_eq(whole.0, 1e-14) && twice.1.abs_diff_eq(whole.1, 1e-14));
        assert_eq!(Twist::from_array(TWIST.to_array()), TWIST);
    }

    /// L is a weighted sum of the elements of R and t.
    #[test]
    fn gradients_agree_with_differences() {
        let weights = |k: usize| ((7 * k + 3) % 11) as f64 - 5.0;
        let value = |(rotation, translation): (DMat3, DVec3)| -> f64 {
            let all = rotation.to_cols_array().into_iter().chain(translation.to_array());
            all.enumerate().map(|(k, x)| weights(k) * x).sum()
        };
        let step = 1e-6;
        let moved = |axis: usize, by: f64, start: Twist| {
            let mut xi = start.to_array();
            xi[axis] += by;
            Twist::from_array(xi)
        };
        let difference =
            |of: &dyn Fn(f64) -> (DMat3, DVec3)| (value(of(step)) - value(of(-step))) / (2.0 * step);
        let (rotation, translation) = TWIST.exp();
        let g = [0, 1, 2, 3, 4, 5].map(|axis| {
            difference(&|by| {
                let (r, t) = moved(axis, by, Twist::default()).exp();
                (r * rotation, r * translation + t)
            })
        });
        let gradient = TWIST.gradient_of(Twist::from_array(g)).to_array();
        for (axis, expected) in gradient.into_iter().enumerate() {
            let found = difference(&|by| moved(axis, by, TWIST).exp());
            assert!((found - expected).abs() < 1e-8, "{axis}: {found} {expected}");
        }
    }
}
