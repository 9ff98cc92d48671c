//! Camera paths close to existing cameras.

use super::camera::{Camera, Intrinsics};
use super::orbit::{Orbit, PARALLEL, level_up, nearest_to_axes};
use super::strays::without_strays;
use glam::{DMat3, DQuat, DVec2, DVec3};
use std::f64::consts::{PI, TAU};

/// Largest angle at which cameras on a ring look at its middle, radians.
const INWARD: f64 = 60.0 / 180.0 * PI;
/// Minimum share of such cameras for an orbit or an arc.
const INWARD_SHARE: f64 = 0.8;
/// Widest gap of the ring without cameras that an orbit may cross, radians.
const WIDEST_GAP: f64 = 100.0 / 180.0 * PI;
/// Width of the smoothing kernel, in mean distances between cameras.
const SMOOTHING: f64 = 1.5;
/// Minimum width of the smoothing kernel, as a share of the way, for paths and for arcs. Photographs of a path follow each
/// other; those of an arc may come from several rounds at several heights.
const MIN_SMOOTHING: (f64, f64) = (1.0 / 40.0, 1.0 / 6.0);
/// Largest ratio of the way in the given order to the way from neighbour to neighbour.
const LONGEST_DETOUR: f64 = 2.0;

/// Largest distance between an arc's end and its outermost camera, as a share of the arc; otherwise it is the mean distance
/// between cameras. What only one camera showed is not drawn well from elsewhere.
const MAX_INSET: f64 = 1.0 / 8.0;

/// Maximum number of cameras for a motion; more are thinned evenly. Beyond some hundreds the smoothing does not depend on their
/// number, and the time to order neighbours grows with its square.
const MAX_CAMERAS: usize = 4096;

/// Movement of a camera through a scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Motion {
    /// A full circle around the point that the cameras look at.
    Orbit,
    /// The part of that circle that has cameras.
    Arc,
    /// A smooth curve along the cameras.
    Path,
}

impl Motion {
    /// Returns the motion that suits these cameras, except [`strays`](super::strays()). It is an orbit if they surround one
    /// place, an arc if they look at it from one side, else a path.
    pub fn of(cameras: &[Camera]) -> Self {
        match Ring::of(&without_strays(cameras, Camera::position)) {
            Some(ring) if ring.inward >= INWARD_SHARE && ring.span >= TAU - WIDEST_GAP => Self::Orbit,
            Some(ring) if ring.inward >= INWARD_SHARE => Self::Arc,
            _ => Self::Path,
        }
    }

    /// Returns `count` cameras of the motion, in order. `looped`: the first follows the last, so an arc runs from its middle to
    /// both ends and back; a path always runs once. Empty without cameras.
    pub fn cameras(self, seen: &[Camera], count: u32, looped: bool, intrinsics: Intrinsics) -> Vec<Camera> {
        let every = seen.len().div_ceil(MAX_CAMERAS).max(1);
        let thinned: Vec<Camera> = seen.iter().step_by(every).copied().collect();
        let thinned = without_strays(&thinned, Camera::position);
        let along = (0..count).map(|i| match (looped && self == Self::Arc, count) {
            // A film is recognised by its first frame.
            (true, _) => 0.5 + 0.5 * libm::sin(TAU * f64::from(i) / f64::from(count)),
            (false, 1) => 0.5,
            (false, _) => f64::from(i) / f64::from(count - 1),
        });
        let ring = || Ring::of(&thinned).filter(|_| self == Self::Arc);
        match (self, ring()) {
            (Self::Orbit, _) => Orbit::around(seen, count, intrinsics).map_or_else(Vec::new, |o| o.cameras()),
            (_, Some(ring)) => along.map(|share| ring.camera(share, intrinsics)).collect(),
            _ if seen.is_empty() => Vec::new(),
            _ => {
                let way = CameraPath::along(&thinned);
                along.map(|share| way.camera(share, intrinsics)).collect()
            }
        }
    }
}

