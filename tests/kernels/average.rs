//! `optimizer/average` against its twin.

use ashsplat::kernels::constants::{STATE_OVERFLOW, STATE_WORDS};
use ashsplat::kernels::optimizer::average::{Bind, Interface, Push, Spec};

use crate::common::compare::elementwise;
use crate::common::gpu::{Gpu, sizes};
use crate::common::scenes::Random;
use crate::reference::average::mean;

/// Texels in front, which must stay; a multiple of the devices' alignment of bindings.
const FIRST: usize = 16;

/// Returns values and means after a step; `flags` has `ends` and the frame's overflow.
fn after(gpu: &Gpu, [values, means]: [&[[f32; 4]]; 2], weight: f32, flags: [u32; 2]) -> [Vec<[f32; 4]>; 2] {
    let spec = Spec { workgroup_size: gpu.workgroup(64) };
    let kernel = gpu.kernel::<Interface>(&spec);
    let [ends, overflow] = flags;
    let mut state = vec![0_u32; STATE_WORDS as usize];
    state[STATE_OVERFLOW as usize] = overflow;
    let (all, count) = (values.len(), (values.len() - FIRST - 1) as u32);
    let (state, values) = (gpu.buffer("state", &state), gpu.buffer("values", values));
    let means = gpu.buffer("means", means);
    let [some_values, some_means] =
        [&values, &means].map(|buffer| buffer.range(16 * FIRST as u64, 16 * u64::from(count) + 16));
    let bind = Bind { values: &some_values, means: &some_means, state: &state };
    let push = Push { count, weight, ends };
    gpu.run(|r| r.dispatch(&kernel, &bind, &push, u64::from(count / spec.workgroup_size) + 1));
    [&values, &means].map(|buffer| gpu.read(buffer, all))
}

/// One vec4 behind the averaged ones must stay, too.
fn random(size: usize, seed: u64) -> Vec<[f32; 4]> {
    let mut random = Random::new(seed);
    (0..size + FIRST + 1).map(|_| [0; 4].map(|_| 3.0 * random.signed() as f32)).collect()
}

#[test]
fn average_equals_its_twin() {
    let gpu = Gpu::new();
    for size in sizes(gpu.workgroup(64) as usize) {
        let mut means = random(size, 99);
        // The first mean ignores previous values.
        means[FIRST..].fill([f32::NAN; 4]);
        means[FIRST + size] = [7.0; 4];
        let mut expected: Vec<[f64; 4]> = means.iter().map(|texel| texel.map(f64::from)).collect();
        let steps = if size > 300 { 3 } else { 40 };
        for step in 1..=steps {
            let values = random(size, u64::from(step));
            let [same, new] = after(&gpu, [&values, &means], 1.0 / step as f32, [0, 0]);
            assert_eq!(same, values);
            means = new;
            for (texel, value) in expected.iter_mut().zip(&values).skip(FIRST).take(size) {
                *texel = [0, 1, 2, 3].map(|i| mean(texel[i], value[i].into(), step));
            }
            let got: Vec<f64> = means.as_flattened().iter().map(|&x| x.into()).collect();
            elementwise("means", &got, expected.as_flattened(), 1e-5, 1e-5)
                .unwrap_or_else(|e| panic!("{size}, step {step}: {e}"));
        }
    }
}

#[test]
fn average_ends_in_the_place_of_the_values() {
    let gpu = Gpu::new();
    let (values, means) = (random(300, 1), random(300, 2));
    let [new, same] = after(&gpu, [&values, &means], 0.0, [1, 0]);
    assert_eq!(same, means);
    assert_eq!((&new[..FIRST], &new[FIRST + 300..]), (&values[..FIRST], &values[FIRST + 300..]));
    assert_eq!(new[FIRST..FIRST + 300], means[FIRST..FIRST + 300]);
}

#[test]
fn average_leaves_overflowed_frames_alone() {
    let gpu = Gpu::new();
    let (values, means) = (random(300, 1), random(300, 2));
    for ends in [0, 1] {
        assert_eq!(after(&gpu, [&values, &means], 0.5, [ends, 1]), [values.clone(), means.clone()]);
    }
}
