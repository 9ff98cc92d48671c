//! The list of the flagged indices, in ascending order, and its inverse: the twin of `forward/compact`.

/// Place of an index that is not in the list.
pub const NOT_LISTED: u32 = u32::MAX;

/// Returns the first `capacity` flagged indices, and the place of each index in that list or [`NOT_LISTED`].
pub fn compact(flags: &[bool], capacity: usize) -> (Vec<u32>, Vec<u32>) {
    let mut list = Vec::new();
    let mut places = Vec::new();
    for (index, &flag) in flags.iter().enumerate() {
        let listed = flag && list.len() < capacity;
        places.push(if listed { list.len() as u32 } else { NOT_LISTED });
        if listed {
            list.push(index as u32);
        }
    }
    (list, places)
}
