//! Kernels that probe a device, against their twins: `arithmetic/multiply_add` and `subgroups/subgroup_probe`.

use crate::common::compare::elementwise;
use crate::common::gpu::{Gpu, UNTOUCHED};
use crate::reference::probes as twin;
use ashsplat::kernels::arithmetic::multiply_add;
use ashsplat::kernels::constants as c;
use ashsplat::kernels::subgroups::subgroup_probe;

#[test]
fn multiply_add_equals_its_twin() {
    let gpu = Gpu::new();
    // Few enough steps that each start shows in the result.
    let spec = multiply_add::Spec { workgroup_size: gpu.workgroup(64), rounds: 3 };
    let count = 300;
    let results = gpu.untouched::<f32>("results", count + 2);
    let push = multiply_add::Push { count: count as u32, factor: 0.75, term: 0.5 };
    let bind = multiply_add::Bind { results: &results };
    gpu.dispatch_over::<multiply_add::Interface>(&spec, &bind, &push, count);
    let steps = spec.rounds * c::MULTIPLY_ADD_STEPS;
    let sum = |i: usize| twin::multiply_add(i as u32, c::MULTIPLY_ADD_CHAINS, steps, 0.75, 0.5);
    let expected: Vec<f64> = (0..count).map(sum).collect();
    assert!(expected[255] - expected[0] > 1.0, "starts show");
    elementwise("sums", &gpu.read_f64::<f32>(&results, count), &expected, 1e-5, 1e-5).expect("equal");
    assert_eq!(gpu.read::<u32>(&results, count + 2)[count..], [UNTOUCHED; 2]);
}

#[test]
fn subgroup_probe_equals_its_twin() {
    let gpu = Gpu::new();
    let size = gpu.subgroup();
    let workgroup_size = gpu.workgroup(4 * size);
    let spec = subgroup_probe::Spec { workgroup_size, subgroup_size: size };
    // The last workgroup has more invocations than results.
    let count = 2 * workgroup_size + size / 2;
    let found = gpu.untouched::<[u32; 4]>("found", count as usize + 1);
    let bind = subgroup_probe::Bind { found: &found };
    gpu.dispatch::<subgroup_probe::Interface>(&spec, &bind, &subgroup_probe::Push { count }, 3);
    let expected = (0..count).map(|index| twin::subgroup_probe(index, workgroup_size, size));
    gpu.assert_values(&found, &expected.collect::<Vec<[u32; 4]>>(), "subgroups");
}
