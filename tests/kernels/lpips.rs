//! The kernels of `lpips/` against their twins: `lpips/convolve`, `lpips/max_pool` and `lpips/feature_difference`. Each
//! reads texels or storage buffers.

use crate::common::prelude::*;
use crate::reference::lpips::{self as twin, Features, Window};
use ashsplat::kernels::lpips::{convolve, feature_difference, max_pool};
use std::ops::Range;

/// Shape of a feature map of two pictures, as the kernels store it: feature_map.glsl.
struct MapShape {
    channels: usize,
    height: usize,
    width: usize,
    /// Number of rows stored; row y lies in slot y modulo this number.
    slots: usize,
    /// Columns of zeros on each side.
    margin: usize,
}

impl MapShape {
    fn blocks(&self) -> usize {
        self.channels.div_ceil(4)
    }

    fn pitch(&self) -> usize {
        self.width + 2 * self.margin
    }

    fn texels(&self) -> usize {
        2 * self.blocks() * (self.slots + 1) * self.pitch()
    }

    fn texel(&self, picture: usize, block: usize, slot: usize, x: usize) -> usize {
        ((picture * self.blocks() + block) * (self.slots + 1) + slot) * self.pitch() + self.margin + x
    }

    /// Indices of all texels beside the columns, and of the row of zeros.
    fn margins(&self) -> impl Iterator<Item = usize> {
        let (pitch, width, margin, rows) = (self.pitch(), self.width, self.margin, self.slots + 1);
        (0..self.texels()).filter(move |at| {
            let (x, slot) = (at % pitch, at / pitch % rows);
            x < margin || x >= margin + width || slot == rows - 1
        })
    }
}

fn pack(shape: &MapShape, pictures: &[Features; 2]) -> Vec<[f32; 4]> {
    let mut texels = vec![[0.0; 4]; shape.texels()];
    for (picture, features) in pictures.iter().enumerate() {
        for y in shape.height.saturating_sub(shape.slots)..shape.height {
            for (c, x) in (0..shape.channels).flat_map(|c| (0..shape.width).map(move |x| (c, x))) {
                let at = shape.texel(picture, c / 4, y % shape.slots, x);
                texels[at][c % 4] = features.at(c, y, x) as f32;
            }
        }
    }
    texels
}

/// Unpacks some rows of a picture: channel by channel, row by row.
fn unpack(shape: &MapShape, texels: &[[f32; 4]], picture: usize, rows: Range<usize>) -> Vec<f64> {
    let mut values = vec![];
    for c in 0..shape.channels {
        for (y, x) in rows.clone().flat_map(|y| (0..shape.width).map(move |x| (y, x))) {
            values.push(f64::from(texels[shape.texel(picture, c / 4, y % shape.slots, x)][c % 4]));
        }
    }
    values
}

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

fn two_pictures(shape: [usize; 3], mut feature: impl FnMut(usize, usize) -> f32) -> [Features; 2] {
    [(); 2].map(|()| Features::new(shape, |_, y, x| f64::from(feature(y, x))))
}

fn rectified(random: &mut Random) -> f32 {
    (random.unit() as f32 - 0.2).max(0.0)
}

