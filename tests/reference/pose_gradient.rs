//! The gradient of a pose's parameters (spec of training, §8): the twin of `poses/pose_gradient`.

use super::linear::Mat3;

pub type Mat6 = [[f64; 6]; 6];

/// ω^: the matrix of the vector product with ω.
pub fn hat([x, y, z]: [f64; 3]) -> Mat3 {
    [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]
}

/// ad of ξ = (ν, ω): [ω^, ν^; 0, ω^].
fn ad(xi: [f64; 6]) -> Mat6 {
    let (nu, omega) = (hat([xi[0], xi[1], xi[2]]), hat([xi[3], xi[4], xi[5]]));
    let mut all = [[0.0; 6]; 6];
    for row in 0..3 {
        for column in 0..3 {
            all[row][column] = omega[row][column];
            all[row][column + 3] = nu[row][column];
            all[row + 3][column + 3] = omega[row][column];
        }
    }
    all
}

fn multiply(a: &Mat6, b: &Mat6) -> Mat6 {
    a.map(|row| [0, 1, 2, 3, 4, 5].map(|column| (0..6).map(|k| row[k] * b[k][column]).sum()))
}

/// The left Jacobian of SE(3): Σ ad^k / (k + 1)!.
pub fn left_jacobian(xi: [f64; 6]) -> Mat6 {
    let ad = ad(xi);
    let mut power = [[0.0; 6]; 6];
    (0..6).for_each(|i| power[i][i] = 1.0);
    let mut sum = power;
    let mut factorial = 1.0;
    for k in 1..60 {
        power = multiply(&power, &ad);
        factorial *= f64::from(k + 1);
        for (sum, x) in sum.as_flattened_mut().iter_mut().zip(power.as_flattened()) {
            *sum += x / factorial;
        }
    }
    sum
}

/// dL/dξ = J_l(ξ)ᵀ g.
pub fn gradient_of_parameters(xi: [f64; 6], g: [f64; 6]) -> [f64; 6] {
    let jacobian = left_jacobian(xi);
    [0, 1, 2, 3, 4, 5].map(|column| (0..6).map(|row| jacobian[row][column] * g[row]).sum())
}

/// Sums over subgroups of Gaussians.
pub fn total(sums: &[[f64; 6]]) -> [f64; 6] {
    [0, 1, 2, 3, 4, 5].map(|i| sums.iter().map(|sum| sum[i]).sum())
}
