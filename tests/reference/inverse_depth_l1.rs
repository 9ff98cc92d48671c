//! The inverse-depth term of the loss; the twin of `loss/inverse_depth_l1`.

/// Returns the mean of |D - M| over all pixels, times the weight, and its gradient. Pixels without a target add
/// nothing.
pub fn inverse_depth_l1(depth: &[f64], targets: &[Option<f64>], weight: f64) -> (f64, Vec<f64>) {
    let pixels = depth.len() as f64;
    let (mut loss, mut gradient) = (0.0, vec![0.0; depth.len()]);
    for (pixel, target) in targets.iter().enumerate() {
        if let Some(target) = target {
            let difference = depth[pixel] - target;
            loss += weight * difference.abs() / pixels;
            gradient[pixel] = match () {
                () if difference > 0.0 => weight / pixels,
                () if difference < 0.0 => -weight / pixels,
                () => 0.0,
            };
        }
    }
    (loss, gradient)
}
