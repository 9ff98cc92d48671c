//! The list of what is flagged, in its own order, and its inverse: the twin of `forward/compact`.

/// Marks what is not in the list.
pub const NOT_LISTED: u32 = u32::MAX;

/// (list of the first `capacity` flagged indices, place of each index in the list or [`NOT_LISTED`]).
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
