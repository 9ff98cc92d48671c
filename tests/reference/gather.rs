//! New Gaussians of a densification, and their random numbers: the twin of `densify/gather`.

use super::linear::{apply, normalize_quat, rotation, sigmoid};
use super::types::Gaussian;

/// A half of a split Gaussian: scale / 1.6, position = mean + R(q)·(scale ∘ noise), everything else copied.
pub fn child_of(parent: &Gaussian, noise: [f64; 3]) -> Gaussian {
    let scale = parent.log_scale.map(f64::exp);
    let rotation = rotation(normalize_quat(parent.quat).0);
    let offset = apply(&rotation, [0, 1, 2].map(|axis| scale[axis] * noise[axis]));
    Gaussian {
        mean: [0, 1, 2].map(|axis| parent.mean[axis] + offset[axis]),
        log_scale: scale.map(|s| (s / 1.6).ln()),
        ..parent.clone()
    }
}

/// A child of a split along the longest axis (Improved-GS): 0 lies in front along the axis, 1 behind.
pub fn long_axis_child(parent: &Gaussian, child: u32) -> Gaussian {
    const SHARE: f64 = 0.45;
    let scale = parent.log_scale.map(f64::exp);
    let longest =
        (1..3).fold(
            0,
            |longest, axis| {
                if parent.log_scale[axis] > parent.log_scale[longest] { axis } else { longest }
            },
        );
    let mut along = [0.0; 3];
    along[longest] = if child == 0 { 3.0 } else { -3.0 } * SHARE * scale[longest];
    let offset = apply(&rotation(normalize_quat(parent.quat).0), along);
    let opacity = 0.6 * sigmoid(parent.opacity_logit);
    let others = (1.0 - SHARE * SHARE).sqrt();
    Gaussian {
        mean: [0, 1, 2].map(|axis| parent.mean[axis] + offset[axis]),
        log_scale: [0, 1, 2]
            .map(|axis| (scale[axis] * if axis == longest { 1.0 - SHARE } else { others }).ln()),
        opacity_logit: (opacity / (1.0 - opacity)).ln(),
        ..parent.clone()
    }
}

/// PCG-4D (Jarzynski and Olano 2020).
pub fn pcg4d(key: [u32; 4]) -> [u32; 4] {
    let mix = |[mut x, mut y, mut z, mut w]: [u32; 4]| {
        x = x.wrapping_add(y.wrapping_mul(w));
        y = y.wrapping_add(z.wrapping_mul(x));
        z = z.wrapping_add(x.wrapping_mul(y));
        w = w.wrapping_add(y.wrapping_mul(z));
        [x, y, z, w]
    };
    let linear = key.map(|word| word.wrapping_mul(1_664_525).wrapping_add(1_013_904_223));
    mix(mix(linear).map(|word| word ^ (word >> 16)))
}

/// Three standard normal numbers for a key (Box and Muller 1958).
pub fn random_normal(key: [u32; 4]) -> [f64; 3] {
    let [a, b, c, d] = pcg4d(key).map(|word| (f64::from(word >> 8) + 1.0) / f64::from(1 << 24));
    let (radius_1, radius_2) = ((-2.0 * a.ln()).sqrt(), (-2.0 * c.ln()).sqrt());
    let turn = std::f64::consts::TAU;
    [radius_1 * (turn * b).cos(), radius_1 * (turn * b).sin(), radius_2 * (turn * d).cos()]
}
