//! The twin of `optimizer/adam_texels`, which computes what `optimizer/adam` computes.

// Each test binary uses a part of the twins.
#[allow(unused_imports)]
pub use super::adam::adam;
