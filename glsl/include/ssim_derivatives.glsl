// SSIM's derivatives of one channel, in strips. Each column holds, one after the other, the derivatives with respect to the
// mean, the square and the product.
// Needs ssim.glsl, strips.glsl.

const uint DERIVATIVES = 3;
// Texels of a column: their number; the first inside the window of the strip below; the end of those inside the window of the
// strip above.
const uint DERIVATIVE_TEXELS = DERIVATIVES * STRIP_ROWS / 4;
const uint FIRST_DERIVATIVE_TEXEL_ABOVE = DERIVATIVES * (STRIP_ROWS - SSIM_RADIUS) / 4;
const uint END_DERIVATIVE_TEXEL_BELOW = (DERIVATIVES * SSIM_RADIUS + 3) / 4;
