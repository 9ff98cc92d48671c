//! `compose/depth_limit` against its twin.

use ashsplat::ash::vk;
use ashsplat::compose::{Compose, Region};
use ashsplat::scene::DepthMapping;
use ashsplat::vk::{Image, ImageUse};

use crate::common::compose::{IMAGE, OFFSET, SIZE};
use crate::common::gpu::Gpu;
use crate::reference::depth_limit::depth_limit;

#[test]
fn depth_limit_equals_its_twin() {
    let gpu = Gpu::new();
    let compose = Compose::new(gpu.context).expect("kernels");
    let texels: Vec<f32> = (0..IMAGE[0] * IMAGE[1])
        .map(|i| if i % 7 == 0 { (i % 2) as f32 } else { (i % 89) as f32 / 90.0 })
        .collect();
    // Standard, reversed with a far plane, reversed without one.
    let perspectives = [(-9.98, 10.0, 1.0), (9.98, 0.02, 0.0), (10.0, 0.0, 0.0)].map(|m| (m, false));
    // Standard and reversed depth of parallel rays, and a near plane behind the camera.
    let parallel = [(99.5, 0.5, 1.0), (-99.5, 100.0, 0.0), (-20.0, 15.0, 0.0)].map(|m| (m, true));
    let mut formats = vec![vk::Format::R32_SFLOAT];
    // Only a graphics queue may copy depth. The hosts' tests use depth that was drawn.
    match gpu.context.draws() {
        true => formats.push(vk::Format::D32_SFLOAT),
        false => eprintln!("skipped: depth formats: the queue does not draw"),
    }
    for format in formats {
        let image = Image::new(gpu.context, "depth", format, IMAGE, ImageUse::Occluder).expect("an image");
        let from = gpu.buffer("texels", &texels);
        for ((scale, offset, clear_value), linear) in perspectives.into_iter().chain(parallel) {
            let mapping = DepthMapping { scale, offset, clear_value, linear };
            let count = (SIZE[0] * SIZE[1]) as usize;
            let limits = gpu.untouched::<f32>("depth_limits", count + 4);
            gpu.run(|r| {
                r.copy_to_image(&from.range(0, 4 * texels.len() as u64), &image);
                let region = Region { image: &image, offset: OFFSET };
                compose.record_depth_limits(r, region, mapping, SIZE, &limits);
            });
            let words = gpu.read::<f32>(&limits, count + 4);
            for (index, actual) in words[..count].iter().enumerate() {
                let (x, y) = (index as u32 % SIZE[0] + OFFSET[0], index as u32 / SIZE[0] + OFFSET[1]);
                let depth = texels[(y * IMAGE[0] + x) as usize];
                let expected = depth_limit(depth, (scale.into(), offset.into()), linear, clear_value);
                // Cancellation near the camera.
                let bound = if linear { 2e-6 * expected.max(expected * expected * 100.0) } else { 2e-6 };
                let both_hide = expected > 1e30 && *actual > 1e30;
                let close = (f64::from(*actual) - expected).abs() <= bound || both_hide;
                assert!(close, "{format:?} ({x}, {y}) of depth {depth}: {actual}, expected {expected}");
            }
            let untouched = crate::common::gpu::UNTOUCHED;
            assert!(words[count..].iter().all(|word| word.to_bits() == untouched));
        }
    }
}
