//! Fisheyes of Meta's Project Aria, whose tangential and thin-prism terms follow the radial one.

use super::{Family, RADIAL, Surface, polynomial, tangential};
use glam::dvec2;

pub(super) const FAMILY: Family = Family {
    name: "thin_prism_fisheye",
    surface: Surface::Angle,
    coefficients: 12,
    learned: &[0, 1],
    radial: |c, s| polynomial(&c[..6], s),
    bend: |c, _, radial| {
        let s = radial.length_squared();
        tangential(radial, c[7], c[6]) + s * dvec2(c[8] + s * c[9], c[10] + s * c[11])
    },
    ..RADIAL
};
