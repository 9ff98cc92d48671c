//! The number of tiles of each Gaussian in depth order, the twin of `forward/count`.

/// `tiles[order[rank]]` for each rank.
pub fn ordered(order: &[u32], tiles: &[u32]) -> Vec<u32> {
    order.iter().map(|&visible| tiles[visible as usize]).collect()
}
