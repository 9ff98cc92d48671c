//! Keys of a draw without replacement: the twin of `densify/draw_keys`.

use super::gather::pcg4d;

/// The generator's number for a Gaussian, within (0, 1).
pub fn uniform([seed, iteration]: [u32; 2], gaussian: u32) -> f64 {
    (f64::from(pcg4d([seed, iteration, gaussian, 5])[0] >> 9) + 0.5) / f64::from(1 << 23)
}

/// -ln(u) / chance; None if the chance is 0.
pub fn key(chance: f64, u: f64) -> Option<f64> {
    (chance > 0.0).then(|| -u.ln() / chance)
}
