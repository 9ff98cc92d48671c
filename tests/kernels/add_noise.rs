//! `optimizer/add_noise` against its twin.

use ashsplat::kernels::constants::{STATE_OVERFLOW, STATE_WORDS};
use ashsplat::kernels::optimizer::add_noise::{Bind, Interface, Push, Spec};

use crate::common::compare::elementwise;
use crate::common::gpu::{Gpu, sizes};
use crate::common::layout::{pack, planes, room, unpack};
use crate::common::scenes::{Random, mixed_scene};
use crate::reference::add_noise::noise;
use crate::reference::gather::random_normal;
use crate::reference::types::Gaussian;

const FIRST: u32 = 9;
const STREAM: u32 = 4;

fn moved(gpu: &Gpu, gaussians: &[Gaussian], normals: Option<&[[f32; 3]]>, overflow: u32) -> Vec<Gaussian> {
    let spec = Spec { workgroup_size: gpu.workgroup(64), explicit_noise: normals.is_some() };
    let kernel = gpu.kernel::<Interface>(&spec);
    let (count, room) = (gaussians.len(), room(gaussians.len()));
    let parameters = gpu.buffer("parameters", &pack(gaussians, room));
    let mut state = vec![0_u32; STATE_WORDS as usize];
    state[STATE_OVERFLOW as usize] = overflow;
    let state = gpu.buffer("state", &state);
    let normals = gpu.buffer("noise", normals.unwrap_or(&[[0.0; 3]; 2]));
    let bind = Bind { parameters: &parameters, state: &state, noise: &normals };
    let push = Push { first: FIRST, count: count as u32, seed: 7, iteration: 11, rate: 3.0 };
    gpu.run(|r| r.dispatch(&kernel, &bind, &push, count as u64 / u64::from(spec.workgroup_size) + 1));
    unpack(&gpu.read::<[f32; 4]>(&parameters, planes(4) * room), room, count, 4)
}

/// Opacities that let the noise through, and opacities that block it.
fn scene(size: usize) -> Vec<Gaussian> {
    let mut gaussians = mixed_scene(&mut Random::new(size as u64), size, 4);
    for (i, gaussian) in gaussians.iter_mut().enumerate() {
        gaussian.opacity_logit = [-12.0, -5.25, -4.0, -3.0, 0.0, 80.0][i % 6];
    }
    gaussians
}

/// `error` bounds the error of the normal numbers.
fn compare(before: &[Gaussian], after: &[Gaussian], normal: impl Fn(usize) -> [f64; 3], error: f64) {
    for (i, (before, after)) in before.iter().zip(after).enumerate() {
        let delta = noise(before, normal(i), 3.0);
        let expected = [0, 1, 2].map(|axis| before.mean[axis] + delta[axis]);
        let largest = delta.iter().fold(0.0, |most: f64, x| most.max(x.abs()));
        let bound =
            (1e-5 + error) * largest + 1e-6 * (1.0 + before.mean.iter().map(|x| x.abs()).sum::<f64>());
        elementwise("mean", &after.mean, &expected, bound, 1e-6).unwrap_or_else(|e| panic!("{i}: {e}"));
        let rest = |g: &Gaussian| Gaussian { mean: [0.0; 3], ..g.clone() };
        assert_eq!(rest(after), rest(before), "{i}");
    }
}

#[test]
fn add_noise_equals_its_twin() {
    let gpu = Gpu::new();
    for size in sizes(gpu.workgroup(64) as usize) {
        let gaussians = scene(size);
        let after = moved(&gpu, &gaussians, None, 0);
        compare(&gaussians, &after, |i| random_normal([7, 11, FIRST + i as u32, STREAM]), 1e-2);
    }
}

#[test]
fn add_noise_of_explicit_numbers() {
    let gpu = Gpu::new();
    let gaussians = scene(300);
    let mut random = Random::new(3);
    let normals: Vec<[f32; 3]> = (0..400).map(|_| [0; 3].map(|_| random.normal() as f32)).collect();
    let after = moved(&gpu, &gaussians, Some(&normals), 0);
    compare(&gaussians, &after, |i| normals[FIRST as usize + i].map(f64::from), 0.0);
}

#[test]
fn add_noise_leaves_overflowed_frames_alone() {
    let gpu = Gpu::new();
    let gaussians = scene(300);
    assert_eq!(moved(&gpu, &gaussians, None, 1), gaussians);
}
