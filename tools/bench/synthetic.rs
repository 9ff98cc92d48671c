//! Seeded scenes with the statistics of trained ones.
//!
//! tools/bench.md says how the numbers were chosen, with the statistics of the measured trained scenes.

use ashsplat::scene::gaussians::sh_coefficients;
use ashsplat::scene::{Camera, Gaussians, Intrinsics};
use glam::{Quat, Vec3, vec3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Half the sides of the scene, world units; y points down.
const HALF_SIDES: Vec3 = vec3(1.0, 0.35, 1.0);
/// Ellipsoids on the ground.
const OBJECTS: usize = 40;
const GROUND_SHARE: f32 = 0.3;
/// Share of the Gaussians that float anywhere, with any orientation.
const FLOATER_SHARE: f32 = 0.02;
/// Median of the largest σ · √count / mean side.
const DENSITY: f32 = 1.65;

struct Object {
    center: Vec3,
    half_axes: Vec3,
    color: Vec3,
}

/// A scene of `count` Gaussians; the same seed gives the same scene.
pub fn scene(seed: u64, count: usize, sh_degree: u32) -> Gaussians {
    let mut random = Random(ChaCha8Rng::seed_from_u64(seed));
    let objects: Vec<Object> = (0..OBJECTS).map(|_| random.object()).collect();
    // A few objects get much of the detail: Zipf's law.
    let weights: Vec<f32> = (0..OBJECTS).map(|rank| 1.0 / (rank as f32 + 2.0)).collect();
    let total: f32 = weights.iter().sum();
    let mean_side = 2.0 * (HALF_SIDES.x + HALF_SIDES.y + HALF_SIDES.z) / 3.0;
    let median_scale = DENSITY * mean_side / (count.max(1) as f32).sqrt();
    let mut scene = Gaussians::with_capacity(sh_degree, count);
    for _ in 0..count {
        let (place, normal, color) = random.place(&objects, &weights, total);
        let size = random.normal();
        let largest = median_scale.ln() + 0.7 * size;
        let middle = largest - random.gamma(2.5, 0.52);
        let smallest = middle - random.gamma(2.0, 0.8);
        let turn = random.uniform() * std::f32::consts::TAU;
        let quat = Quat::from_rotation_arc(Vec3::Z, normal) * Quat::from_rotation_z(turn);
        let logit = 2.2 + 2.2 * (-0.3 * size + (1.0f32 - 0.09).sqrt() * random.normal());
        scene.means.push(place.to_array());
        scene.quats.push([quat.w, quat.x, quat.y, quat.z]);
        scene.log_scales.push([largest, middle, smallest].map(|s| s.max(-12.0)));
        scene.opacity_logits.push(logit.min(6.7));
        scene.sh.push((color + 0.5 * random.normal3()).to_array());
        for _ in 1..sh_coefficients(sh_degree) {
            scene.sh.push((0.05 * random.normal3()).to_array());
        }
    }
    scene
}

/// A camera outside the scene, a little above, that sees nearly all of it.
pub fn camera(width: u32, height: u32) -> Camera {
    let eye = vec3(0.4, -0.9, -2.2);
    Camera::look_at(eye, vec3(0.0, 0.05, 0.0), Vec3::NEG_Y, Intrinsics::from_fov_x(0.9, width, height))
}

struct Random(ChaCha8Rng);

impl Random {
    fn uniform(&mut self) -> f32 {
        self.0.random::<f32>()
    }

    /// Standard normal (Box and Muller).
    fn normal(&mut self) -> f32 {
        let (a, b) = (self.uniform().max(1e-12), self.uniform());
        (-2.0 * a.ln()).sqrt() * (std::f32::consts::TAU * b).cos()
    }

    fn normal3(&mut self) -> Vec3 {
        vec3(self.normal(), self.normal(), self.normal())
    }

    /// Samples a gamma distribution whose shape is a multiple of 1/2: a sum of exponentials, and half a squared normal.
    fn gamma(&mut self, shape: f32, scale: f32) -> f32 {
        let whole = shape.floor();
        let mut sum: f32 = (0..whole as usize).map(|_| -self.uniform().max(1e-12).ln()).sum();
        if shape > whole {
            sum += 0.5 * self.normal().powi(2);
        }
        sum * scale
    }

    fn color(&mut self) -> Vec3 {
        0.8 * self.normal3()
    }

    fn object(&mut self) -> Object {
        let half_axes = vec3(0.08, 0.1, 0.08) + 0.14 * vec3(self.uniform(), self.uniform(), self.uniform());
        let across = |u: f32| 1.7 * (u - 0.5);
        let (x, z) = (across(self.uniform()), across(self.uniform()));
        Object { center: vec3(x, HALF_SIDES.y - 0.8 * half_axes.y, z), half_axes, color: self.color() }
    }

    /// Samples a Gaussian's position, its surface's normal and its colour.
    fn place(&mut self, objects: &[Object], weights: &[f32], total: f32) -> (Vec3, Vec3, Vec3) {
        let kind = self.uniform();
        if kind < FLOATER_SHARE {
            let within = vec3(self.uniform(), self.uniform(), self.uniform()) * 2.0 - Vec3::ONE;
            return (within * HALF_SIDES, self.direction(), self.color());
        }
        if kind < FLOATER_SHARE + GROUND_SHARE {
            let (x, z) = (2.0 * self.uniform() - 1.0, 2.0 * self.uniform() - 1.0);
            // Stripes, to give the ground some detail.
            let shade = 0.5 * (9.0 * x).sin() * (9.0 * z).sin();
            return (vec3(x, HALF_SIDES.y + 0.01 * self.normal(), z), Vec3::NEG_Y, Vec3::splat(shade));
        }
        let mut left = self.uniform() * total;
        let index = weights.iter().position(|weight| {
            left -= weight;
            left <= 0.0
        });
        let object = &objects[index.unwrap_or(0)];
        let direction = self.direction();
        let normal = (direction / object.half_axes).normalize();
        (object.center + direction * object.half_axes, normal, object.color)
    }

    fn direction(&mut self) -> Vec3 {
        self.normal3().try_normalize().unwrap_or(Vec3::Y)
    }
}

pub fn keys(seed: u64, count: usize) -> Vec<u32> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    (0..count).map(|_| random.random()).collect()
}

/// Small counts, like the tiles per Gaussian that a frame's prefix sums add up.
pub fn counts(seed: u64, count: usize) -> Vec<u32> {
    keys(seed, count).into_iter().map(|key| key % 8).collect()
}

/// A scene like one slightly earlier in training: every parameter is disturbed.
pub fn disturbed(scene: &Gaussians, seed: u64) -> Gaussians {
    let mut random = Random(ChaCha8Rng::seed_from_u64(seed ^ 0x5eed));
    let mut scene = scene.clone();
    for (mean, scales) in scene.means.iter_mut().zip(&scene.log_scales) {
        *mean = (Vec3::from(*mean) + 0.2 * scales[2].exp() * random.normal3()).to_array();
    }
    for logit in &mut scene.opacity_logits {
        *logit = 0.9 * *logit + 0.1 * random.normal();
    }
    for color in &mut scene.sh {
        *color = (Vec3::from(*color) + 0.02 * random.normal3()).to_array();
    }
    scene
}
