//! The gradient through an exposure; the twin of `exposure/expose_backward`.

use super::expose::Matrix;

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
