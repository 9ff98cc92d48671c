//! The twin of `forward/blend_shared`, which blends exactly what `forward/blend` blends.

// Each test binary uses a part of the twins.
#[allow(unused_imports)]
pub use super::blend::blend;
