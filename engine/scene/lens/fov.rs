//! The field-of-view model (Devernay and Faugeras).

use super::{Family, RADIAL};

pub(super) const FAMILY: Family = Family {
    name: "fov",
    coefficients: 1,
    learned: &[0],
    radial: |&[omega, ..], s| {
        let twice = 2.0 * (0.5 * omega).tan();
        let w = twice * twice * s;
        // g = twice / omega F(w), F(w) = atan(√w) / √w.
        let root = w.sqrt();
        let [f, slope] = match w < 1e-6 {
            true => [1.0 - w / 3.0, -1.0 / 3.0],
            false => [root.atan() / root, (1.0 / (1.0 + w) - root.atan() / root) / (2.0 * w)],
        };
        [twice / omega * f, twice / omega * twice * twice * slope]
    },
    words: |&[omega, ..]| {
        let twice = 2.0 * (0.5 * omega).tan();
        let mut words = [0.0; 12];
        [words[0], words[1]] = [twice / omega, twice * twice];
        words
    },
    ..RADIAL
};
