//! The mean of values over steps; the twin of `optimizer/average`.

/// The mean after so many steps, of which `value` is the last, from 1.
pub fn mean(before: f64, value: f64, steps: u32) -> f64 {
    match steps {
        1 => value,
        _ => before + (value - before) / f64::from(steps),
    }
}
