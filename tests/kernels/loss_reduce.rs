//! `loss/loss_reduce` against its twin.

use ashsplat::kernels::loss::loss_reduce::{Bind, Interface, Push, Spec};

use crate::common::compare::elementwise;
use crate::common::gpu::{Gpu, UNTOUCHED, sizes};
use crate::common::loss::{BACKGROUND, Pictures, WEIGHT, Window, forward};
use crate::common::scenes::Random;
use crate::reference::loss_reduce::{LAMBDA_DSSIM, loss};

/// Reduces partial sums into row 1 of 3.
fn reduced(gpu: &Gpu, partials: &ashsplat::vk::Buffer, count: usize, scale: f64) -> [f64; 3] {
    let spec = Spec { workgroup_size: gpu.workgroup(64), subgroup_size: gpu.subgroup() };
    let losses = gpu.untouched::<[f32; 4]>("losses", 3);
    let bind = Bind { loss_partials: partials, losses: &losses };
    let (scale, lambda_dssim) = (scale as f32, LAMBDA_DSSIM as f32);
    let push = Push { partials: count as u32, loss_row: 1, scale, lambda_dssim, weight: WEIGHT };
    gpu.dispatch::<Interface>(&spec, &bind, &push, 1);
    let all = gpu.read::<[f32; 4]>(&losses, 3);
    assert!([all[0], all[2]].as_flattened().iter().all(|x| x.to_bits() == UNTOUCHED));
    [0, 1, 2].map(|k| f64::from(all[1][k]))
}

#[test]
pub fn loss_reduce_equals_its_twin() {
    let gpu = Gpu::new();
    for size in sizes(gpu.workgroup(64) as usize) {
        let mut random = Random::new(size as u64);
        let values: Vec<[f32; 2]> =
            (0..size).map(|_| [random.unit() as f32 * 20.0, random.unit() as f32 * 90.0]).collect();
        let partials = gpu.buffer("loss_partials", &values);
        let scale = 1.0 / (256.0 * size.max(1) as f64);
        let sum = |k: usize| values.iter().map(|v| f64::from(v[k])).sum::<f64>() * scale;
        let (l1, ssim) = (sum(0), sum(1));
        let loss = f64::from(WEIGHT) * ((1.0 - LAMBDA_DSSIM) * l1 + LAMBDA_DSSIM * (1.0 - ssim));
        let expected = [loss, l1, ssim];
        elementwise("loss", &reduced(&gpu, &partials, size, scale), &expected, 1e-6, 2e-6).expect("losses");
    }
}

/// The loss of two pictures, with the kernel that precedes this one.
#[test]
pub fn loss_of_two_pictures() {
    let gpu = Gpu::new();
    let pictures = Pictures::random([67, 41]);
    let window = Window::Block { strip: 4 };
    let (_, partials) = forward(&gpu, &pictures, window);
    let count = 3 * window.partials(&pictures);
    let actual = reduced(&gpu, &partials, count, 1.0 / (3.0 * pictures.pixels() as f64));
    let interleaved = |which: usize| -> Vec<f64> {
        let planes = [0, 1, 2].map(|channel| pictures.planes(channel)[which].values.clone());
        (0..pictures.pixels()).flat_map(|i| [planes[0][i], planes[1][i], planes[2][i]]).collect()
    };
    assert_ne!(BACKGROUND, [0.0; 3]);
    let twin = loss(&interleaved(0), &interleaved(1), 67, 41);
    elementwise("loss", &actual, &[f64::from(WEIGHT) * twin.loss, twin.l1, twin.ssim], 1e-6, 1e-5)
        .expect("losses");
}
