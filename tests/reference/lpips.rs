//! LPIPS, and weights by the formula of the golden vectors. Its layers are the twins of `lpips/convolve`,
//! `lpips/max_pool` and `lpips/feature_difference`.

use super::linear::wide;

/// Features of a picture: channels, rows, columns.
#[derive(Clone, Debug, PartialEq)]
pub struct Features {
    pub channels: usize,
    pub height: usize,
    pub width: usize,
    pub values: Vec<f64>,
}

impl Features {
    pub fn new(
        [channels, height, width]: [usize; 3],
        mut value: impl FnMut(usize, usize, usize) -> f64,
    ) -> Features {
        let at = |i: usize| value(i / (height * width), i / width % height, i % width);
        Features { channels, height, width, values: (0..channels * height * width).map(at).collect() }
    }

    pub fn at(&self, c: usize, y: usize, x: usize) -> f64 {
        self.values[(c * self.height + y) * self.width + x]
    }

    pub fn row(&self, c: usize, y: usize) -> &[f64] {
        let start = (c * self.height + y) * self.width;
        &self.values[start..start + self.width]
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Window {
    pub size: usize,
    pub stride: usize,
    pub padding: usize,
}

impl Window {
    pub fn count(&self, side: usize) -> usize {
        (side + 2 * self.padding - self.size) / self.stride + 1
    }
}

/// `weights` in the order (output, input, y, x).
pub fn convolve(input: &Features, weights: &[f64], biases: &[f64], window: Window) -> Features {
    let Window { size, stride, padding } = window;
    let (height, width) = (window.count(input.height), window.count(input.width));
    let mut output = Features::new([biases.len(), height, width], |o, _, _| biases[o]);
    for o in 0..biases.len() {
        for (y, row) in
            output.values[o * height * width..(o + 1) * height * width].chunks_mut(width).enumerate()
        {
            for (i, ky) in (0..input.channels).flat_map(|i| (0..size).map(move |ky| (i, ky))) {
                let from = y * stride + ky;
                if from < padding || from - padding >= input.height {
                    continue;
                }
                let from = input.row(i, from - padding);
                for kx in 0..size {
                    let weight = weights[((o * input.channels + i) * size + ky) * size + kx];
                    for (x, sum) in row.iter_mut().enumerate() {
                        let place = x * stride + kx;
                        if place >= padding && place - padding < input.width {
                            *sum += weight * from[place - padding];
                        }
                    }
                }
            }
        }
    }
    output.values.iter_mut().for_each(|value| *value = value.max(0.0));
    output
}

/// The largest value of each window, in each channel; there is no padding.
pub fn max_pool(input: &Features, window: Window) -> Features {
    let shape = [input.channels, window.count(input.height), window.count(input.width)];
    Features::new(shape, |c, y, x| {
        let mut largest = f64::NEG_INFINITY;
        for (ky, kx) in (0..window.size).flat_map(|ky| (0..window.size).map(move |kx| (ky, kx))) {
            largest = largest.max(input.at(c, y * window.stride + ky, x * window.stride + kx));
        }
        largest
    })
}

/// Differences of normalised features per pixel (Zhang et al. 2018, equation 1), row by row.
pub fn feature_difference(a: &Features, b: &Features, head: &[f64]) -> Vec<f64> {
    let norm = |features: &Features, y: usize, x: usize| {
        (0..features.channels).map(|c| features.at(c, y, x).powi(2)).sum::<f64>().sqrt() + 1e-10
    };
    let mut differences = Vec::new();
    for (y, x) in (0..a.height).flat_map(|y| (0..a.width).map(move |x| (y, x))) {
        let (norm_a, norm_b) = (norm(a, y, x), norm(b, y, x));
        let channel = |c: usize| head[c] * (a.at(c, y, x) / norm_a - b.at(c, y, x) / norm_b).powi(2);
        differences.push((0..a.channels).map(channel).sum());
    }
    differences
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// Convolution with this number of outputs.
    Convolve(usize, Window),
    Pool(Window),
    /// LPIPS compares the features at this point.
    Tap,
}

const fn conv(outputs: usize, size: usize, stride: usize, padding: usize) -> Step {
    Step::Convolve(outputs, Window { size, stride, padding })
}

const fn pool(size: usize) -> Step {
    Step::Pool(Window { size, stride: 2, padding: 0 })
}

pub const ALEXNET: [Step; 12] = [
    conv(64, 11, 4, 2),
    Step::Tap,
    pool(3),
    conv(192, 5, 1, 2),
    Step::Tap,
    pool(3),
    conv(384, 3, 1, 1),
    Step::Tap,
    conv(256, 3, 1, 1),
    Step::Tap,
    conv(256, 3, 1, 1),
    Step::Tap,
];

pub const VGG16: [Step; 22] = [
    conv(64, 3, 1, 1),
    conv(64, 3, 1, 1),
    Step::Tap,
    pool(2),
    conv(128, 3, 1, 1),
    conv(128, 3, 1, 1),
    Step::Tap,
    pool(2),
    conv(256, 3, 1, 1),
    conv(256, 3, 1, 1),
    conv(256, 3, 1, 1),
    Step::Tap,
    pool(2),
    conv(512, 3, 1, 1),
    conv(512, 3, 1, 1),
    conv(512, 3, 1, 1),
    Step::Tap,
    pool(2),
    conv(512, 3, 1, 1),
    conv(512, 3, 1, 1),
    conv(512, 3, 1, 1),
    Step::Tap,
];

/// Weights and biases of each convolution; weights of each tap.
#[derive(Clone, Debug, PartialEq)]
pub struct Weights {
    pub convolutions: Vec<(Vec<f32>, Vec<f32>)>,
    pub heads: Vec<Vec<f32>>,
}

/// Hashes two numbers to a number in [-1, 1).
pub fn hash(tag: u32, j: u32) -> f32 {
    let mut x = (tag << 24).wrapping_add(j);
    x ^= x >> 16;
    x = x.wrapping_mul(0x7feb_352d);
    x ^= x >> 15;
    x = x.wrapping_mul(0x846c_a68b);
    x ^= x >> 16;
    (x >> 8) as f32 / (1 << 23) as f32 - 1.0
}

/// Weights by formula; `tags` is 0 for AlexNet and 64 for VGG16.
pub fn formula(steps: &[Step], tags: u32) -> Weights {
    let mut weights = Weights { convolutions: vec![], heads: vec![] };
    let mut inputs = 3;
    for step in steps {
        match *step {
            Step::Convolve(outputs, window) => {
                let fan_in = inputs * window.size * window.size;
                let tag = tags + 2 * weights.convolutions.len() as u32;
                let scale = (6.0 / fan_in as f64).sqrt() as f32;
                let own = (0..(outputs * fan_in) as u32).map(|j| hash(tag, j) * scale).collect();
                let biases = (0..outputs as u32).map(|j| hash(tag + 1, j) * 0.05).collect();
                weights.convolutions.push((own, biases));
                inputs = outputs;
            }
            Step::Tap => {
                let tag = tags + 100 + weights.heads.len() as u32;
                weights.heads.push((0..inputs as u32).map(|j| hash(tag, j).abs() / 4.0).collect());
            }
            Step::Pool(_) => {}
        }
    }
    weights
}

/// LPIPS of two pictures, one part per tap. Values are in the network's range: [0, 1] or [-1, 1].
pub fn lpips(
    steps: &[Step],
    weights: &Weights,
    pictures: [&[[f64; 3]]; 2],
    [width, height]: [usize; 2],
) -> Vec<f64> {
    let (shift, scale) = ([-0.030, -0.088, -0.188], [0.458, 0.448, 0.450]);
    let mut features = pictures.map(|picture| {
        Features::new([3, height, width], |c, y, x| (picture[y * width + x][c] - shift[c]) / scale[c])
    });
    let (mut convolutions, mut heads) = (weights.convolutions.iter(), weights.heads.iter());
    let mut parts = vec![];
    for step in steps {
        match *step {
            Step::Convolve(_, window) => {
                let (own, biases) = convolutions.next().expect("weights");
                let (own, biases) = (wide(own), wide(biases));
                features = features.map(|input| convolve(&input, &own, &biases, window));
            }
            Step::Pool(window) => features = features.map(|input| max_pool(&input, window)),
            Step::Tap => {
                let head = wide(heads.next().expect("a head"));
                let differences = feature_difference(&features[0], &features[1], &head);
                parts.push(differences.iter().sum::<f64>() / differences.len() as f64);
            }
        }
    }
    parts
}
