//! The tiles of each Gaussian in depth order, the twin of `forward/count`.

/// `lists[order[rank]]` for each rank.
pub fn ordered<T: Copy>(order: &[u32], lists: &[T]) -> Vec<T> {
    order.iter().map(|&visible| lists[visible as usize]).collect()
}
