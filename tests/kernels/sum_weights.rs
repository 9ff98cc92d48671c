//! `densify/sum_weights` against its twin.

use ashsplat::kernels::constants::{NOT_VISIBLE, STATE_OVERFLOW, STATE_WORDS};
use ashsplat::kernels::densify::sum_weights::{Bind, Interface, Push, Spec};

use crate::common::compare::elementwise;
use crate::common::gpu::{Gpu, UNTOUCHED, sizes};
use crate::common::scenes::Random;
use crate::reference::sum_weights::sum_weights;

/// Returns the kernel's weights and ranges for the instances of the visible Gaussians among `size`.
fn run(gpu: &Gpu, visible: &[(u32, Vec<f32>)], size: usize, overflow: bool) -> (Vec<f32>, Vec<u32>) {
    let spec = Spec { workgroup_size: gpu.workgroup(64), subgroup_size: gpu.subgroup(), ..Spec::default() };
    let mut index = vec![NOT_VISIBLE; size];
    let (mut footprints, mut begins, mut flat) = (vec![], vec![], vec![]);
    for (row, (gaussian, own)) in visible.iter().enumerate() {
        index[*gaussian as usize] = row as u32;
        footprints.push([0, 0, 0, own.len() as u32]);
        begins.push(flat.len() as u32);
        flat.extend(own.iter().map(|&weight| [weight, f32::NAN]));
    }
    let mut state = vec![0; STATE_WORDS as usize];
    state[STATE_OVERFLOW as usize] = u32::from(overflow);
    let (weights, ranges) = (gpu.untouched::<f32>("weights", size + 1), gpu.zeros::<u32>("ranges", 4));
    let bind = Bind {
        state: &gpu.buffer("state", &state),
        visible_index: &gpu.buffer("visible_index", &index),
        footprints: &gpu.buffer("footprints", &footprints),
        first_instances: &gpu.buffer("first_instances", &begins),
        instance_gradients_c: &gpu.buffer("instance_gradients_c", &flat),
        weights: &weights,
        ranges: &ranges,
    };
    let push = Push { count: size as u32, splat_stride: 1 };
    gpu.dispatch::<Interface>(&spec, &bind, &push, size as u64 / u64::from(spec.workgroup_size) + 1);
    let weights = gpu.read::<f32>(&weights, size + 1);
    assert_eq!(weights[size].to_bits(), UNTOUCHED);
    (weights[..size].to_vec(), gpu.read(&ranges, 4))
}

#[test]
pub fn sum_weights_equals_its_twin() {
    let gpu = Gpu::new();
    for size in sizes(gpu.workgroup(64) as usize) {
        // All visible, most, and none.
        for one_in in [1, 3, u32::MAX] {
            let mut random = Random::new(size as u64);
            let mut visible = Vec::new();
            for gaussian in (0..size as u32).filter(|i| if one_in == 3 { i % 3 > 0 } else { one_in == 1 }) {
                let instances = if gaussian % 11 == 3 { 64 + gaussian % 150 } else { gaussian % 5 };
                visible.push((gaussian, (0..instances).map(|_| random.unit() as f32).collect::<Vec<f32>>()));
            }
            let mut instances = vec![vec![]; size];
            for (gaussian, own) in &visible {
                instances[*gaussian as usize] = own.iter().copied().map(f64::from).collect();
            }
            let expected = sum_weights(&instances);
            let (weights, ranges) = run(&gpu, &visible, size, false);
            let wide: Vec<f64> = weights.iter().copied().map(f64::from).collect();
            elementwise("weights", &wide, &expected, 1e-7, 1e-6).expect("weights");
            if size > 0 {
                let low = weights.iter().copied().fold(f32::INFINITY, f32::min);
                let high = weights.iter().copied().fold(0.0, f32::max);
                assert_eq!([f32::from_bits(!ranges[2]), f32::from_bits(ranges[3])], [low, high]);
            }
        }
    }
}

#[test]
pub fn sum_weights_of_a_frame_that_overflowed_are_none() {
    let gpu = Gpu::new();
    let visible: Vec<(u32, Vec<f32>)> = (0..9).map(|i| (i, vec![1.0; 3])).collect();
    let (weights, ranges) = run(&gpu, &visible, 9, true);
    assert!(weights.iter().all(|weight| weight.to_bits() == UNTOUCHED));
    assert_eq!(ranges, [0; 4]);
}
