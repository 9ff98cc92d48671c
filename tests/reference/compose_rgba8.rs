//! The twin of `compose/compose_rgba8`: as for floats of 32 bits, clamped and rounded to 255 steps.

/// (C, 1 - T) + T behind, as the image holds it.
pub fn compose(accumulated: [f32; 4], behind: [f64; 4]) -> [f64; 4] {
    super::compose_rgba32f::compose(accumulated, behind).map(|x| x.clamp(0.0, 1.0))
}