/// Returns `count` cameras on a smooth curve through keys: positions on a Catmull-Rom spline, rotations by the shortest way,
/// intrinsics interpolated, without rolling shutters, and the first key's size ([`Camera::fitted_to`]). An open curve begins and ends at a key; a closed
/// one ends a step before its first key. Empty without keys.
pub fn through_keys(keys: &[Camera], count: u32, closed: bool) -> Vec<Camera> {
    let Some(first) = keys.first() else { return Vec::new() };
    let still = |key: &Camera| Camera { shutter: None, ..key.fitted_to(first.width, first.height) };
    let keys: Vec<Camera> = keys.iter().map(still).collect();
    let spans = if closed { keys.len() } else { keys.len() - 1 };
    let steps = if closed { count.max(1) } else { count.max(2) - 1 };
    let frame = |frame: u32| {
        if spans == 0 {
            return keys[0];
        }
        // Integers make a frame at a key equal to that key.
        let at = spans as u64 * u64::from(frame);
        let span = (at / u64::from(steps)).min(spans as u64 - 1);
        let t = (at - span * u64::from(steps)) as f64 / f64::from(steps);
        between(&keys, span as usize, t, closed)
    };
    (0..count).map(frame).collect()
}

/// Camera at `t` from 0 to 1 between a key and the next.
fn between(keys: &[Camera], span: usize, t: f64, closed: bool) -> Camera {
    let count = keys.len() as i64;
    let key = |offset: i64| {
        let wanted = span as i64 + offset;
        &keys[if closed { wanted.rem_euclid(count) } else { wanted.clamp(0, count - 1) } as usize]
    };
    if t == 0.0 || t == 1.0 {
        return *key(t as i64);
    }
    let p = [-1, 0, 1, 2].map(|offset| key(offset).exact_position());
    let position = 0.5
        * (2.0 * p[1]
            + (p[2] - p[0]) * t
            + (2.0 * p[0] - 5.0 * p[1] + 4.0 * p[2] - p[3]) * t * t
            + (3.0 * p[1] - p[0] - 3.0 * p[2] + p[3]) * t * t * t);
    let turned = rotation(key(0)).slerp(rotation(key(1)), t);
    let (from, to) = (key(0), key(1));
    let mix = |a: f32, b: f32| a + t as f32 * (b - a);
    let between = Camera {
        fx: mix(from.fx, to.fx),
        fy: mix(from.fy, to.fy),
        cx: mix(from.cx, to.cx),
        cy: mix(from.cy, to.cy),
        coefficients: std::array::from_fn(|index| mix(from.coefficients[index], to.coefficients[index])),
        part: None,
        ..*from
    };
    between.moved_to(position, DMat3::from_quat(turned))
}

fn rotation(camera: &Camera) -> DQuat {
    DQuat::from_mat3(&camera.camera_from_world.as_dmat3()).normalize()
}

/// Sum of values weighted by a Gaussian of their distance from a place, and the sum of the weights.
fn smoothed<T>(
    values: &[(f64, T)],
    place: f64,
    width: f64,
    zero: T,
    add: impl Fn(T, &T, f64) -> T,
) -> (T, f64) {
    let nearest = values.iter().map(|(at, _)| (at - place).abs()).fold(f64::INFINITY, f64::min);
    values.iter().fold((zero, 0.0), |(sum, weights), (at, value)| {
        // The nearest value has the weight 1, so that the weights never all vanish.
        let [distance, shortest] = [*at - place, nearest].map(|d| (d / width).powi(2));
        let weight = libm::exp(0.5 * (shortest - distance));
        (add(sum, value, weight), weights + weight)
    })
}

/// Cameras around a common point.
struct Ring {
    center: DVec3,
    /// Up, then two directions across it. Azimuths start at the first of these.
    axes: [DVec3; 3],
    /// Azimuth at the end of the widest gap, radians.
    begin: f64,
    /// Angle from there to the last camera, radians.
    span: f64,
    /// Share of the cameras that look at the centre.
    inward: f64,
    /// Per camera: azimuth from `begin`, (distance to the axis, height above the centre).
    places: Vec<(f64, [f64; 2])>,
}

impl Ring {
    /// None for fewer than three cameras, or if they do not look at one place.
    fn of(cameras: &[Camera]) -> Option<Self> {
        if cameras.len() < 3 {
            return None;
        }
        let center = nearest_to_axes(cameras, PARALLEL)?.as_dvec3();
        let up = level_up(cameras)?;
        let side = up.any_orthonormal_vector();
        let axes = [up, side, up.cross(side)];
        let inward = cameras.iter().filter(|camera| {
            let towards = center - camera.exact_position();
            towards.angle_between(camera.forward().as_dvec3()) < INWARD
        });
        let inward = inward.count() as f64 / cameras.len() as f64;
        let place = |camera: &Camera| {
            let [y, x, z] = axes.map(|axis| axis.dot(camera.exact_position() - center));
            (libm::atan2(z, x), [DVec2::new(x, z).length(), y])
        };
        let mut places: Vec<(f64, [f64; 2])> = cameras.iter().map(place).collect();
        places.sort_by(|a, b| a.0.total_cmp(&b.0));
        let (first, last) = (places.first()?.0, places.last()?.0);
        let around = (first + TAU - last, first);
        let gaps = places.windows(2).map(|pair| (pair[1].0 - pair[0].0, pair[1].0));
        let (gap, begin) = gaps.chain([around]).max_by(|a, b| a.0.total_cmp(&b.0))?;
        for (azimuth, _) in &mut places {
            *azimuth = (*azimuth - begin).rem_euclid(TAU);
        }
        Some(Self { center, axes, begin, span: TAU - gap, inward, places })
    }

