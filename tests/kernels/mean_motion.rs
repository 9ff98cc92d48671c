//! `compose/mean_motion` against its twin.

use ashsplat::compose::{Compose, Region};
use ashsplat::forward::MotionBuffers;
use ashsplat::vk::{Image, ImageUse};

use crate::common::compose::{IMAGE, OFFSET, SIZE, pixels};
use crate::common::gpu::Gpu;
use crate::reference::mean_motion::mean_motion;

/// Value of a half float that is finite.
fn of_half(bits: u16) -> f64 {
    let (exponent, mantissa) = (i32::from(bits >> 10 & 31), f64::from(bits & 1023) / 1024.0);
    let size = match exponent {
        0 => mantissa * 2.0f64.powi(-14),
        _ => (1.0 + mantissa) * 2.0f64.powi(exponent - 15),
    };
    if bits >> 15 == 1 { -size } else { size }
}

#[test]
fn mean_motion_equals_its_twin() {
    let gpu = Gpu::new();
    let mut compose = Compose::new(gpu.context).expect("kernels");
    compose.prepare(gpu.context, [false, true]).expect("a kernel");
    let image = Image::new(gpu.context, "motion", Compose::MOTION_FORMAT, IMAGE, ImageUse::Motion);
    let image = image.expect("an image");
    let pixels = pixels();
    let sum = |i: usize, p: &[f32; 4]| {
        let large = if i.is_multiple_of(11) { 1e6 } else { 1.0 };
        [(1.0 - p[3]) * (i as f32 - 40.0) * large, (p[3] - 1.0) * 0.125]
    };
    let sums: Vec<[f32; 2]> = pixels.iter().enumerate().map(|(i, p)| sum(i, p)).collect();
    let (accumulated, motion_sums) = (gpu.buffer("accumulated", &pixels), gpu.buffer("motion_sums", &sums));
    let texels = (IMAGE[0] * IMAGE[1]) as usize;
    // 1 and -2.
    let before = [0x3C00u16, 0xC000];
    let (from, to) =
        (gpu.buffer("texels", &vec![before; texels]), gpu.untouched::<[u16; 2]>("texels", texels));
    let mut kinds = [0; 2];
    for (min_weight, empty) in [(0.0, Some([0.5, -8.0])), (0.5, Some([0.0; 2])), (0.5, None)] {
        gpu.run(|r| {
            r.copy_to_image(&from.range(0, 4 * texels as u64), &image);
            let region = Region { image: &image, offset: OFFSET };
            // The kernel does not read the visible Gaussians' motions here.
            let own = MotionBuffers { motions: &motion_sums, sums: &motion_sums };
            compose.record_motion(r, (&accumulated, own), SIZE, region, (min_weight, empty));
            r.copy_from_image(&image, &to.range(0, 4 * texels as u64));
        });
        for (index, actual) in gpu.read::<[u16; 2]>(&to, texels).into_iter().enumerate() {
            let (x, y) = (index as u32 % IMAGE[0], index as u32 / IMAGE[0]);
            let inside = |at: u32, k: usize| (OFFSET[k]..OFFSET[k] + SIZE[k]).contains(&at);
            if !(inside(x, 0) && inside(y, 1)) {
                assert_eq!(actual, before, "({x}, {y}) lies outside");
                continue;
            }
            let pixel = ((y - OFFSET[1]) * SIZE[0] + x - OFFSET[0]) as usize;
            let mean = mean_motion(pixels[pixel][3], sums[pixel], min_weight.into());
            kinds[usize::from(mean.is_some())] += 1;
            let empty = empty.map_or(before.map(of_half), |empty| empty.map(f64::from));
            for (actual, expected) in actual.map(of_half).into_iter().zip(mean.unwrap_or(empty)) {
                assert!(
                    (actual - expected).abs() <= 1e-3 * expected.abs() + 1e-6,
                    "({x}, {y}): {actual}, expected {expected}"
                );
            }
        }
    }
    assert!(kinds.iter().all(|&count| count > 5), "{kinds:?}");
}
