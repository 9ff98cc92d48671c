//! The twin of `loss/ssim_forward_sweep`, which computes what `loss/ssim_forward` computes.

// Each test binary uses a part of the twins.
#[allow(unused_imports)]
pub use super::ssim_forward::ssim_forward;
