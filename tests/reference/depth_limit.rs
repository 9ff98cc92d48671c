//! What a host's depth means, the twin of `compose/depth_limit`.

/// 1/z of a depth value: nothing is at the clear value, and nothing lies behind infinity.
pub fn depth_limit(depth: f32, scale: f64, offset: f64, clear_value: f32) -> f64 {
    if depth == clear_value { 0.0 } else { (scale * f64::from(depth) + offset).max(0.0) }
}
