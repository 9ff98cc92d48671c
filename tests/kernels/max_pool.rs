//! `lpips/max_pool` against its twin.

use ashsplat::kernels::lpips::max_pool::{Bind, Interface, Push, Spec};

use crate::common::compare::equal;
use crate::common::feature_maps::{MapShape, pack, unpack};
use crate::common::gpu::Gpu;
use crate::common::scenes::Random;
use crate::reference::convolve::{Features, Window};
use crate::reference::max_pool::max_pool;

fn check(gpu: &Gpu, size: usize, [channels, height, width]: [usize; 3]) {
    let window = Window { size, stride: 2, padding: 0 };
    let mut random = Random::new((size * width) as u64);
    // Features after a ReLU, rounded to float32.
    let mut features = || {
        Features::new([channels, height, width], |_, _, _| f64::from((random.unit() as f32 - 0.2).max(0.0)))
    };
    let pictures = [features(), features()];
    let expected = pictures.each_ref().map(|picture| max_pool(picture, window));
    let (out_height, out_width) = (expected[0].height, expected[0].width);
    let spec = Spec { workgroup_size: gpu.workgroup(64), size: size as u32, stride: 2 };
    let kernel = gpu.kernel::<Interface>(&spec);
    let input = MapShape { channels, height, width, slots: height + 1, margin: 0 };
    let output = MapShape { channels, height: out_height, width: out_width, slots: out_height, margin: 1 };
    let inputs = gpu.buffer("inputs", &pack(&input, &pictures));
    let outputs = gpu.untouched::<[f32; 4]>("outputs", output.texels());
    for (first, rows) in [(0, 1), (1, out_height - 1)] {
        let push = Push {
            blocks: input.blocks() as u32,
            in_height: height as u32,
            in_slots: input.slots as u32,
            in_pitch: input.pitch() as u32,
            out_width: out_width as u32,
            out_slots: output.slots as u32,
            out_pitch: output.pitch() as u32,
            out_margin: output.margin as u32,
            first: first as u32,
            rows: rows as u32,
        };
        let grid = [(out_width * rows).div_ceil(spec.workgroup_size as usize) as u32, push.blocks, 2];
        gpu.run(|r| r.dispatch_3d(&kernel, &Bind { inputs: &inputs, outputs: &outputs }, &push, grid));
    }
    let texels = gpu.read::<[f32; 4]>(&outputs, output.texels());
    for (picture, expected) in expected.iter().enumerate() {
        equal("feature", &unpack(&output, &texels, picture, 0..out_height), &expected.values)
            .unwrap_or_else(|e| panic!("{size}, {channels}x{height}x{width}, picture {picture}: {e}"));
    }
}

#[test]
fn max_pool_equals_its_twin() {
    for gpu in [Gpu::new(), Gpu::without_texels()] {
        for size in [2, 3] {
            for shape in [[4, 5, 5], [8, 12, 67], [64, 9, 30]] {
                check(&gpu, size, shape);
            }
        }
    }
}
