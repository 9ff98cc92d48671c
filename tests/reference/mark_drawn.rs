//! The Gaussians with the smallest keys: the twin of `densify/mark_drawn`.

/// Returns 1 for the `wanted` smallest keys; among equal keys the first win.
pub fn mark(keys: &[Option<f64>], wanted: usize) -> Vec<u32> {
    let mut order: Vec<usize> = (0..keys.len()).filter(|&i| keys[i].is_some()).collect();
    order.sort_by(|&a, &b| keys[a].partial_cmp(&keys[b]).expect("no NaN"));
    let mut selected = vec![0; keys.len()];
    order.into_iter().take(wanted).for_each(|i| selected[i] = 1);
    selected
}
