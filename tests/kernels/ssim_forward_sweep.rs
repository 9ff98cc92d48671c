//! `loss/ssim_forward_sweep` against the twin of `loss/ssim_forward`.

use super::ssim_forward::check;
use crate::common::gpu::Gpu;
use crate::common::loss::{Pictures, SIZES, SWEEPS, Window};

#[test]
fn ssim_forward_sweep_equals_its_twin() {
    let gpu = Gpu::new();
    if !gpu.has_texels("ssim_forward_sweep") {
        return;
    }
    for size in SIZES {
        for columns in SWEEPS {
            check(&gpu, &Pictures::random(size), Window::Sweep { columns });
            check(&gpu, &Pictures::masked(size), Window::Sweep { columns });
        }
    }
}
