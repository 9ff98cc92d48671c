//! Workgroup counts of a dispatch over a number of elements, the twin of `forward/write_indirect_args`.

/// Returns the number of elements within the capacity, and true if some did not fit. `u32::MAX` means that 32 bits
/// do not hold the number: then 0, as their places are unknown.
pub fn clamp(needed: u32, capacity: u32) -> (u32, bool) {
    if needed == u32::MAX { (0, true) } else { (needed.min(capacity), needed > capacity) }
}

/// x, y, z for one workgroup per block: two-dimensional above the limit of an axis, all zero without elements.
pub fn workgroups(elements: u32, block: u32, limit_per_axis: u32) -> [u32; 3] {
    let groups = elements.div_ceil(block);
    if groups == 0 {
        return [0; 3];
    }
    let x = groups.min(limit_per_axis);
    [x, groups.div_ceil(x), 1]
}
