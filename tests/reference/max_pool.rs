//! Max pooling in plain loops, the twin of `lpips/max_pool`.

use super::convolve::{Features, Window};

/// The largest value of each window, in each channel; there is no padding.
pub fn max_pool(input: &Features, window: Window) -> Features {
    let shape = [input.channels, window.count(input.height), window.count(input.width)];
    Features::new(shape, |c, y, x| {
        let mut largest = f64::NEG_INFINITY;
        for (ky, kx) in (0..window.size).flat_map(|ky| (0..window.size).map(move |kx| (ky, kx))) {
            largest = largest.max(input.at(c, y * window.stride + ky, x * window.stride + kx));
        }
        largest
    })
}
