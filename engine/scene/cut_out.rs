//! Volumes that keep or remove the Gaussians inside: boxes, ellipsoids, half-spaces.

use glam::{DVec3, Vec3};

use super::gaussians::Gaussians;
use super::view::Pose;
use crate::error::{Error, Result};

/// A volume that keeps or removes the Gaussians whose means lie inside.
///
/// A Gaussian is drawn if it lies in some keep volume (when there are any) and in no remove volume, whatever their order.
/// Half-spaces that keep are united as well. To draw the intersection of several, remove the opposite half-spaces.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CutOut {
    /// Shape and size, in the volume's own axes.
    pub volume: Volume,
    /// Pose of these axes in the scene's own, before the scene's pose: a cut-out moves with its scene. [`CutOut::in_scene`]
    /// converts one that is fixed in the world.
    pub pose: Pose,
    /// Treatment of the Gaussians inside.
    pub inside: Inside,
}

/// Treatment of the Gaussians inside a [`CutOut`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Inside {
    /// Draws them, and hides the Gaussians outside unless another cut-out keeps them.
    #[default]
    Kept,
    /// Hides them.
    Removed,
}

/// Shape and size of a [`CutOut`], in its own axes. The surface is inside.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Volume {
    /// A box around the origin.
    Box {
        /// Half of the size along each axis, positive.
        half_size: Vec3,
    },
    /// An ellipsoid around the origin.
    Ellipsoid {
        /// Half of the size along each axis, positive.
        radii: Vec3,
    },
    /// The points x with normal · x ≤ offset.
    HalfSpace {
        /// Direction out of the half-space; of any length but 0.
        normal: Vec3,
        /// Offset of the plane normal · x = offset. The plane lies at offset / |normal| along the normal, so this is a distance
        /// if the normal has length 1.
        offset: f32,
    },
}

/// Maximum number of cut-outs in a scene.
pub const MAX_CUT_OUTS: usize = 16;

/// A cut-out in the form that host and device compare.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CutOutLimits {
    pub(crate) center: [f32; 3],
    /// Rows that transform a point, relative to the centre, to the axes of the cut-out. For an ellipsoid they lead to a unit
    /// ball; for a half-space the first is the normal.
    pub(crate) rows: [[f32; 3]; 3],
    /// Half sizes of a box, or offset of a half-space.
    pub(crate) bounds: [f32; 3],
    pub(crate) compared: Compared,
    pub(crate) inside: Inside,
}

/// Comparison of [`CutOutLimits`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Compared {
    Box,
    Ellipsoid,
    HalfSpace,
}

impl CutOut {
    /// Converts a cut-out with a pose in the world, for a scene in a pose.
    #[must_use]
    pub fn in_scene(&self, scene: &Pose) -> Self {
        let scene_from_world = scene.world_from_object.transpose();
        let pose = Pose {
            world_from_object: scene_from_world * self.pose.world_from_object,
            translation: scene_from_world * (self.pose.translation - scene.translation) / scene.scale,
            scale: self.pose.scale / scene.scale,
        };
        Self { pose, ..*self }
    }

    /// Refuses an invalid pose, sizes that are not positive and finite, a normal of length 0, numbers that are
    /// not finite, and a volume that is too large or too small for float32.
    pub fn check(&self) -> Result<()> {
        let bad = |problem: String| Err(Error::argument("volume", problem));
        self.pose.check()?;
        match self.volume {
            Volume::Box { half_size: size } | Volume::Ellipsoid { radii: size } => {
                if !(size.is_finite() && size.cmpgt(Vec3::ZERO).all()) {
                    return bad(format!("a size of {:?} is not positive and finite", size.to_array()));
                }
            }
            Volume::HalfSpace { normal, offset } => {
                if !(normal.is_finite() && normal.length_squared().is_normal()) {
                    return bad(format!("a normal of {:?} has no direction", normal.to_array()));
                }
                if !offset.is_finite() {
                    return bad(format!("an offset of {offset} is not finite"));
                }
            }
        }
        // A device may treat subnormal sizes as zeros.
        let usable = match self.volume {
            Volume::Box { half_size: size } | Volume::Ellipsoid { radii: size } => {
                (size * self.pose.scale).to_array().iter().all(|size| size.is_normal())
            }
            Volume::HalfSpace { .. } => true,
        };
        let CutOutLimits { rows, bounds, .. } = self.limits();
        if !(usable && rows.iter().chain([&bounds]).flatten().all(|x| x.is_finite())) {
            return bad("it is too large or too small with its pose".into());
        }
        Ok(())
    }

