//! What a host's depth means, the twin of `compose/depth_limit`.

/// 1/z of a depth value: nothing is at the clear value, and nothing lies behind infinity. Of parallel rays z is linear, and
/// what is not in front of the camera hides everything.
pub fn depth_limit(depth: f32, (scale, offset): (f64, f64), linear: bool, clear_value: f32) -> f64 {
    let value = scale * f64::from(depth) + offset;
    match linear {
        _ if depth == clear_value => 0.0,
        false => value.max(0.0),
        true if value > 0.0 => value.recip(),
        true => f64::INFINITY,
    }
}
