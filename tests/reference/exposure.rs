//! Exposures and lenses of photographs: the twins of `exposure/expose`, `exposure/expose_backward` and
//! `exposure/exposure_step`.

/// A matrix of three rows, whose last column is added.
pub type Matrix = [[f64; 4]; 3];

pub const IDENTITY: Matrix = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]];

/// The row vector of a colour times the left 3×3 part, plus the last column.
pub fn expose(picture: &[[f64; 3]], matrix: &Matrix) -> Vec<[f64; 3]> {
    let out =
        |color: &[f64; 3], c: usize| matrix[c][3] + (0..3).map(|k| color[k] * matrix[k][c]).sum::<f64>();
    picture.iter().map(|color| [0, 1, 2].map(|c| out(color, c))).collect()
}

/// Gradients of the picture and of the matrix, from the gradient of the exposed picture.
pub fn expose_backward(
    picture: &[[f64; 3]],
    matrix: &Matrix,
    gradient: &[[f64; 3]],
) -> (Vec<[f64; 3]>, Matrix) {
    let mut of_picture = vec![[0.0; 3]; picture.len()];
    let mut of_matrix = [[0.0; 4]; 3];
    for (pixel, (color, g)) in picture.iter().zip(gradient).enumerate() {
        for k in 0..3 {
            for c in 0..3 {
                of_picture[pixel][k] += matrix[k][c] * g[c];
                of_matrix[k][c] += color[k] * g[c];
            }
            of_matrix[k][3] += g[k];
        }
    }
    (of_picture, of_matrix)
}

#[derive(Clone)]
pub struct Exposures {
    pub values: Vec<Matrix>,
    pub first: Vec<Matrix>,
    pub second: Vec<Matrix>,
    /// Weight decay: the gradient gains this factor times each value, except for the diagonal with `center`.
    pub decay: f64,
    /// True if second moments use the squares of all photographs' gradients, without `decay`.
    pub shares: bool,
    /// Pull towards the identity after the step, as a share of rate / (1 - b1^t). It vanishes at a distance of 0.05.
    pub sparsity: f64,
}

impl Exposures {
    pub fn new(photographs: usize) -> Exposures {
        let none = vec![[[0.0; 4]; 3]; photographs];
        Exposures {
            values: vec![IDENTITY; photographs],
            first: none.clone(),
            second: none,
            decay: 0.0,
            shares: false,
            sparsity: 0.0,
        }
    }

    /// Makes the `count`-th step, from 1; one photograph has a gradient. With `center`, the mean over the
    /// photographs becomes the identity.
    pub fn step(&mut self, view: usize, gradient: &Matrix, rate: f64, count: i32, center: bool) {
        let photographs = self.values.len();
        for photograph in 0..photographs {
            for (row, column) in (0..3).flat_map(|row| (0..4).map(move |column| (row, column))) {
                let decay = if center && row == column { 0.0 } else { self.decay };
                let own = if photograph == view { gradient[row][column] } else { 0.0 };
                let g = own + decay * self.values[photograph][row][column];
                let m = &mut self.first[photograph][row][column];
                *m = 0.9 * *m + 0.1 * g;
                let square = match self.shares {
                    true => gradient[row][column].powi(2),
                    false => g * g,
                };
                let v = &mut self.second[photograph][row][column];
                *v = 0.999 * *v + 0.001 * square;
                let (m, v) = (*m / (1.0 - 0.9f64.powi(count)), *v / (1.0 - 0.999f64.powi(count)));
                self.values[photograph][row][column] -= rate * m / (v.sqrt() + 1e-8);
            }
        }
        let pull = self.sparsity * rate / (1.0 - 0.9f64.powi(count));
        for matrix in &mut self.values {
            let change: Matrix =
                std::array::from_fn(|row| std::array::from_fn(|k| matrix[row][k] - IDENTITY[row][k]));
            let distance = change.as_flattened().iter().map(|x| x * x).sum::<f64>().sqrt();
            let pull = pull * (1.0 - distance / 0.05).max(0.0);
            let keeps = if distance > pull { 1.0 - pull / distance } else { 0.0 };
            *matrix =
                std::array::from_fn(|row| std::array::from_fn(|k| IDENTITY[row][k] + keeps * change[row][k]));
        }
        if center {
            for (row, column) in (0..3).flat_map(|row| (0..4).map(move |column| (row, column))) {
                let mean =
                    self.values.iter().map(|matrix| matrix[row][column]).sum::<f64>() / photographs as f64;
                for matrix in &mut self.values {
                    matrix[row][column] += IDENTITY[row][column] - mean;
                }
            }
        }
    }
}

