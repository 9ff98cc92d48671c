//! Keys that are hard on a sort.

/// All equal, two keys in turns, and in halves.
pub fn equal_and_extreme(size: usize) -> Vec<Vec<u32>> {
    let mut lists: Vec<Vec<u32>> = [0, 0x0101_0101, u32::MAX].map(|key| vec![key; size]).into();
    lists.push((0..size).map(|i| if i % 2 == 0 { 255 } else { 0 }).collect());
    lists.push((0..size).map(|i| if i < size / 2 { 255 } else { 0 }).collect());
    lists
}
