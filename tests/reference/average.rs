//! The mean of values over steps; the twin of `optimizer/average`.

/// The mean after `steps` values; `value` is the last.
pub fn mean(before: f64, value: f64, steps: u32) -> f64 {
    match steps {
        1 => value,
        _ => before + (value - before) / f64::from(steps),
    }
}
