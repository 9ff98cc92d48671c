//! Frame of a scene's coordinates in single precision.

use glam::{DMat3, DVec3, Vec3};

use super::camera::NEAR_PLANE;
use super::strays::median_ball;

/// Distance of a scene's centre from the origin, in radii of the scene, from which it gets its own origin. Below it, single
/// precision resolves a 250,000th of the radius or finer.
const FAR: f64 = 64.0;

/// Minimum radius of a scene that keeps its unit, source units. The near limit of 0.2 hides much of a smaller scene.
const SMALL: f64 = 1.0;

/// Place of a scene's world coordinates within the source coordinates, which are those of the user's files: `source = origin +
/// unit * world`.
///
/// The engine works in world coordinates in single precision, which has steps of 0.5 at 5e6. So a scene in UTM coordinates
/// needs its own origin, and a tiny scene its own unit. Almost all scenes have the identity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WorldFrame {
    /// Origin of the world, source coordinates.
    pub origin: DVec3,
    /// Length of a world unit, source units; positive.
    pub unit: f64,
}

impl Default for WorldFrame {
    fn default() -> Self {
        Self { origin: DVec3::ZERO, unit: 1.0 }
    }
}

/// The number nearest to a power of ten, which `powf` misses on some systems.
fn power_of_ten(exponent: f64) -> f64 {
    format!("1e{exponent}").parse().unwrap_or(0.0)
}

impl WorldFrame {
    /// Frame for a scene of these points, source coordinates. It depends on medians, so outliers have no weight.
    ///
    /// Origin and unit are round decimal numbers. So data sets that were moved by such numbers return to their world
    /// coordinates.
    pub fn around(points: &[DVec3]) -> Self {
        let Some((center, radius)) = median_ball(points) else { return Self::default() };
        let unit = if radius < SMALL { power_of_ten(libm::log10(radius).floor()) } else { 1.0 };
        let step = power_of_ten(libm::log10(radius).ceil());
        let origin =
            if center.length() > FAR * radius { (center / step).round() * step } else { DVec3::ZERO };
        // Removes negative zeros.
        let origin = origin + DVec3::ZERO;
        Self { origin, unit }
    }

    /// Frame for drawing Gaussians at these points. Their unit stays unless the near limit hides them, because training cannot
    /// have trained Gaussians within its own near limit.
    pub fn around_gaussians(points: &[DVec3]) -> Self {
        let is_hidden = median_ball(points).is_some_and(|(_, radius)| radius < f64::from(NEAR_PLANE));
        let around = Self::around(points);
        Self { unit: if is_hidden { around.unit } else { 1.0 }, ..around }
    }

    /// True if world and source coordinates are the same.
    pub fn is_identity(&self) -> bool {
        *self == Self::default()
    }

    /// World coordinates of a point in source coordinates.
    pub fn world(&self, source: DVec3) -> Vec3 {
        ((source - self.origin) / self.unit).as_vec3()
    }

    /// Source coordinates of a point in world coordinates.
    pub fn source(&self, world: Vec3) -> DVec3 {
        self.origin + self.unit * world.as_dvec3()
    }

    /// Translation from world to camera, for a camera with a pose in source coordinates. The identity keeps its bits.
    pub fn translation(&self, camera_from_source: DMat3, translation: DVec3) -> Vec3 {
        let at_origin = match self.origin == DVec3::ZERO {
            true => translation,
            false => translation + camera_from_source * self.origin,
        };
        (at_origin / self.unit).as_vec3()
    }
}
