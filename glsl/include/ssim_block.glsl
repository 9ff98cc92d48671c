// Block of pixels in shared memory under the window: a workgroup handles SSIM_BLOCK x SSIM_BLOCK pixels of one channel with an
// apron of SSIM_RADIUS.
// Needs ssim.glsl, STRIP.

const uint SSIM_BLOCK = 16;
const uint SSIM_APRON = SSIM_BLOCK + 2 * SSIM_RADIUS;
// Next power of two above SSIM_APRON.
const uint SSIM_PITCH = 32;

// Number of invocations along an axis. Each computes STRIP outputs from STRIP + 10 values, instead of 11 values per output.
const uint SSIM_STRIPS = SSIM_BLOCK / STRIP;
const uint SSIM_WINDOW_OF_STRIP = STRIP + SSIM_TAPS - 1;
