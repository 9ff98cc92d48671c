//! The enhanced unified camera model.

use super::{Family, RADIAL};

pub(super) const FAMILY: Family = Family {
    name: "eucm",
    coefficients: 2,
    learned: &[0, 1],
    radial: |&[alpha, beta, ..], s| {
        // NaN beyond the lens's end.
        let root = (beta * s + 1.0).sqrt();
        let g = 1.0 / (alpha * root + 1.0 - alpha);
        [g, -alpha * beta / (2.0 * root) * g * g]
    },
    ..RADIAL
};
