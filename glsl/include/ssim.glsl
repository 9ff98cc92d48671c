// Window of SSIM: 11 x 11 Gaussian, sigma 1.5, separable, zero padding (Wang et al. 2004, as in the reference).

const uint SSIM_RADIUS = 5;
const uint SSIM_TAPS = 11;
const float SSIM_C1 = 1e-4;
const float SSIM_C2 = 9e-4;
const float SSIM_WINDOW[SSIM_TAPS] = float[](
    0.0010283801, 0.0075987581, 0.0360007721, 0.1093606895, 0.2130055377, 0.2660117249,
    0.2130055377, 0.1093606895, 0.0360007721, 0.0075987581, 0.0010283801);

// The four windowed moments. SSIM uses the two variances only as a sum, so x^2 + y^2 is one moment.
vec4 ssim_moments(vec2 value) {
    return vec4(value, dot(value, value), value.x * value.y);
}

// SSIM from the windowed x, y, x^2 + y^2 and x y, and its derivatives with respect to the windowed x, x^2 and x y.
float ssim_and_derivatives(vec4 moments, out vec3 derivatives) {
    float mx = moments.x, my = moments.y;
    float a1 = 2.0 * mx * my + SSIM_C1;
    float a2 = 2.0 * (moments.w - mx * my) + SSIM_C2;
    float b1 = mx * mx + my * my + SSIM_C1;
    float b2 = moments.z - (mx * mx + my * my) + SSIM_C2;
    float inverse = 1.0 / (b1 * b2);
    float ssim = a1 * a2 * inverse;
    float by_square = -ssim * b1 * inverse;
    float by_product = 2.0 * a1 * inverse;
    float by_mean = 2.0 * my * a2 * inverse - 2.0 * mx * ssim * b2 * inverse - 2.0 * mx * by_square - my * by_product;
    derivatives = vec3(by_mean, by_square, by_product);
    return ssim;
}

// Loss from the mean of |x - y| and the mean of SSIM.
float total_loss(vec2 means, float lambda_dssim) {
    return (1.0 - lambda_dssim) * means.x + lambda_dssim * (1.0 - means.y);
}

// Gradient of the loss at a pixel from the windowed derivatives of SSIM; `scale` is 1 / (3 W H).
float loss_gradient(vec3 windowed, vec2 value, float scale, float lambda_dssim) {
    float d_ssim = windowed.x + 2.0 * value.x * windowed.y + value.y * windowed.z;
    return scale * ((1.0 - lambda_dssim) * sign(value.x - value.y) - lambda_dssim * d_ssim);
}
