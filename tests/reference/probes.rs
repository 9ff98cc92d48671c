//! Probes of a device: the twins of `arithmetic/multiply_add` and `subgroups/subgroup_probe`.

/// The sum of one invocation's chains after `steps` steps each.
pub fn multiply_add(invocation: u32, chains: u32, steps: u32, factor: f64, term: f64) -> f64 {
    let chain = |c: u32| (0..steps).fold(f64::from(invocation % 256 + c), |x, _| x * factor + term);
    (0..chains).map(chain).sum()
}

/// An invocation's position in its subgroup: the number of invocations of the subgroup, its size, the invocation's index in the
/// workgroup, and that of the subgroup's first. All subgroups are full.
pub fn subgroup_probe(invocation: u32, workgroup_size: u32, size: u32) -> [u32; 4] {
    let place = invocation % workgroup_size;
    [size, size, place, place / size * size]
}
