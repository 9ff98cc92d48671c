// The window of SSIM: 11 x 11 Gaussian, sigma 1.5, separable, zero padding (Wang et al. 2004, as the reference uses it).
// A workgroup works on a block of SSIM_BLOCK x SSIM_BLOCK pixels of one channel with an apron of SSIM_RADIUS.
// Needs STRIP.

const uint SSIM_BLOCK = 16;
const uint SSIM_RADIUS = 5;
const uint SSIM_TAPS = 11;
const uint SSIM_APRON = SSIM_BLOCK + 2 * SSIM_RADIUS;
// Power of two above SSIM_APRON.
const uint SSIM_PITCH = 32;
const float SSIM_C1 = 1e-4;
const float SSIM_C2 = 9e-4;
const float SSIM_WINDOW[SSIM_TAPS] = float[](
    0.0010283801, 0.0075987581, 0.0360007721, 0.1093606895, 0.2130055377, 0.2660117249,
    0.2130055377, 0.1093606895, 0.0360007721, 0.0075987581, 0.0010283801);

// Outputs of one invocation along an axis: it reads STRIP + 10 values for them instead of 11 each.
const uint SSIM_STRIPS = SSIM_BLOCK / STRIP;
const uint SSIM_WINDOW_OF_STRIP = STRIP + SSIM_TAPS - 1;
