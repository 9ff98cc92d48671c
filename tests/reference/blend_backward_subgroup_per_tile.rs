//! The twin of `backward/blend_backward_subgroup_per_tile`, which computes what `backward/blend_backward` computes.

// Each test binary uses a part of the twins.
#[allow(unused_imports)]
pub use super::blend_backward::blend_backward;
