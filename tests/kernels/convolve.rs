//! `lpips/convolve` against its twin.

use ashsplat::kernels::lpips::convolve::{Bind, Interface, Push, Spec};

use crate::common::compare::elementwise;
use crate::common::feature_maps::{MapShape, pack, unpack};
use crate::common::gpu::{Gpu, UNTOUCHED};
use crate::common::scenes::Random;
use crate::reference::convolve::{Features, Window, convolve};

/// Window, inputs, outputs, and size of the picture.
type Case = (Window, usize, usize, [usize; 2]);

/// The windows of both networks, with channel counts that do not fill a block.
const CASES: [Case; 5] = [
    (Window { size: 11, stride: 4, padding: 2 }, 3, 8, [35, 47]),
    (Window { size: 5, stride: 1, padding: 2 }, 8, 4, [7, 9]),
    (Window { size: 3, stride: 1, padding: 1 }, 16, 12, [13, 70]),
    (Window { size: 3, stride: 1, padding: 1 }, 4, 4, [1, 1]),
    (Window { size: 2, stride: 3, padding: 0 }, 5, 4, [17, 12]),
];

fn check(gpu: &Gpu, (window, inputs, outputs, [height, width]): Case, rows: u32, slack: usize) {
    let mut random = Random::new((inputs * outputs + width) as u64);
    let mut features =
        || Features::new([inputs, height, width], |_, _, _| f64::from(random.unit() as f32) - 0.3);
    let pictures = [features(), features()];
    let mut numbers = |count: usize| (0..count).map(|_| random.unit() as f32 - 0.5).collect::<Vec<f32>>();
    let weights = numbers(outputs * inputs * window.size * window.size);
    let biases = numbers(outputs);
    let wide = |values: &[f32]| values.iter().map(|&x| f64::from(x)).collect::<Vec<f64>>();
    let expected = pictures.each_ref().map(|p| convolve(p, &wide(&weights), &wide(&biases), window));

    // The four weights of a texel belong to four outputs.
    let mut packed = vec![];
    for (block, ky) in (0..outputs / 4).flat_map(|block| (0..window.size).map(move |ky| (block, ky))) {
        for (first, kx) in (0..inputs.div_ceil(4)).flat_map(|i| (0..window.size).map(move |kx| (4 * i, kx))) {
            for (i, o) in (first..first + 4).flat_map(|i| (0..4).map(move |o| (i, 4 * block + o))) {
                let at = ((o * inputs + i) * window.size + ky) * window.size + kx;
                packed.push(if i < inputs { weights[at] } else { 0.0 });
            }
        }
    }
    let spec = Spec {
        workgroup_size: gpu.workgroup(64),
        size: window.size as u32,
        stride: window.stride as u32,
        rows,
    };
    let kernel = gpu.kernel::<Interface>(&spec);
    let input = MapShape { channels: inputs, height, width, slots: height + slack, margin: window.padding };
    let (out_height, out_width) = (expected[0].height, expected[0].width);
    // Fewer slots than rows: the last rows replace the first.
    let slots = out_height.div_ceil(2) + 1;
    let output = MapShape { channels: outputs, height: out_height, width: out_width, slots, margin: 3 };
    let (input_buffer, output_buffer) = (
        gpu.buffer("inputs", &pack(&input, &pictures)),
        gpu.untouched::<[f32; 4]>("outputs", output.texels()),
    );
    let (weights, biases) = (gpu.buffer("weights", &packed), gpu.buffer("biases", &biases));
    let bind = Bind { inputs: &input_buffer, weights: &weights, biases: &biases, outputs: &output_buffer };
    for (first, end) in [(0, slots.min(out_height)), (slots.min(out_height), out_height)] {
        if first == end {
            continue;
        }
        let count = end - first;
        let push = Push {
            in_blocks: input.blocks() as u32,
            in_height: height as u32,
            in_slots: input.slots as u32,
            in_pitch: input.pitch() as u32,
            padding: window.padding as u32,
            out_blocks: output.blocks() as u32,
            out_width: out_width as u32,
            out_slots: output.slots as u32,
            out_pitch: output.pitch() as u32,
            out_margin: output.margin as u32,
            first: first as u32,
            rows: count as u32,
        };
        let columns = (out_width * count.div_ceil(rows as usize)) as u32;
        gpu.run(|r| {
            let grid = [columns.div_ceil(spec.workgroup_size), output.blocks() as u32, 2];
            r.dispatch_3d(&kernel, &bind, &push, grid);
        });
        let texels = gpu.read::<[f32; 4]>(&output_buffer, output.texels());
        for (picture, expected) in expected.iter().enumerate() {
            let actual = unpack(&output, &texels, picture, first..end);
            let wanted: Vec<f64> = (0..outputs)
                .flat_map(|c| (first..end).flat_map(move |y| expected.row(c, y).to_vec()))
                .collect();
            elementwise("feature", &actual, &wanted, 2e-5, 2e-5)
                .unwrap_or_else(|e| panic!("{window:?}, {rows} rows, picture {picture}: {e}"));
        }
        let margins = output.margins().map(|at| texels[at].map(f32::to_bits));
        assert!(margins.flatten().all(|word| word == UNTOUCHED), "{window:?}: zeros are not its to write");
    }
}

#[test]
fn convolve_equals_its_twin() {
    // With texels and with storage buffers.
    for gpu in [Gpu::new(), Gpu::without_texels()] {
        for case in CASES {
            for (rows, slack) in [(4, 0), (1, 2), (3, 1)] {
                check(&gpu, case, rows, slack);
            }
        }
    }
}
