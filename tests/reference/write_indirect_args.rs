//! Workgroup counts of a dispatch over a number of elements, the twin of `forward/write_indirect_args`.

/// The elements within the capacity, and whether some had no room. A number that 32 bits do not hold is `u32::MAX`: then
/// none, as their places are unknown.
pub fn clamp(needed: u32, capacity: u32) -> (u32, bool) {
    if needed == u32::MAX { (0, true) } else { (needed.min(capacity), needed > capacity) }
}

/// x, y, z for one workgroup per block: two-dimensional above the limit of an axis, with all zero for nothing.
pub fn workgroups(elements: u32, block: u32, limit_per_axis: u32) -> [u32; 3] {
    let groups = elements.div_ceil(block);
    if groups == 0 {
        return [0; 3];
    }
    let x = groups.min(limit_per_axis);
    [x, groups.div_ceil(x), 1]
}
