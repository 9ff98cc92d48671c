//! `compose/expected_depth` against its twin.

use ashsplat::compose::{Compose, Region};
use ashsplat::vk::{Image, ImageUse};

use crate::common::compose::{IMAGE, OFFSET, SIZE, pixels};
use crate::common::gpu::Gpu;
use crate::reference::expected_depth::expected_depth;

#[test]
fn expected_depth_equals_its_twin() {
    let gpu = Gpu::new();
    let compose = Compose::new(gpu.context).expect("kernels");
    let image = Image::new(gpu.context, "depth", Compose::DEPTH_FORMAT, IMAGE, ImageUse::Depth);
    let image = image.expect("an image");
    let pixels = pixels();
    let sums: Vec<f32> = pixels.iter().enumerate().map(|(i, p)| (1.0 - p[3]) * (i + 1) as f32).collect();
    let (accumulated, depth_sums) = (gpu.buffer("accumulated", &pixels), gpu.buffer("depth_sums", &sums));
    let texels = (IMAGE[0] * IMAGE[1]) as usize;
    let (from, to) = (gpu.buffer("texels", &vec![-7.0f32; texels]), gpu.untouched::<f32>("texels", texels));
    for (min_weight, empty) in [(0.0, -1.0), (0.5, f32::INFINITY)] {
        gpu.run(|r| {
            r.copy_to_image(&from.range(0, 4 * texels as u64), &image);
            let region = Region { image: &image, offset: OFFSET };
            compose.record_expected_depth(r, [&accumulated, &depth_sums], SIZE, region, [min_weight, empty]);
            r.copy_from_image(&image, &to.range(0, 4 * texels as u64));
        });
        for (index, actual) in gpu.read::<f32>(&to, texels).into_iter().enumerate() {
            let (x, y) = (index as u32 % IMAGE[0], index as u32 / IMAGE[0]);
            let inside = |at: u32, k: usize| (OFFSET[k]..OFFSET[k] + SIZE[k]).contains(&at);
            if !(inside(x, 0) && inside(y, 1)) {
                assert_eq!(actual, -7.0, "({x}, {y}) lies outside");
                continue;
            }
            let pixel = ((y - OFFSET[1]) * SIZE[0] + x - OFFSET[0]) as usize;
            let (least, empty) = (f64::from(min_weight), f64::from(empty));
            let expected = expected_depth(pixels[pixel][3], sums[pixel], least, empty);
            let actual = f64::from(actual);
            let close = actual == expected || (actual - expected).abs() < 1e-3 * expected.abs();
            assert!(close, "({x}, {y}): {actual}, expected {expected}");
        }
    }
}