    /// Returns the volume in the form that kernels compare with: centre, rows, bounds.
    pub fn limits(&self) -> CutOutLimits {
        let Pose { world_from_object, translation, scale } = self.pose;
        let (axes, scale) = (world_from_object.as_dmat3(), f64::from(scale));
        let own = [axes.x_axis, axes.y_axis, axes.z_axis];
        let (rows, bounds, compared) = match self.volume {
            Volume::Box { half_size } => (own, half_size.as_dvec3() * scale, Compared::Box),
            Volume::Ellipsoid { radii } => {
                let along = |axis: usize| own[axis] / (f64::from(radii[axis]) * scale);
                ([0, 1, 2].map(along), DVec3::ONE, Compared::Ellipsoid)
            }
            Volume::HalfSpace { normal, offset } => {
                let outwards = axes * normal.as_dvec3();
                let bounds = DVec3::X * f64::from(offset) * scale;
                ([outwards, DVec3::ZERO, DVec3::ZERO], bounds, Compared::HalfSpace)
            }
        };
        CutOutLimits {
            center: translation.to_array(),
            rows: rows.map(|row| row.as_vec3().to_array()),
            bounds: bounds.as_vec3().to_array(),
            compared,
            inside: self.inside,
        }
    }
}

impl CutOutLimits {
    /// True if a point of the scene lies inside. Matches in_cut_out (glsl/include/cut_outs.glsl) to the bit, except for
    /// subnormal numbers, which a device may treat as zero: products, sums and comparisons in this order.
    pub fn contains(&self, point: [f32; 3]) -> bool {
        let Self { center, rows, bounds, compared, .. } = self;
        let from = [0, 1, 2].map(|i| point[i] - center[i]);
        let [x, y, z] = rows.map(|row| row[0] * from[0] + row[1] * from[1] + row[2] * from[2]);
        match compared {
            Compared::Box => x.abs() <= bounds[0] && y.abs() <= bounds[1] && z.abs() <= bounds[2],
            Compared::Ellipsoid => x * x + y * y + z * z <= 1.0,
            Compared::HalfSpace => x <= bounds[0],
        }
    }

    /// True if a Gaussian with this mean is drawn with these cut-outs.
    pub fn keep(cut_outs: &[Self], mean: [f32; 3]) -> bool {
        let removed = cut_outs.iter().any(|own| own.inside == Inside::Removed && own.contains(mean));
        let mut keepers = cut_outs.iter().filter(|own| own.inside == Inside::Kept).peekable();
        !removed && (keepers.peek().is_none() || keepers.any(|own| own.contains(mean)))
    }
}

