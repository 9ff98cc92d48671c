//! Comparators of pictures and gradients.

/// Bounds for a picture. A pixel is unstable if a decision of the blending depends on rounding.
#[derive(Clone, Copy, Debug)]
pub struct PixelTolerance {
    pub max: f64,
    pub mean: f64,
    /// Largest difference of an unstable pixel, except for [`UNSTABLE_SHARE`] of them.
    pub unstable: f64,
}

pub const UNSTABLE_SHARE: f64 = 0.01;

pub fn pixels(
    what: &str,
    actual: &[f64],
    expected: &[f64],
    unstable: &[bool],
    tolerance: PixelTolerance,
) -> Result<(), String> {
    same_length(what, actual, expected)?;
    let channels = expected.len() / unstable.len().max(1);
    let (mut max, mut sum, mut place) = (0.0_f64, 0.0, 0);
    let (mut stable_values, mut unstable_off) = (0_usize, 0_usize);
    for (pixel, &unstable) in unstable.iter().enumerate() {
        let values = pixel * channels..(pixel + 1) * channels;
        let difference = actual[values.clone()].iter().zip(&expected[values]).map(|(a, e)| (a - e).abs());
        let largest = difference.clone().fold(0.0, f64::max);
        if unstable {
            unstable_off += usize::from(largest > tolerance.unstable);
        } else {
            if largest > max {
                (max, place) = (largest, pixel);
            }
            sum += difference.sum::<f64>();
            stable_values += channels;
        }
    }
    let mean = sum / stable_values.max(1) as f64;
    let unstable_count = unstable.iter().filter(|&&unstable| unstable).count();
    let at = format!("at pixel {place}");
    let bounds = [(max, tolerance.max, at.as_str()), (mean, tolerance.mean, "on average")];
    for (measured, accepted, place) in bounds {
        if measured > accepted {
            return Err(format!("{what}: off by {measured:.3e} {place}, accepted {accepted:.1e}"));
        }
    }
    if unstable_off as f64 > UNSTABLE_SHARE * unstable_count as f64 {
        return Err(format!("{what}: {unstable_off} of {unstable_count} unstable pixels are off"));
    }
    Ok(())
}

#[derive(Clone, Copy, Debug)]
pub struct GradientTolerance {
    /// Bound for ‖actual − expected‖₂ / ‖expected‖₂.
    pub relative_l2: f64,
    /// Bound for max |actual − expected| / max |expected|.
    pub max_over_max: f64,
}

/// Compares gradients, without the Gaussians of `skip`.
pub fn gradient(
    what: &str,
    actual: &[f64],
    expected: &[f64],
    skip: &[bool],
    tolerance: GradientTolerance,
) -> Result<(), String> {
    same_length(what, actual, expected)?;
    let per_gaussian = expected.len() / skip.len().max(1);
    let kept = (0..expected.len()).filter(|i| !skip[i / per_gaussian]).map(|i| (actual[i], expected[i]));
    let (mut difference2, mut actual2, mut expected2, mut product) = (0.0, 0.0, 0.0, 0.0);
    let (mut largest_difference, mut largest_expected) = (0.0_f64, 0.0_f64);
    let (mut bias, mut total) = (0.0, 0.0);
    for (a, e) in kept {
        difference2 += (a - e) * (a - e);
        actual2 += a * a;
        expected2 += e * e;
        product += a * e;
        largest_difference = largest_difference.max((a - e).abs());
        largest_expected = largest_expected.max(e.abs());
        bias += (a - e) * if e == 0.0 { 0.0 } else { e.signum() };
        total += e.abs();
    }
    if expected2 == 0.0 {
        return match actual2 == 0.0 {
            true => Ok(()),
            false => Err(format!("{what}: not zero ({:.3e})", actual2.sqrt())),
        };
    }
    // ‖actual − expected‖₂ / ‖expected‖₂, and max |actual − expected| / max |expected|. The signed bias, Σ (actual −
    // expected)·sign(expected) / Σ |expected|, is negative if gradients shrink systematically.
    let bounds = [
        ("relative L2", (difference2 / expected2).sqrt(), tolerance.relative_l2),
        ("largest error over largest value", largest_difference / largest_expected, tolerance.max_over_max),
        ("1 - cosine", 1.0 - product / (actual2 * expected2).sqrt(), tolerance.relative_l2),
        ("signed bias", (bias / total).abs(), tolerance.relative_l2),
    ];
    for (name, measured, accepted) in bounds {
        // Written so that NaN is rejected.
        let within = measured <= accepted;
        if !within {
            return Err(format!("{what}: {name} {measured:.3e}, accepted {accepted:.1e}"));
        }
    }
    Ok(())
}

/// Compares element by element: |actual − expected| ≤ absolute + relative·|expected|.
pub fn elementwise(
    what: &str,
    actual: &[f64],
    expected: &[f64],
    absolute: f64,
    relative: f64,
) -> Result<(), String> {
    same_length(what, actual, expected)?;
    for (i, (a, e)) in actual.iter().zip(expected).enumerate() {
        let within = (a - e).abs() <= absolute + relative * e.abs();
        if !within {
            return Err(format!("{what}: element {i} is {a:.9e}, expected {e:.9e}"));
        }
    }
    Ok(())
}

/// Compares element by element with a bound relative to the largest expected value.
pub fn relative(what: &str, actual: &[f64], expected: &[f64], bound: f64) -> Result<(), String> {
    let largest = expected.iter().fold(0.0_f64, |max, x| max.max(x.abs()));
    elementwise(what, actual, expected, bound * largest, 0.0)
}

pub fn equal<T: PartialEq + std::fmt::Debug>(what: &str, actual: &[T], expected: &[T]) -> Result<(), String> {
    if actual.len() != expected.len() {
        return Err(format!("{what}: {} elements, expected {}", actual.len(), expected.len()));
    }
    match actual.iter().zip(expected).position(|(a, e)| a != e) {
        Some(i) => Err(format!("{what}: element {i} is {:?}, expected {:?}", actual[i], expected[i])),
        None => Ok(()),
    }
}

fn same_length(what: &str, actual: &[f64], expected: &[f64]) -> Result<(), String> {
    if actual.len() != expected.len() {
        return Err(format!("{what}: {} values, expected {}", actual.len(), expected.len()));
    }
    match actual.iter().position(|x| !x.is_finite()) {
        Some(i) => Err(format!("{what}: value {i} is {}", actual[i])),
        None => Ok(()),
    }
}
