//! `densify/gather` against its twin.

use ashsplat::kernels::densify::gather::{Bind, Interface, Push, Spec};
use ashsplat::vk::Buffer;

use crate::common::compare::elementwise;
use crate::common::gpu::{Gpu, sizes};
use crate::common::layout::{pack, planes, room, unpack};
use crate::common::scenes::{Random, mixed_scene};
use crate::reference::gather::{child_of, long_axis_child, random_normal};
use crate::reference::types::Gaussian;

const COEFFICIENTS: usize = 9;
const SEED: u32 = 42;
const ITERATION: u32 = 700;

/// Gaussians, and the sources of the new rows.
struct Rows {
    gaussians: Vec<Gaussian>,
    sources: Vec<u32>,
}

impl Rows {
    fn random(count: usize) -> Rows {
        let mut random = Random::new(count as u64);
        let gaussians = mixed_scene(&mut random, 40, COEFFICIENTS);
        Rows { gaussians, sources: (0..count).map(|_| random.below(40) | random.below(4) << 30).collect() }
    }

    /// Source and kind of each row.
    fn each(&self) -> impl Iterator<Item = (&Gaussian, u32, u32)> {
        self.sources.iter().map(|source| {
            let gaussian = source & 0x3FFF_FFFF;
            (&self.gaussians[gaussian as usize], gaussian, source >> 30)
        })
    }

    /// Runs the kernel; `noise` has the numbers of each child and Gaussian.
    fn gathered(&self, gpu: &Gpu, spec: Spec, noise: Option<&Buffer>) -> Vec<Gaussian> {
        let kernel = gpu.kernel::<Interface>(&spec);
        let (before, after) = (self.gaussians.len(), self.sources.len());
        let (from_room, to_room) = (room(before), room(after) + 256);
        let sources = gpu.buffer("sources", &self.sources);
        let from = gpu.buffer("from", &pack(&self.gaussians, from_room));
        let words = planes(COEFFICIENTS) * to_room;
        let to = gpu.untouched::<[f32; 4]>("to", words);
        let bind = Bind { sources: &sources, from: &from, to: &to, noise: noise.unwrap_or(&sources) };
        let push = Push {
            from_first: 0,
            from_count: before as u32,
            from_chunk_gaussians: from_room as u32,
            to_first: 0,
            to_count: after as u32,
            to_chunk_gaussians: to_room as u32,
            planes: planes(COEFFICIENTS) as u32,
            noise_stride: before as u32,
            seed: SEED,
            iteration: ITERATION,
        };
        gpu.run(|recorder| {
            recorder.dispatch(&kernel, &bind, &push, after as u64 / u64::from(spec.workgroup_size) + 1)
        });
        unpack(&gpu.read::<[f32; 4]>(&to, words), to_room, after, COEFFICIENTS)
    }
}

fn spec(gpu: &Gpu) -> Spec {
    Spec { workgroup_size: gpu.workgroup(64), moments: false, explicit_noise: false, long_axis: false }
}

/// `error` bounds the error of the noise, in standard deviations.
fn compare(rows: &Rows, actual: &[Gaussian], noise: impl Fn(u32, u32) -> [f64; 3], error: f64) {
    for ((source, gaussian, kind), actual) in rows.each().zip(actual) {
        if kind < 2 {
            assert_eq!(actual, source, "row of {gaussian}");
            continue;
        }
        let expected = child_of(source, noise(gaussian, kind - 2));
        let scale = source.log_scale.iter().copied().fold(f64::NEG_INFINITY, f64::max).exp();
        elementwise("mean", &actual.mean, &expected.mean, 1e-6 + (error + 2e-6) * scale, 1e-6)
            .expect("means");
        elementwise("log-scale", &actual.log_scale, &expected.log_scale, 2e-6, 1e-6).expect("log-scales");
        let copied = |g: &Gaussian| (g.quat, g.opacity_logit, g.sh.clone());
        assert_eq!(copied(actual), copied(source), "row of {gaussian}");
    }
}

#[test]
fn gather_equals_its_twin() {
    let gpu = Gpu::new();
    for size in sizes(gpu.workgroup(64) as usize) {
        let rows = Rows::random(size);
        let actual = rows.gathered(&gpu, spec(&gpu), None);
        // Logarithm, cosine and their arguments are float32. Vulkan requires a cosine within 2^-11; the radius is at
        // most 6.
        let error = if gpu.context.device_name().contains("llvmpipe") { 2e-4 } else { 6.0 / 2048.0 };
        compare(&rows, &actual, |gaussian, child| random_normal([SEED, ITERATION, gaussian, child]), error);
    }
}

