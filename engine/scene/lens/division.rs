//! The division model.

use super::{Family, RADIAL};

pub(super) const FAMILY: Family = Family {
    name: "division",
    coefficients: 1,
    learned: &[0],
    radial: |&[k, ..], s| {
        // NaN beyond the lens's end.
        let root = (1.0 - 4.0 * k * s).sqrt();
        let g = 2.0 / (1.0 + root);
        [g, k * g * g / root]
    },
    ..RADIAL
};
