//! LPIPS from the twins of its layers, and weights by the formula of the golden vectors.

use super::convolve::{Features, Window, convolve};
use super::feature_difference::feature_difference;
use super::max_pool::max_pool;

/// A step of a network.
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

fn wide(values: &[f32]) -> Vec<f64> {
    values.iter().map(|&value| f64::from(value)).collect()
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
