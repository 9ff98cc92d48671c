//! Adam over the exposures of all photographs; the twin of `exposure/exposure_step`.

use super::expose::{IDENTITY, Matrix};

/// Matrices and moments.
#[derive(Clone)]
pub struct Exposures {
    pub values: Vec<Matrix>,
    pub first: Vec<Matrix>,
    pub second: Vec<Matrix>,
    /// Gradients of the views since the last step.
    pub sums: Vec<Matrix>,
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
            second: none.clone(),
            sums: none,
            decay: 0.0,
            shares: false,
            sparsity: 0.0,
        }
    }

    /// Makes the `count`-th step, from 1; one photograph has a gradient. With `center`, the mean over the
    /// photographs becomes the identity.
    pub fn step(&mut self, view: usize, gradient: &Matrix, rate: f64, count: i32, center: bool) {
        self.add(view, gradient, true);
        self.step_of_sums(rate, count, center);
    }

    /// Adds the gradient of a photograph to the sums. `starts`: it is the first.
    pub fn add(&mut self, view: usize, gradient: &Matrix, starts: bool) {
        if starts {
            self.sums.fill([[0.0; 4]; 3]);
        }
        for (sum, g) in self.sums[view].as_flattened_mut().iter_mut().zip(gradient.as_flattened()) {
            *sum += g;
        }
    }

    /// Same as [`Exposures::step`], but with the gradients already added.
    pub fn step_of_sums(&mut self, rate: f64, count: i32, center: bool) {
        let photographs = self.values.len();
        for photograph in 0..photographs {
            for (row, column) in (0..3).flat_map(|row| (0..4).map(move |column| (row, column))) {
                let decay = if center && row == column { 0.0 } else { self.decay };
                let g = self.sums[photograph][row][column] + decay * self.values[photograph][row][column];
                let m = &mut self.first[photograph][row][column];
                *m = 0.9 * *m + 0.1 * g;
                let square = match self.shares {
                    true => self.sums.iter().map(|sum| sum[row][column].powi(2)).sum(),
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
            let mut change = *matrix;
            for (x, same) in change.as_flattened_mut().iter_mut().zip(IDENTITY.as_flattened()) {
                *x -= same;
            }
            let distance = change.as_flattened().iter().map(|x| x * x).sum::<f64>().sqrt();
            let pull = pull * (1.0 - distance / 0.05).max(0.0);
            let keeps = if distance > pull { 1.0 - pull / distance } else { 0.0 };
            for (x, (change, same)) in matrix
                .as_flattened_mut()
                .iter_mut()
                .zip(change.as_flattened().iter().zip(IDENTITY.as_flattened()))
            {
                *x = same + keeps * change;
            }
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
