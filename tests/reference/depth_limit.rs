//! Meaning of a host's depth, the twin of `compose/depth_limit`.

/// 1/z of a depth value. The clear value and infinity give 0, which hides nothing. With `linear` (parallel rays),
/// depth is linear in z. A z behind the camera hides everything.
pub fn depth_limit(depth: f32, (scale, offset): (f64, f64), linear: bool, clear_value: f32) -> f64 {
    let value = scale * f64::from(depth) + offset;
    match linear {
        _ if depth == clear_value => 0.0,
        false => value.max(0.0),
        true if value > 0.0 => value.recip(),
        true => f64::INFINITY,
    }
}
