//! The twin of `compose/compose_rgba8`: same as for 32-bit floats, but clamped and rounded to 255 steps.

/// (C, 1 - T) + T behind, clamped.
pub fn compose(accumulated: [f32; 4], behind: [f64; 4]) -> [f64; 4] {
    super::compose_rgba32f::compose(accumulated, behind).map(|x| x.clamp(0.0, 1.0))
}

/// Same as [`compose`], but in linear light.
pub fn compose_linear(accumulated: [f32; 4], behind: [f64; 4], opaque: bool, exposure: f64) -> [f64; 4] {
    super::compose_rgba32f::compose_linear(accumulated, behind, opaque, exposure).map(|x| x.clamp(0.0, 1.0))
}

/// Linear light, encoded for an sRGB image, whose previous contents are decoded first.
pub fn compose_linear_in_srgb(
    accumulated: [f32; 4],
    behind: [f64; 4],
    opaque: bool,
    exposure: f64,
) -> [f64; 4] {
    use super::compose_rgba32f::{compose_linear, decode, encode};
    let [r, g, b, a] = behind;
    let behind = if opaque { behind } else { [decode(r), decode(g), decode(b), a] };
    let [r, g, b, a] = compose_linear(accumulated, behind, opaque, exposure);
    [encode(r), encode(g), encode(b), a].map(|x| x.clamp(0.0, 1.0))
}