#[test]
fn gather_with_explicit_noise() {
    let gpu = Gpu::new();
    let rows = Rows::random(500);
    let mut random = Random::new(9);
    let noise: Vec<[f32; 3]> =
        (0..2 * rows.gaussians.len()).map(|_| [0; 3].map(|_| random.normal() as f32)).collect();
    let buffer = gpu.buffer("noise", &noise);
    let actual = rows.gathered(&gpu, Spec { explicit_noise: true, ..spec(&gpu) }, Some(&buffer));
    let of = |gaussian: u32, child: u32| {
        noise[child as usize * rows.gaussians.len() + gaussian as usize].map(f64::from)
    };
    compare(&rows, &actual, of, 0.0);
}

#[test]
fn gather_of_splits_along_the_long_axis() {
    let gpu = Gpu::new();
    for size in sizes(gpu.workgroup(64) as usize) {
        let mut rows = Rows::random(size);
        // Ties, needles, and opacities that round to 0 and 1.
        for (gaussian, (logit, log_scale)) in rows.gaussians.iter_mut().zip([
            (-90.0, [0.5; 3]),
            (90.0, [-1.0, 0.5, 0.5]),
            (15.0, [-7.0, -7.0, 2.0]),
            (-15.0, [2.0, -7.0, 2.0]),
        ]) {
            (gaussian.opacity_logit, gaussian.log_scale) = (logit, log_scale);
        }
        let actual = rows.gathered(&gpu, Spec { long_axis: true, ..spec(&gpu) }, None);
        for ((source, gaussian, kind), actual) in rows.each().zip(&actual) {
            if kind < 2 {
                assert_eq!(actual, source, "row of {gaussian}");
                continue;
            }
            let expected = long_axis_child(source, kind - 2);
            let largest = source.log_scale.iter().copied().fold(f64::NEG_INFINITY, f64::max).exp();
            elementwise("mean", &actual.mean, &expected.mean, 1e-6 + 4e-6 * largest, 1e-6).expect("means");
            elementwise("log-scale", &actual.log_scale, &expected.log_scale, 2e-6, 1e-6).expect("log-scales");
            // The twin's form loses digits for opacities near 1.
            let (logit, expected) = ([actual.opacity_logit], [expected.opacity_logit]);
            elementwise("logit", &logit, &expected, 3e-6, 1e-6).expect("logits");
            assert_eq!((actual.quat, &actual.sh), (source.quat, &source.sh), "row of {gaussian}");
        }
    }
}

#[test]
fn gather_of_moments() {
    let gpu = Gpu::new();
    let rows = Rows::random(500);
    let actual = rows.gathered(&gpu, Spec { moments: true, ..spec(&gpu) }, None);
    let zero = Gaussian {
        mean: [0.0; 3],
        quat: [0.0; 4],
        log_scale: [0.0; 3],
        opacity_logit: 0.0,
        sh: vec![[0.0; 3]; COEFFICIENTS],
    };
    for ((source, gaussian, kind), actual) in rows.each().zip(&actual) {
        assert_eq!(actual, if kind == 0 { source } else { &zero }, "row of {gaussian}");
    }
}

/// The generator's numbers are standard normal and independent of each other.
#[test]
fn random_numbers_are_normal() {
    let mut sum = [0.0; 3];
    let mut products = [[0.0; 3]; 3];
    let count = 100_000;
    for key in 0..count {
        let normal = random_normal([SEED, ITERATION, key / 2, key % 2]);
        for i in 0..3 {
            sum[i] += normal[i];
            for j in 0..3 {
                products[i][j] += normal[i] * normal[j];
            }
        }
    }
    for (i, row) in products.iter().enumerate() {
        assert!((sum[i] / f64::from(count)).abs() < 0.015, "mean {}", sum[i]);
        for (j, product) in row.iter().enumerate() {
            let expected = if i == j { 1.0 } else { 0.0 };
            assert!((product / f64::from(count) - expected).abs() < 0.02, "covariance {i} {j}");
        }
    }
}
