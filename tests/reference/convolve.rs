//! A convolution and its ReLU in plain loops, the twin of `lpips/convolve`.

/// Features of a picture: channels, rows, columns.
#[derive(Clone, Debug, PartialEq)]
pub struct Features {
    pub channels: usize,
    pub height: usize,
    pub width: usize,
    pub values: Vec<f64>,
}

impl Features {
    /// Features with values computed by a formula.
    pub fn new(
        [channels, height, width]: [usize; 3],
        mut value: impl FnMut(usize, usize, usize) -> f64,
    ) -> Features {
        let mut values = Vec::with_capacity(channels * height * width);
        for c in 0..channels {
            for y in 0..height {
                for x in 0..width {
                    values.push(value(c, y, x));
                }
            }
        }
        Features { channels, height, width, values }
    }

    pub fn at(&self, c: usize, y: usize, x: usize) -> f64 {
        self.values[(c * self.height + y) * self.width + x]
    }

    /// Row `y` of channel `c`.
    pub fn row(&self, c: usize, y: usize) -> &[f64] {
        let start = (c * self.height + y) * self.width;
        &self.values[start..start + self.width]
    }
}

/// Side of the window, stride, and zero padding around the picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Window {
    pub size: usize,
    pub stride: usize,
    pub padding: usize,
}

impl Window {
    /// Number of windows along a side.
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