fn check_convolve(gpu: &Gpu, (window, inputs, outputs, [height, width]): Case, rows: u32, slack: usize) {
    let mut random = Random::new((inputs * outputs + width) as u64);
    let pictures = two_pictures([inputs, height, width], |_, _| random.unit() as f32 - 0.3);
    let mut numbers = |count: usize| (0..count).map(|_| random.unit() as f32 - 0.5).collect::<Vec<f32>>();
    let weights = numbers(outputs * inputs * window.size * window.size);
    let biases = numbers(outputs);
    let [wide_weights, wide_biases] = [&weights, &biases].map(|values| twin::wide(values));
    let expected = pictures.each_ref().map(|p| twin::convolve(p, &wide_weights, &wide_biases, window));

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
    let spec = convolve::Spec {
        workgroup_size: gpu.workgroup(64),
        size: window.size as u32,
        stride: window.stride as u32,
        rows,
    };
    let kernel = gpu.kernel::<convolve::Interface>(&spec);
    let input = MapShape { channels: inputs, height, width, slots: height + slack, margin: window.padding };
    let (out_height, out_width) = (expected[0].height, expected[0].width);
    // Fewer slots than rows: the last rows replace the first.
    let slots = out_height.div_ceil(2) + 1;
    let output = MapShape { channels: outputs, height: out_height, width: out_width, slots, margin: 3 };
    let output_buffer = gpu.untouched::<[f32; 4]>("outputs", output.texels());
    let bind = convolve::Bind {
        inputs: &gpu.buffer("inputs", &pack(&input, &pictures)),
        weights: &gpu.buffer("weights", &packed),
        biases: &gpu.buffer("biases", &biases),
        outputs: &output_buffer,
    };
    let middle = slots.min(out_height);
    for rows_written in [0..middle, middle..out_height].into_iter().filter(|rows| !rows.is_empty()) {
        let count = rows_written.len();
        let push = convolve::Push {
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
            first: rows_written.start as u32,
            rows: count as u32,
        };
        let columns = (out_width * count.div_ceil(rows as usize)) as u32;
        let grid = [columns.div_ceil(spec.workgroup_size), output.blocks() as u32, 2];
        gpu.run(|r| r.dispatch_3d(&kernel, &bind, &push, grid));
        let texels = gpu.read::<[f32; 4]>(&output_buffer, output.texels());
        for (picture, expected) in expected.iter().enumerate() {
            let actual = unpack(&output, &texels, picture, rows_written.clone());
            let wanted: Vec<f64> = (0..outputs)
                .flat_map(|c| rows_written.clone().flat_map(move |y| expected.row(c, y).to_vec()))
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
    for gpu in [Gpu::new(), Gpu::without_texels()] {
        for case in CASES {
            for (rows, slack) in [(4, 0), (1, 2), (3, 1)] {
                check_convolve(&gpu, case, rows, slack);
            }
        }
    }
}

fn check_max_pool(gpu: &Gpu, size: usize, [channels, height, width]: [usize; 3]) {
    let window = Window { size, stride: 2, padding: 0 };
    let mut random = Random::new((size * width) as u64);
    let pictures = two_pictures([channels, height, width], |_, _| rectified(&mut random));
    let expected = pictures.each_ref().map(|picture| twin::max_pool(picture, window));
    let (out_height, out_width) = (expected[0].height, expected[0].width);
    let spec = max_pool::Spec { workgroup_size: gpu.workgroup(64), size: size as u32, stride: 2 };
    let kernel = gpu.kernel::<max_pool::Interface>(&spec);
    let input = MapShape { channels, height, width, slots: height + 1, margin: 0 };
    let output = MapShape { channels, height: out_height, width: out_width, slots: out_height, margin: 1 };
    let outputs = gpu.untouched::<[f32; 4]>("outputs", output.texels());
    let bind = max_pool::Bind { inputs: &gpu.buffer("inputs", &pack(&input, &pictures)), outputs: &outputs };
    for (first, rows) in [(0, 1), (1, out_height - 1)] {
        let push = max_pool::Push {
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
        gpu.run(|r| r.dispatch_3d(&kernel, &bind, &push, grid));
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
                check_max_pool(&gpu, size, shape);
            }
        }
    }
}

#[test]
fn feature_difference_equals_its_twin() {
    for gpu in [Gpu::new(), Gpu::without_texels()] {
        for [channels, height, width] in [[4, 1, 1], [64, 6, 23], [512, 3, 9]] {
            let mut random = Random::new(channels as u64);
            // Where all features are 0 the kernel must not divide by zero.
            let feature = |y, x| if (y, x) == (0, 0) { 0.0 } else { rectified(&mut random) };
            let pictures = two_pictures([channels, height, width], feature);
            let head: Vec<f32> = (0..channels).map(|_| random.unit() as f32).collect();
            let expected = twin::feature_difference(&pictures[0], &pictures[1], &twin::wide(&head));
            let shape = MapShape { channels, height, width, slots: height, margin: 1 };
            let first = height / 2;
            let count = width * (height - first);
            let differences = gpu.untouched::<f32>("differences", count + 4);
            let push = feature_difference::Push {
                blocks: shape.blocks() as u32,
                width: width as u32,
                slots: shape.slots as u32,
                pitch: shape.pitch() as u32,
                margin: 1,
                first: first as u32,
                rows: (height - first) as u32,
            };
            let bind = feature_difference::Bind {
                features: &gpu.buffer("features", &pack(&shape, &pictures)),
                heads: &gpu.buffer("heads", &head),
                differences: &differences,
            };
            let spec = feature_difference::Spec { workgroup_size: gpu.workgroup(64) };
            gpu.dispatch_over::<feature_difference::Interface>(&spec, &bind, &push, count);
            assert_eq!(gpu.read::<u32>(&differences, count + 4)[count..], [UNTOUCHED; 4]);
            let actual = gpu.read_f64::<f32>(&differences, count);
            elementwise("difference", &actual, &expected[first * width..], 1e-7, 1e-5)
                .unwrap_or_else(|e| panic!("{channels} channels: {e}"));
        }
    }
}
