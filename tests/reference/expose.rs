//! Colours under an exposure; the twin of `exposure/expose`.

/// A matrix of three rows, whose last column is added.
pub type Matrix = [[f64; 4]; 3];

pub const IDENTITY: Matrix = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]];

/// The row vector of a colour times the left 3×3 part, plus the last column.
pub fn expose(picture: &[[f64; 3]], matrix: &Matrix) -> Vec<[f64; 3]> {
    let mut exposed = Vec::new();
    for color in picture {
        let mut out = [0.0; 3];
        for c in 0..3 {
            out[c] = matrix[c][3];
            for k in 0..3 {
                out[c] += color[k] * matrix[k][c];
            }
        }
        exposed.push(out);
    }
    exposed
}
