//! `subgroups/subgroup_probe` against its twin.

use ashsplat::kernels::subgroups::subgroup_probe::{Bind, Interface, Push, Spec};

use crate::common::gpu::{Gpu, UNTOUCHED};
use crate::reference::subgroup_probe::subgroup_probe;

#[test]
fn subgroup_probe_equals_its_twin() {
    let gpu = Gpu::new();
    let size = gpu.subgroup();
    let workgroup_size = gpu.workgroup(4 * size);
    let kernel = gpu.kernel::<Interface>(&Spec { workgroup_size, subgroup_size: size });
    // The last workgroup has more invocations than results.
    let count = 2 * workgroup_size + size / 2;
    let found = gpu.untouched::<[u32; 4]>("found", count as usize + 1);
    gpu.run(|r| r.dispatch(&kernel, &Bind { found: &found }, &Push { count }, 3_u32.into()));
    let expected = (0..count).map(|index| subgroup_probe(index, workgroup_size, size));
    let expected: Vec<[u32; 4]> = expected.chain([[UNTOUCHED; 4]]).collect();
    assert_eq!(gpu.read::<[u32; 4]>(&found, count as usize + 1), expected);
}
