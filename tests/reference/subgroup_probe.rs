//! What an invocation finds in its subgroup, the twin of `subgroups/subgroup_probe`.

/// Invocations of the subgroup, its size, and the lane, of an invocation of full subgroups.
pub fn subgroup_probe(invocation: u32, size: u32) -> [u32; 3] {
    [size, size, invocation % size]
}
