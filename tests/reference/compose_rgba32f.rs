//! A blended pixel over what lies behind it, the twin of `compose/compose_rgba32f`.

/// (C, 1 - T) + T behind.
pub fn compose(accumulated: [f32; 4], behind: [f64; 4]) -> [f64; 4] {
    let [r, g, b, transmittance] = accumulated.map(f64::from);
    let splats = [r, g, b, 1.0 - transmittance];
    std::array::from_fn(|k| splats[k] + transmittance * behind[k])
}
