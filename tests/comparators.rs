//! Every comparator accepts correct values and rejects wrong ones.

use crate::common::compare::{GradientTolerance, PixelTolerance, elementwise, equal, gradient, pixels};

const PIXELS: PixelTolerance = PixelTolerance { max: 5e-5, mean: 1e-6, unstable: 2e-2 };
const GRADIENT: GradientTolerance = GradientTolerance { relative_l2: 1e-4, max_over_max: 2e-4 };

/// Values without a pattern, in (-1, 1), identical in every run.
fn noise(count: usize) -> Vec<f64> {
    (0..count).map(|i| ((i as f64 * 12.9898).sin() * 43_758.545_3).fract()).collect()
}

/// A picture of 20×10, the pixels 3 and 7 unstable.
fn picture() -> (Vec<f64>, Vec<bool>) {
    let mut unstable = vec![false; 200];
    (unstable[3], unstable[7]) = (true, true);
    (noise(600), unstable)
}

fn accepts_picture(mutate: impl Fn(&mut Vec<f64>)) -> bool {
    let (expected, unstable) = picture();
    let mut actual = expected.clone();
    mutate(&mut actual);
    pixels("picture", &actual, &expected, &unstable, PIXELS).is_ok()
}

#[test]
fn picture_within_the_bounds_is_accepted() {
    assert!(accepts_picture(|_| ()));
    assert!(accepts_picture(|p| p[33] += 4e-5));
    assert!(accepts_picture(|p| p[3 * 3] += 1e-2), "an unstable pixel may be off a little");
}

#[test]
fn picture_out_of_the_bounds_is_rejected() {
    assert!(!accepts_picture(|p| p[33] += 1e-3), "one value");
    assert!(!accepts_picture(|p| p[33] -= 6e-5), "one value, a little");
    assert!(!accepts_picture(|p| p.iter_mut().for_each(|x| *x += 2e-6)), "everywhere a little");
    assert!(!accepts_picture(|p| p[33] = f64::NAN), "NaN");
    assert!(!accepts_picture(|p| p[3 * 3] = f64::NAN), "NaN at an unstable pixel");
    assert!(!accepts_picture(|p| p[3 * 3] += 3e-2), "an unstable pixel, far off");
    assert!(!accepts_picture(|p| p.swap(33, 36)), "two pixels swapped");
    assert!(!accepts_picture(|p| p.rotate_left(3)), "shifted by one pixel");
    assert!(!accepts_picture(|p| p.truncate(597)), "too short");
}

fn accepts_gradient(mutate: impl Fn(&mut Vec<f64>)) -> bool {
    let expected = noise(300);
    let mut skip = vec![false; 100];
    skip[5] = true;
    let mut actual = expected.clone();
    mutate(&mut actual);
    gradient("gradient", &actual, &expected, &skip, GRADIENT).is_ok()
}

#[test]
fn gradient_within_the_bounds_is_accepted() {
    assert!(accepts_gradient(|_| ()));
    assert!(accepts_gradient(|g| g.iter_mut().for_each(|x| *x *= 1.00005)));
    assert!(accepts_gradient(|g| g[15] = 3.0), "a Gaussian that is left out");
}

#[test]
fn gradient_out_of_the_bounds_is_rejected() {
    assert!(!accepts_gradient(|g| g.iter_mut().for_each(|x| *x *= 1.001)), "scaled");
    assert!(!accepts_gradient(|g| g.iter_mut().for_each(|x| *x = -*x)), "all signs");
    assert!(!accepts_gradient(|g| g[33] = -g[33]), "one sign");
    assert!(!accepts_gradient(|g| (0..3).for_each(|i| g.swap(30 + i, 60 + i))), "two Gaussians swapped");
    assert!(!accepts_gradient(|g| g[33] = 0.0), "one value lost");
    assert!(!accepts_gradient(|g| g.fill(0.0)), "all lost");
    assert!(!accepts_gradient(|g| g[33] = f64::NAN), "NaN");
    assert!(!accepts_gradient(|g| g[15] = f64::INFINITY), "infinite where left out");
    assert!(!accepts_gradient(|g| g.truncate(297)), "too short");
}

#[test]
fn zero_gradient_must_be_zero() {
    assert!(gradient("zero", &[0.0; 3], &[0.0; 3], &[false], GRADIENT).is_ok());
    assert!(gradient("zero", &[0.0, 1e-30, 0.0], &[0.0; 3], &[false], GRADIENT).is_err());
}

#[test]
fn gradient_bias_is_rejected() {
    // Small enough per element for the other bounds, but all in one direction.
    let expected = noise(3000);
    let loose = GradientTolerance { relative_l2: 1e-4, max_over_max: 1.0 };
    let actual: Vec<f64> = expected.iter().map(|x| x + 2e-4 * x.signum()).collect();
    assert!(gradient("bias", &actual, &expected, &[false; 1000], loose).is_err());
}

#[test]
fn elementwise_rejects() {
    let expected = noise(50);
    let check = |mutate: &dyn Fn(&mut Vec<f64>)| {
        let mut actual = expected.clone();
        mutate(&mut actual);
        elementwise("values", &actual, &expected, 1e-6, 1e-6).is_ok()
    };
    assert!(check(&|_| ()));
    assert!(check(&|v| v[7] += 1e-6));
    assert!(!check(&|v| v[7] += 1e-5));
    assert!(!check(&|v| v[7] = f64::NAN));
    assert!(!check(&|v| v.swap(7, 8)));
    assert!(!check(&|v| {
        v.pop();
    }));
}

#[test]
fn equality_rejects() {
    assert!(equal("integers", &[1, 2, 3], &[1, 2, 3]).is_ok());
    assert!(equal("integers", &[1, 2, 4], &[1, 2, 3]).is_err());
    assert!(equal("integers", &[1, 2], &[1, 2, 3]).is_err());
    assert!(equal("integers", &[2, 1, 3], &[1, 2, 3]).is_err());
}
