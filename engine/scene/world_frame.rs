//! The frame in which a scene is held in single precision.

use glam::{DMat3, DVec3, Vec3};

use super::camera::NEAR_PLANE;
use super::median_ball::median_ball;

/// Distance of a scene's centre from the origin, in radii of the scene, from which on it gets an origin of its own: below, single
/// precision resolves a 250,000th of the radius or finer.
const FAR: f64 = 64.0;

/// Least radius of a scene, source units, that keeps its unit: the near limit of 0.2 hides much of a smaller one.
const SMALL: f64 = 1.0;

/// Where a scene's world coordinates lie within the coordinates of the user's files, the source coordinates:
/// `source = origin + unit * world`.
///
/// World coordinates are what the engine works in, in single precision, whose steps are 0.5 at 5e6: a scene in UTM
/// coordinates needs an origin of its own, a tiny scene a unit of its own. Almost all scenes have the identity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WorldFrame {
    /// The world's origin, source coordinates.
    pub origin: DVec3,
    /// Length of a world unit, source units; positive.
    pub unit: f64,
}

impl Default for WorldFrame {
    fn default() -> Self {
        Self { origin: DVec3::ZERO, unit: 1.0 }
    }
}

impl WorldFrame {
    /// The frame for a scene of these points, source coordinates. Medians decide, so that outliers have no weight.
    ///
    /// Origin and unit are round decimal numbers. Data sets that were moved by such numbers get the world coordinates that they had.
    pub fn around(points: &[DVec3]) -> Self {
        let Some((center, radius)) = median_ball(points) else { return Self::default() };
        let unit = if radius < SMALL { 10f64.powf(radius.log10().floor()) } else { 1.0 };
        let step = 10f64.powf(radius.log10().ceil());
        let origin =
            if center.length() > FAR * radius { (center / step).round() * step } else { DVec3::ZERO };
        // Without negative zeros.
        let origin = origin + DVec3::ZERO;
        Self { origin, unit }
    }

    /// The frame for drawing Gaussians at these points. Their unit stays, unless the near limit hides them: what lies nearer to a
    /// training's cameras than its near limit was never trained.
    pub fn around_gaussians(points: &[DVec3]) -> Self {
        let is_hidden = median_ball(points).is_some_and(|(_, radius)| radius < f64::from(NEAR_PLANE));
        let around = Self::around(points);
        Self { unit: if is_hidden { around.unit } else { 1.0 }, ..around }
    }

    /// Whether world and source coordinates are the same.
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

    /// Translation from world to camera of a camera whose pose is in source coordinates. The identity keeps its bits.
    pub fn translation(&self, camera_from_source: DMat3, translation: DVec3) -> Vec3 {
        let at_origin = match self.origin == DVec3::ZERO {
            true => translation,
            false => translation + camera_from_source * self.origin,
        };
        (at_origin / self.unit).as_vec3()
    }
}
