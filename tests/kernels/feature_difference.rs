//! `lpips/feature_difference` against its twin.

use ashsplat::kernels::lpips::feature_difference::{Bind, Interface, Push, Spec};

use crate::common::compare::elementwise;
use crate::common::feature_maps::{MapShape, pack};
use crate::common::gpu::{Gpu, UNTOUCHED};
use crate::common::scenes::Random;
use crate::reference::convolve::Features;
use crate::reference::feature_difference::feature_difference;

#[test]
fn feature_difference_equals_its_twin() {
    for gpu in [Gpu::new(), Gpu::without_texels()] {
        let spec = Spec { workgroup_size: gpu.workgroup(64) };
        let kernel = gpu.kernel::<Interface>(&spec);
        for [channels, height, width] in [[4, 1, 1], [64, 6, 23], [512, 3, 9]] {
            let mut random = Random::new(channels as u64);
            let mut features = || {
                Features::new([channels, height, width], |_, y, x| match (y, x) {
                    // All features are 0: the kernel must not divide by zero.
                    (0, 0) => 0.0,
                    _ => f64::from((random.unit() as f32 - 0.2).max(0.0)),
                })
            };
            let pictures = [features(), features()];
            let head: Vec<f32> = (0..channels).map(|_| random.unit() as f32).collect();
            let wide: Vec<f64> = head.iter().map(|&x| f64::from(x)).collect();
            let expected = feature_difference(&pictures[0], &pictures[1], &wide);
            let shape = MapShape { channels, height, width, slots: height, margin: 1 };
            let (features, heads) =
                (gpu.buffer("features", &pack(&shape, &pictures)), gpu.buffer("heads", &head));
            let first = height / 2;
            let count = width * (height - first);
            let differences = gpu.untouched::<f32>("differences", count + 4);
            let push = Push {
                blocks: shape.blocks() as u32,
                width: width as u32,
                slots: shape.slots as u32,
                pitch: shape.pitch() as u32,
                margin: 1,
                first: first as u32,
                rows: (height - first) as u32,
            };
            let bind = Bind { features: &features, heads: &heads, differences: &differences };
            gpu.run(|r| {
                r.dispatch(&kernel, &bind, &push, count.div_ceil(spec.workgroup_size as usize) as u64)
            });
            let actual = gpu.read::<f32>(&differences, count + 4);
            assert!(actual[count..].iter().all(|value| value.to_bits() == UNTOUCHED));
            let actual: Vec<f64> = actual[..count].iter().map(|&x| f64::from(x)).collect();
            elementwise("difference", &actual, &expected[first * width..], 1e-7, 1e-5)
                .unwrap_or_else(|e| panic!("{channels} channels: {e}"));
        }
    }
}
