// Blocks of the window in shared memory: a workgroup works on SSIM_BLOCK x SSIM_BLOCK pixels of one channel with an apron
// of SSIM_RADIUS.
// Needs ssim.glsl, STRIP.

const uint SSIM_BLOCK = 16;
const uint SSIM_APRON = SSIM_BLOCK + 2 * SSIM_RADIUS;
// Power of two above SSIM_APRON.
const uint SSIM_PITCH = 32;

// Outputs of one invocation along an axis: it reads STRIP + 10 values for them instead of 11 each.
const uint SSIM_STRIPS = SSIM_BLOCK / STRIP;
const uint SSIM_WINDOW_OF_STRIP = STRIP + SSIM_TAPS - 1;
