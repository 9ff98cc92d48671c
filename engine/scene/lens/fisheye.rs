//! Fisheyes: polynomials of the angle, with tangential and thin-prism terms.

use super::{Family, RADIAL, Surface, polynomial, tangential};
use glam::dvec2;

pub(super) const FAMILY: Family = Family {
    name: "fisheye",
    surface: Surface::Angle,
    coefficients: 8,
    learned: &[0, 1, 4, 5],
    radial: |&[k1, k2, _, _, k3, k4, ..], s| polynomial(&[k1, k2, k3, k4], s),
    bend: |c, place, _| tangential(place, c[2], c[3]) + place.length_squared() * dvec2(c[6], c[7]),
    ..RADIAL
};
