//! SSIM of two pictures (spec: "Loss"): 11×11 Gaussian window, σ 1.5, zero padding, per channel; and the gradient of
//! L = (1 − λ)·mean|x − y| + λ·(1 − mean SSIM) with respect to the picture x. The twins of `loss/ssim_forward` and
//! `loss/ssim_backward`.

/// Stabilisers of the quotient.
const C1: f64 = 1e-4;
const C2: f64 = 9e-4;
/// Half the window.
const RADIUS: i64 = 5;

/// One channel of a picture, row-major.
#[derive(Clone, Debug)]
pub struct Plane {
    pub width: usize,
    pub height: usize,
    pub values: Vec<f64>,
}

/// SSIM at each pixel and its partial derivatives with respect to the first picture's moments.
pub struct SsimPlane {
    pub ssim: Vec<f64>,
    /// ∂SSIM/∂(window mean of x).
    pub d_mean: Vec<f64>,
    /// ∂SSIM/∂(window mean of x²).
    pub d_square: Vec<f64>,
    /// ∂SSIM/∂(window mean of xy).
    pub d_product: Vec<f64>,
}

/// The 11 weights of the window along one axis.
pub fn window() -> [f64; 11] {
    let weights: [f64; 11] = std::array::from_fn(|i| {
        let x = i as f64 - RADIUS as f64;
        (-x * x / (2.0 * 1.5 * 1.5)).exp()
    });
    let sum: f64 = weights.iter().sum();
    weights.map(|weight| weight / sum)
}

/// The window's weighted mean at every pixel, zeros outside.
pub fn blur(plane: &Plane) -> Vec<f64> {
    let weights = window();
    let (width, height) = (plane.width as i64, plane.height as i64);
    let mut blurred = Vec::with_capacity(plane.values.len());
    for y in 0..height {
        for x in 0..width {
            let mut sum = 0.0;
            for dy in -RADIUS..=RADIUS {
                for dx in -RADIUS..=RADIUS {
                    let (u, v) = (x + dx, y + dy);
                    if u >= 0 && u < width && v >= 0 && v < height {
                        let weight = weights[(dx + RADIUS) as usize] * weights[(dy + RADIUS) as usize];
                        sum += weight * plane.values[(v * width + u) as usize];
                    }
                }
            }
            blurred.push(sum);
        }
    }
    blurred
}

pub fn ssim_forward(x: &Plane, y: &Plane) -> SsimPlane {
    let product = |a: &Plane, b: &Plane| Plane {
        width: a.width,
        height: a.height,
        values: a.values.iter().zip(&b.values).map(|(a, b)| a * b).collect(),
    };
    let (mean_x, mean_y) = (blur(x), blur(y));
    let (square_x, square_y, product_xy) = (blur(&product(x, x)), blur(&product(y, y)), blur(&product(x, y)));
    let mut result = SsimPlane { ssim: vec![], d_mean: vec![], d_square: vec![], d_product: vec![] };
    for i in 0..x.values.len() {
        let (mu_x, mu_y) = (mean_x[i], mean_y[i]);
        let variance_x = square_x[i] - mu_x * mu_x;
        let variance_y = square_y[i] - mu_y * mu_y;
        let covariance = product_xy[i] - mu_x * mu_y;
        let (a1, a2) = (2.0 * mu_x * mu_y + C1, 2.0 * covariance + C2);
        let (b1, b2) = (mu_x * mu_x + mu_y * mu_y + C1, variance_x + variance_y + C2);
        let ssim = a1 * a2 / (b1 * b2);
        let d_variance = -ssim / b2;
        let d_covariance = 2.0 * a1 / (b1 * b2);
        let d_mu_direct = 2.0 * mu_y * a2 / (b1 * b2) - 2.0 * mu_x * ssim / b1;
        result.ssim.push(ssim);
        result.d_mean.push(d_mu_direct - 2.0 * mu_x * d_variance - mu_y * d_covariance);
        result.d_square.push(d_variance);
        result.d_product.push(d_covariance);
    }
    result
}

/// dL/dx of one channel; `values` is the number of values in all the channels together.
pub fn ssim_backward(
    x: &Plane,
    y: &Plane,
    forward: &SsimPlane,
    lambda_dssim: f64,
    values: usize,
) -> Vec<f64> {
    // The window is symmetric, so its transpose is itself.
    let [mean, square, product] = [&forward.d_mean, &forward.d_square, &forward.d_product]
        .map(|values| blur(&Plane { width: x.width, height: x.height, values: values.clone() }));
    (0..x.values.len())
        .map(|i| {
            let difference = x.values[i] - y.values[i];
            let sign = if difference == 0.0 { 0.0 } else { difference.signum() };
            let d_ssim = mean[i] + 2.0 * x.values[i] * square[i] + y.values[i] * product[i];
            ((1.0 - lambda_dssim) * sign - lambda_dssim * d_ssim) / values as f64
        })
        .collect()
}
