//! An invocation's position in its subgroup, the twin of `subgroups/subgroup_probe`.

/// Returns the number of invocations of the subgroup, its size, the invocation's index in the workgroup, and that of
/// the subgroup's first. All subgroups are full.
pub fn subgroup_probe(invocation: u32, workgroup_size: u32, size: u32) -> [u32; 4] {
    let place = invocation % workgroup_size;
    [size, size, place, place / size * size]
}
