//! Panoramas: longitude and latitude.

use super::{Family, RADIAL, Surface};

pub(super) const FAMILY: Family = Family { name: "equirectangular", surface: Surface::Sphere, ..RADIAL };
