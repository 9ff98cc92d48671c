//! A blended pixel over a background, the twin of `compose/compose_rgba32f`.

/// (C, 1 - T) + T behind.
pub fn compose(accumulated: [f32; 4], behind: [f64; 4]) -> [f64; 4] {
    let [r, g, b, transmittance] = accumulated.map(f64::from);
    let splats = [r, g, b, 1.0 - transmittance];
    std::array::from_fn(|k| splats[k] + transmittance * behind[k])
}

/// Linear light of a display-encoded value (IEC 61966-2-1), oddly below 0 and by the same power above 1.
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
