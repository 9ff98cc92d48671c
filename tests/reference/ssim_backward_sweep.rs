//! The twin of `loss/ssim_backward_sweep`, which computes what `loss/ssim_backward` computes.

// Each test binary uses a part of the twins.
#[allow(unused_imports)]
pub use super::ssim_backward::ssim_backward;
