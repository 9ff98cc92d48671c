//! `arithmetic/multiply_add` against its twin.

use ashsplat::kernels::arithmetic::multiply_add::{Bind, Interface, Push, Spec};
use ashsplat::kernels::constants as c;

use crate::common::compare::elementwise;
use crate::common::gpu::{Gpu, UNTOUCHED};
use crate::reference::multiply_add::multiply_add;

#[test]
fn multiply_add_equals_its_twin() {
    let gpu = Gpu::new();
    // Few enough steps that each start shows in the result.
    let spec = Spec { workgroup_size: gpu.workgroup(64), rounds: 3 };
    let kernel = gpu.kernel::<Interface>(&spec);
    let count = 300;
    let results = gpu.untouched::<f32>("results", count + 2);
    let push = Push { count: count as u32, factor: 0.75, term: 0.5 };
    let workgroups = (count as u32).div_ceil(spec.workgroup_size) + 1;
    gpu.run(|r| r.dispatch(&kernel, &Bind { results: &results }, &push, workgroups.into()));
    let steps = spec.rounds * c::MULTIPLY_ADD_STEPS;
    let twin = |i: usize| multiply_add(i as u32, c::MULTIPLY_ADD_CHAINS, steps, 0.75, 0.5);
    let expected: Vec<f64> = (0..count).map(twin).collect();
    assert!(expected[255] - expected[0] > 1.0, "starts show");
    let actual = gpu.read::<f32>(&results, count + 2);
    assert_eq!(actual[count..].iter().map(|x| x.to_bits()).collect::<Vec<_>>(), [UNTOUCHED; 2]);
    let actual: Vec<f64> = actual[..count].iter().map(|&x| x.into()).collect();
    elementwise("sums", &actual, &expected, 1e-5, 1e-5).expect("equal");
}