    /// Camera at a share of the arc.
    fn camera(&self, share: f64, intrinsics: Intrinsics) -> Camera {
        let [up, side, front] = self.axes;
        let spacing = self.span / (self.places.len() - 1) as f64;
        let inset = spacing.min(MAX_INSET * self.span);
        let place = inset + share * (self.span - 2.0 * inset);
        let width = (SMOOTHING * spacing).max(MIN_SMOOTHING.1 * self.span).max(1e-6);
        let ([distance, height], weights) =
            smoothed(&self.places, place, width, [0.0; 2], |sum, value, weight| {
                [sum[0] + weight * value[0], sum[1] + weight * value[1]]
            });
        let (sine, cosine) = libm::sincos(self.begin + place);
        let outward = side * cosine + front * sine;
        let eye = self.center + (outward * distance + up * height) / weights;
        Camera::look_from(eye, self.center, up, intrinsics)
    }
}

struct CameraPath {
    /// Per camera: place on the way, position, rotation (with signs so that neighbours are near).
    places: Vec<(f64, (DVec3, DQuat))>,
}

impl CameraPath {
    /// Orders cameras as given, or from neighbour to neighbour if that way is much shorter.
    fn along(cameras: &[Camera]) -> Self {
        let poses: Vec<(DVec3, DQuat)> =
            cameras.iter().map(|camera| (camera.exact_position(), rotation(camera))).collect();
        let middle = poses.iter().map(|pose| pose.0).sum::<DVec3>() / poses.len() as f64;
        let spread = poses.iter().map(|pose| pose.0.distance_squared(middle)).sum::<f64>();
        let size = (spread / poses.len() as f64).sqrt().max(f64::MIN_POSITIVE);
        // A half turn counts as much as the spread of the positions.
        let step = |a: &(DVec3, DQuat), b: &(DVec3, DQuat)| {
            a.0.distance(b.0) / size + 2.0 * libm::acos(a.1.dot(b.1).abs().min(1.0)) / PI
        };
        let length = |poses: &[(DVec3, DQuat)]| poses.windows(2).map(|w| step(&w[0], &w[1])).sum::<f64>();
        let mut ordered = poses.clone();
        for next in 1..ordered.len() {
            let last = ordered[next - 1];
            let rest = ordered[next..].iter().map(|pose| step(&last, pose)).enumerate();
            let nearest = rest.min_by(|a, b| a.1.total_cmp(&b.1)).map_or(0, |(index, _)| index);
            ordered.swap(next, next + nearest);
        }
        let poses = if length(&poses) > LONGEST_DETOUR * length(&ordered) { ordered } else { poses };
        let mut places: Vec<(f64, (DVec3, DQuat))> = Vec::with_capacity(poses.len());
        for pose in poses {
            let Some(&(at, last)) = places.last() else {
                places.push((0.0, pose));
                continue;
            };
            let turned = if last.1.dot(pose.1) < 0.0 { -pose.1 } else { pose.1 };
            places.push((at + step(&last, &pose), (pose.0, turned)));
        }
        Self { places }
    }

    /// Camera at a share of the way.
    fn camera(&self, share: f64, intrinsics: Intrinsics) -> Camera {
        let end = self.places.last().map_or(0.0, |(at, _)| *at);
        let spacing = end / (self.places.len().max(2) - 1) as f64;
        let width = (SMOOTHING * spacing).max(MIN_SMOOTHING.0 * end).max(1e-6);
        let zero = (DVec3::ZERO, DQuat::from_xyzw(0.0, 0.0, 0.0, 0.0));
        let ((position, turned), weights) =
            smoothed(&self.places, share * end, width, zero, |sum, value, weight| {
                (sum.0 + weight * value.0, sum.1 + value.1 * weight)
            });
        Camera::at(position / weights, DMat3::from_quat(turned.normalize()), intrinsics)
    }
}
