//! The procedural scenes of `ashsplat demo` and the ray caster that photographs them.
//!
//! Lengths are in each scene's own units, z is up, light is linear until it is encoded as sRGB.

pub mod city;
pub mod raycast;
mod scene;
mod view;

pub use scene::Scene;
pub use view::View;
