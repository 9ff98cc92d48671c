//! The twin of `forward/blend_shared`, which blends exactly what `forward/blend` blends.

pub use super::blend::blend;
