//! Gaussians for the tests of files, and the tolerance of each format.

use ashsplat::scene::{Camera, Gaussians, Intrinsics, PointCloud};
use ashsplat_files::initial_gaussians;
use ashsplat_files::splats::{self, Format, WriteOptions};
use glam::Vec3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::path::Path;

/// Gaussians as training produces them: within 20 units, sizes from centimetres to a metre, any shape and colour.
pub fn scene(count: usize, sh_degree: u32) -> Gaussians {
    let mut random = ChaCha8Rng::seed_from_u64(count as u64 + 1000 * u64::from(sh_degree));
    let mut between = |low: f32, high: f32| low + (high - low) * random.random::<f32>();
    let mut gaussians = Gaussians { sh_degree, ..Default::default() };
    for _ in 0..count {
        gaussians.means.push([between(-10.0, 10.0), between(-10.0, 10.0), between(-10.0, 10.0)]);
        let quat = [between(-1.0, 1.0), between(-1.0, 1.0), between(-1.0, 1.0), between(-1.0, 1.0)];
        let length = quat.iter().map(|q| q * q).sum::<f32>().sqrt();
        gaussians.quats.push(quat.map(|q| q / length));
        gaussians.log_scales.push([between(-5.0, 0.0), between(-5.0, 0.0), between(-5.0, 0.0)]);
        gaussians.opacity_logits.push(between(-4.0, 4.0));
        gaussians.sh.push([between(-1.7, 1.7), between(-1.7, 1.7), between(-1.7, 1.7)]);
        for _ in 1..(sh_degree + 1).pow(2) {
            gaussians.sh.push([between(-0.9, 0.9), between(-0.9, 0.9), between(-0.9, 0.9)]);
        }
    }
    gaussians
}

/// Largest difference between the values written and read.
#[derive(Debug)]
pub struct Tolerance {
    pub mean: f32,
    pub log_scale: f32,
    pub opacity: f32,
    /// 1 - |cos| of half the angle between the rotations.
    pub rotation: f32,
    pub color: f32,
    pub sh: f32,
}

/// Tolerance of a format: half a quantisation step, plus rounding.
pub fn tolerance(format: Format) -> Tolerance {
    let float = 1e-5;
    match format {
        Format::Ply => {
            Tolerance { mean: 0.0, log_scale: 0.0, opacity: 0.0, rotation: 1e-6, color: 0.0, sh: 0.0 }
        }
        // The chunks of a test's sparse scene are as large as the scene.
        Format::CompressedPly => Tolerance {
            mean: 20.0 / 1023.0 / 2.0 + float,
            log_scale: 5.0 / 1023.0 / 2.0 + float,
            opacity: 0.5 / 255.0 + float,
            rotation: 2e-5,
            color: 0.5 * 3.4 / 255.0 + float,
            sh: 8.0 / 256.0 / 2.0 + float,
        },
        Format::Splat => Tolerance {
            mean: 0.0,
            log_scale: float,
            opacity: 0.5 / 255.0 + float,
            rotation: 2e-4,
            // The format clamps colours to [0, 1]; the scene's lie inside.
            color: 0.5 / 255.0 / 0.282 + float,
            sh: 0.0,
        },
        Format::Spz => Tolerance {
            mean: 0.5 / 4096.0 + float,
            log_scale: 0.5 / 16.0 + float,
            opacity: 1.0 / 255.0 + float,
            rotation: 2e-5,
            color: 0.5 / 255.0 / 0.15 + float,
            sh: 8.5 / 128.0 + float,
        },
        // Few Gaussians: the palette holds all spherical harmonics.
        Format::Sog => Tolerance {
            mean: 1e-3,
            log_scale: 0.03,
            opacity: 0.5 / 255.0 + float,
            rotation: 6e-5,
            color: 0.02,
            sh: 0.05,
        },
        // Level 1; positions are within buckets of 64 units.
        Format::Ksplat => Tolerance {
            mean: 1e-3,
            log_scale: 1.1e-3,
            opacity: 0.5 / 255.0 + float,
            rotation: float,
            color: 0.5 / 255.0 / 0.282 + float,
            sh: 1.1e-3,
        },
        Format::Glb | Format::Gltf | Format::Usda => {
            Tolerance { mean: 0.0, log_scale: float, opacity: float, rotation: 1e-6, color: 0.0, sh: 0.0 }
        }
    }
}

