//! Keys that are difficult for a sort.

/// All keys equal; two keys alternating; two keys in halves.
pub fn equal_and_extreme(size: usize) -> Vec<Vec<u32>> {
    let mut lists: Vec<Vec<u32>> = [0, 0x0101_0101, u32::MAX].map(|key| vec![key; size]).into();
    lists.push((0..size).map(|i| if i % 2 == 0 { 255 } else { 0 }).collect());
    lists.push((0..size).map(|i| if i < size / 2 { 255 } else { 0 }).collect());
    lists
}