/// Rows per channel: three coefficients of vignetting, and the logarithm of the response's exponent.
pub type Rows = [[f64; 4]; 3];

/// Below this value the response is a straight line.
pub const MIN: f64 = 1.0 / 1024.0;

/// Squared distances of the pixels from the principal point, row by row, in squares of half the diagonal. The first
/// pixel's centre is 0.
pub fn squares_of_radii([width, height]: [usize; 2], center_px: [f64; 2]) -> Vec<f64> {
    let half_diagonal = ((width * width + height * height) as f64).sqrt() / 2.0;
    let square = |pixel: usize| {
        let x = (pixel % width) as f64 - center_px[0];
        let y = (pixel / width) as f64 - center_px[1];
        (x.hypot(y) / half_diagonal).powi(2)
    };
    (0..width * height).map(square).collect()
}

pub fn vignetting(row: &[f64; 4], r2: f64) -> f64 {
    1.0 + row[0] * r2 + row[1] * r2.powi(2) + row[2] * r2.powi(3)
}

pub fn response(t: f64, log_gamma: f64) -> f64 {
    let gamma = log_gamma.exp();
    if t > MIN { t.powf(gamma) } else { t / MIN * MIN.powf(gamma) }
}

pub fn lens_effects(picture: &[[f64; 3]], rows: &Rows, r2: &[f64]) -> Vec<[f64; 3]> {
    let of = |(color, &r2): (&[f64; 3], &f64)| {
        [0, 1, 2].map(|c| response(color[c] * vignetting(&rows[c], r2), rows[c][3]))
    };
    picture.iter().zip(r2).map(of).collect()
}

/// True near the end of the straight line: the response has a corner there, and float32 kernels may take either
/// side.
pub fn has_corner(color: &[f64; 3], rows: &Rows, r2: f64) -> bool {
    (0..3).any(|c| (color[c] * vignetting(&rows[c], r2) / MIN - 1.0).abs() < 1e-4)
}

/// Gradients of the picture and of the lens, from the gradient of the picture after the lens.
pub fn lens_backward(
    picture: &[[f64; 3]],
    rows: &Rows,
    r2: &[f64],
    gradient: &[[f64; 3]],
) -> (Vec<[f64; 3]>, Rows) {
    let mut of_picture = vec![[0.0; 3]; picture.len()];
    let mut of_rows = [[0.0; 4]; 3];
    for (pixel, (color, h)) in picture.iter().zip(gradient).enumerate() {
        for c in 0..3 {
            let shade = vignetting(&rows[c], r2[pixel]);
            let (t, gamma) = (color[c] * shade, rows[c][3].exp());
            let (by_t, by_gamma) = if t > MIN {
                (gamma * t.powf(gamma - 1.0), t.powf(gamma) * t.ln())
            } else {
                let slope = MIN.powf(gamma - 1.0);
                (slope, t * slope * MIN.ln())
            };
            of_picture[pixel][c] = h[c] * by_t * shade;
            for k in 0..3 {
                of_rows[c][k] += h[c] * by_t * color[c] * r2[pixel].powi(k as i32 + 1);
            }
            of_rows[c][3] += h[c] * by_gamma * gamma;
        }
    }
    (of_picture, of_rows)
}
