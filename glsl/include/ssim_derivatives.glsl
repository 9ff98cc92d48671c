// SSIM's derivatives of a channel, in strips: for each pixel of a column those by the mean, the square and the product, side by
// side.
// Needs ssim.glsl, strips.glsl.

const uint DERIVATIVES = 3;
// Texels of a column; the first of them that is windowed into the strip below, and the end of those that are into the one above.
const uint DERIVATIVE_TEXELS = DERIVATIVES * STRIP_ROWS / 4;
const uint FIRST_DERIVATIVE_TEXEL_ABOVE = DERIVATIVES * (STRIP_ROWS - SSIM_RADIUS) / 4;
const uint END_DERIVATIVE_TEXEL_BELOW = (DERIVATIVES * SSIM_RADIUS + 3) / 4;
