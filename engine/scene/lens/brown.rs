//! Brown's polynomials.

use super::{Family, RADIAL, polynomial, tangential};

pub(super) const FAMILY: Family = Family {
    name: "brown",
    coefficients: 9,
    learned: &[0, 1, 2, 3],
    radial: |c, s| {
        let &[k1, k2, _, _, k3, k4, k5, k6, n4, ..] = c;
        let ([above, above_slope], [below, below_slope]) =
            (polynomial(&[k1, k2, k3, n4], s), polynomial(&[k4, k5, k6], s));
        // The lens ends where the denominator is 0.
        let g = if below > 0.0 { above / below } else { f64::NAN };
        [g, (above_slope - g * below_slope) / below]
    },
    bend: |c, place, _| tangential(place, c[2], c[3]),
    ..RADIAL
};
