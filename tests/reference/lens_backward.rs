//! The gradient through a lens; the twin of `exposure/lens_backward`.

use super::lens_effects::{LEAST, Rows, vignetting};

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
            let (by_t, by_gamma) = if t > LEAST {
                (gamma * t.powf(gamma - 1.0), t.powf(gamma) * t.ln())
            } else {
                let slope = LEAST.powf(gamma - 1.0);
                (slope, t * slope * LEAST.ln())
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