impl Gaussians {
    /// Keeps the Gaussians that frames show with these cut-outs ([`SceneSettings`](crate::SceneSettings::cut_outs)), to the bit
    /// except for subnormal numbers.
    pub fn cut_out(&mut self, cut_outs: &[CutOut]) -> Result<()> {
        cut_outs.iter().try_for_each(CutOut::check)?;
        let limits: Vec<_> = cut_outs.iter().map(CutOut::limits).collect();
        self.retain(|own, index| CutOutLimits::keep(&limits, own.means[index]));
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{Mat3, Quat};

    const BOX: Volume = Volume::Box { half_size: Vec3::new(1.0, 2.0, 0.5) };

    fn at(volume: Volume, pose: Pose, inside: Inside) -> CutOut {
        CutOut { volume, pose, inside }
    }

    fn turned() -> Pose {
        let turn = Quat::from_euler(glam::EulerRot::XYZ, 0.4, -0.8, 1.9);
        let world_from_object = Mat3::from_quat(turn);
        Pose { world_from_object, translation: Vec3::new(3.0, -1.0, 0.5), scale: 2.0 }
    }

    #[test]
    fn surfaces_belong_to_their_volumes() {
        let pose = Pose { translation: Vec3::new(0.1, 0.2, 0.3), ..Pose::IDENTITY };
        let limits = at(BOX, Pose::IDENTITY, Inside::Kept).limits();
        assert!(limits.contains([1.0, -2.0, 0.5]));
        for outside in [[1.0f32.next_up(), 0.0, 0.0], [0.0, (-2.0f32).next_down(), 0.0], [0.0, 0.0, f32::NAN]]
        {
            assert!(!limits.contains(outside), "{outside:?}");
        }
        let ball = Volume::Ellipsoid { radii: Vec3::new(1.0, 2.0, 0.5) };
        let limits = at(ball, Pose::IDENTITY, Inside::Kept).limits();
        assert!(limits.contains([0.0, 2.0, 0.0]) && limits.contains([0.6, 1.6, 0.0].map(|x| x * 0.9999)));
        assert!(!limits.contains([0.6, 1.6, 0.0].map(|x| x * 1.0001)) && !limits.contains([1.0, 2.0, 0.5]));
        let below = Volume::HalfSpace { normal: Vec3::new(0.0, 0.0, 5.0), offset: 10.0 };
        let limits = at(below, pose, Inside::Kept).limits();
        assert!(limits.contains([9.0, 9.0, 2.2999]) && !limits.contains([9.0, 9.0, 2.3001]));
    }

    /// A point inside in the volume's own axes is inside in any pose, and the same holds for outside points.
    #[test]
    fn poses_move_volumes() {
        let inside = [Vec3::new(0.99, -1.99, 0.49), Vec3::new(-0.5, 0.0, 0.0)];
        let outside = [Vec3::new(1.01, 0.0, 0.0), Vec3::new(0.0, 0.0, -0.51)];
        let half_space = Volume::HalfSpace { normal: Vec3::new(1.0, 0.0, 0.0), offset: 1.0 };
        let scene = Pose { translation: Vec3::new(-4.0, 1.0, 9.0), scale: 0.25, ..turned() };
        for (volume, outside) in [(BOX, &outside[..]), (half_space, &outside[..1])] {
            let world = at(volume, turned(), Inside::Kept);
            let own = world.in_scene(&scene);
            let place = |pose: &Pose, x: Vec3| pose.scale * (pose.world_from_object * x) + pose.translation;
            for (points, expected) in [(&inside[..], true), (outside, false)] {
                for &point in points {
                    let at_world = place(&world.pose, point);
                    assert_eq!(world.limits().contains(at_world.to_array()), expected, "{volume:?} {point}");
                    let at_scene = place(&own.pose, point);
                    assert_eq!(own.limits().contains(at_scene.to_array()), expected, "{volume:?} {point}");
                    assert!((place(&scene, at_scene) - at_world).length() < 1e-5, "{point}");
                }
            }
        }
    }

    #[test]
    fn what_keeps_is_united_and_what_removes_wins() {
        let slab = |low: f32, inside| {
            let pose = Pose { translation: Vec3::X * (low + 0.5), ..Pose::IDENTITY };
            at(Volume::Box { half_size: Vec3::splat(0.5) }, pose, inside).limits()
        };
        let kept = |cut_outs: &[CutOutLimits]| -> Vec<usize> {
            (0..4).filter(|&i| CutOutLimits::keep(cut_outs, [i as f32 + 0.5, 0.0, 0.0])).collect()
        };
        let (keep, remove) = (Inside::Kept, Inside::Removed);
        assert_eq!(kept(&[]), [0, 1, 2, 3]);
        assert_eq!(kept(&[slab(1.0, remove)]), [0, 2, 3]);
        assert_eq!(kept(&[slab(1.0, keep), slab(3.0, keep)]), [1, 3]);
        assert_eq!(kept(&[slab(1.0, keep), slab(3.0, keep), slab(3.0, remove)]), [1]);
        assert_eq!(kept(&[slab(3.0, remove), slab(1.0, keep), slab(3.0, keep)]), [1]);
    }
}
