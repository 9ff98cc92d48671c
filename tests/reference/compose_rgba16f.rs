//! The twin of `compose/compose_rgba16f`: as for floats of 32 bits, rounded to the image's format.

// Each test binary uses a part of the twins.
#[allow(unused_imports)]
pub use super::compose_rgba32f::compose;
