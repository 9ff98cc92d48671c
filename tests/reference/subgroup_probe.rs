//! What an invocation finds in its subgroup, the twin of `subgroups/subgroup_probe`.

/// Invocations of the subgroup, its size, the invocation's place in the workgroup, and that of the subgroup's first, in full
/// subgroups.
pub fn subgroup_probe(invocation: u32, workgroup_size: u32, size: u32) -> [u32; 4] {
    let place = invocation % workgroup_size;
    [size, size, place, place / size * size]
}