pub fn assert_close(actual: &Gaussians, expected: &Gaussians, tolerance: &Tolerance) {
    actual.check_shapes().expect("vectors that fit together");
    assert_eq!((actual.len(), actual.sh_degree), (expected.len(), expected.sh_degree));
    let near = |what: &str, index: usize, a: &[f32], b: &[f32], by: f32| {
        for (a, b) in a.iter().zip(b) {
            assert!((a - b).abs() <= by, "{what} of {index}: {a} instead of {b}, {tolerance:?}");
        }
    };
    for index in 0..actual.len() {
        near("mean", index, &actual.means[index], &expected.means[index], tolerance.mean);
        near("log-scale", index, &actual.log_scales[index], &expected.log_scales[index], tolerance.log_scale);
        near("opacity", index, &[actual.opacity(index)], &[expected.opacity(index)], tolerance.opacity);
        let length = |q: &[f32; 4]| q.iter().map(|q| q * q).sum::<f32>().sqrt();
        let (a, b) = (actual.quats[index], expected.quats[index]);
        // A Gaussian is symmetric under half a turn about its own axes.
        let [w, x, y, z] = a;
        let alike = [a, [-x, w, z, -y], [-y, -z, w, x], [-z, y, -x, w]];
        let dot = |q: &[f32; 4]| q.iter().zip(b).map(|(a, b)| a * b).sum::<f32>().abs();
        let cosine = alike.iter().map(dot).fold(0.0, f32::max) / (length(&a) * length(&b));
        assert!(1.0 - cosine <= tolerance.rotation, "rotation of {index}: {a:?} {b:?}");
        let (a, b) = (actual.sh_of(index), expected.sh_of(index));
        near("colour", index, &a[0], &b[0], tolerance.color);
        near("higher SH", index, a[1..].as_flattened(), b[1..].as_flattened(), tolerance.sh);
    }
}

/// Reorders Gaussians of a sorted file by their nearest originals.
pub fn in_order_of(expected: &Gaussians, actual: &Gaussians) -> Gaussians {
    let mut free: Vec<usize> = (0..actual.len()).collect();
    let nearest = |mean: &[f32; 3]| {
        let distance2 = |&place: &usize| {
            actual.means[free[place]].iter().zip(mean).map(|(a, b)| (a - b) * (a - b)).sum::<f32>()
        };
        let place = (0..free.len()).min_by(|a, b| distance2(a).total_cmp(&distance2(b)));
        free.swap_remove(place.expect("as many as expected"))
    };
    let order: Vec<usize> = expected.means.iter().map(nearest).collect();
    actual.select(&order)
}

pub fn camera(turn: f32) -> Camera {
    let eye = Vec3::new(4.0 * turn.sin(), -1.0, -4.0 * turn.cos());
    Camera::look_at(eye, Vec3::ZERO, Vec3::NEG_Y, Intrinsics::from_fov_x(0.9, 96, 64))
}

pub fn ball(count: usize) -> Gaussians {
    let mut gaussians = scene(count, 1);
    gaussians.means.as_flattened_mut().iter_mut().for_each(|v| *v *= 0.12);
    gaussians.log_scales.as_flattened_mut().iter_mut().for_each(|s| *s = 0.5 * *s - 2.2);
    gaussians
}

/// Disks on a ball of radius 1 around a point, red above and blue below.
pub fn disks(center: Vec3) -> Gaussians {
    let count = 3000;
    let mut ball = Gaussians::default();
    for (index, normal) in directions(count).into_iter().enumerate() {
        let turn = glam::Quat::from_rotation_arc(Vec3::Z, normal);
        ball.means.push((center + normal).to_array());
        ball.quats.push([turn.w, turn.x, turn.y, turn.z]);
        ball.log_scales.push([-2.9, -2.9, -7.0]);
        ball.opacity_logits.push(5.0);
        ball.sh.push(if index < count / 2 { [1.7, -1.7, -1.7] } else { [-1.7, -1.7, 1.7] });
    }
    ball
}

/// Directions spread evenly, from +z to -z.
pub fn directions(count: usize) -> Vec<Vec3> {
    let direction = |index: usize| {
        let z = 1.0 - (2.0 * index as f32 + 1.0) / count as f32;
        let (sine, cosine) = (index as f32 * 2.399_963).sin_cos();
        let radius = (1.0 - z * z).sqrt();
        Vec3::new(radius * cosine, radius * sine, z)
    };
    (0..count).map(direction).collect()
}

/// Writes the first Gaussians of orange points.
pub fn write_points(path: &Path, positions: Vec<[f32; 3]>, sh_degree: u32) {
    let colors = vec![[230, 77, 26]; positions.len()];
    let gaussians = initial_gaussians(&PointCloud { positions, colors }, sh_degree).expect("Gaussians");
    splats::write(path, &gaussians, &WriteOptions::default()).expect("written");
}
