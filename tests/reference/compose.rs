//! Pixels of hosts' images: the twins of `compose/compose_rgba32f`, `compose/compose_rgba8` (which clamps and rounds),
//! `compose/depth_limit`, `compose/expected_depth`, `compose/mean_motion` and `compose/picks`.

/// (C, 1 - T) + T behind.
pub fn compose(accumulated: [f32; 4], behind: [f64; 4]) -> [f64; 4] {
    let [r, g, b, transmittance] = accumulated.map(f64::from);
    let splats = [r, g, b, 1.0 - transmittance];
    std::array::from_fn(|k| splats[k] + transmittance * behind[k])
}

/// Linear light of a display-encoded value (IEC 61966-2-1): an odd function, above 1 with the same power.
pub fn decode(encoded: f64) -> f64 {
    let size = encoded.abs();
    let light = if size <= 0.04045 { size / 12.92 } else { ((size + 0.055) / 1.055).powf(2.4) };
    light * encoded.signum()
}

/// The inverse of [`decode`].
pub fn encode(light: f64) -> f64 {
    let size = light.abs();
    let encoded = if size <= 0.0031308 { 12.92 * size } else { 1.055 * size.powf(1.0 / 2.4) - 0.055 };
    encoded * light.signum()
}

/// Output in linear light. If the background is opaque and display-encoded as the splats are, decodes the whole
/// picture. Otherwise decodes the splats' colour and composes it over the linear background.
pub fn compose_linear(accumulated: [f32; 4], behind: [f64; 4], opaque: bool, exposure: f64) -> [f64; 4] {
    let [r, g, b, transmittance] = accumulated.map(f64::from);
    let alpha = 1.0 - transmittance;
    let covered = [r, g, b].map(|c| if alpha > 0.0 { alpha * exposure * decode(c / alpha) } else { 0.0 });
    std::array::from_fn(|k| match (k, opaque) {
        (3, _) => alpha + transmittance * behind[3],
        (_, true) => exposure * decode([r, g, b][k] + transmittance * behind[k]),
        (_, false) => covered[k] + transmittance * behind[k],
    })
}

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
