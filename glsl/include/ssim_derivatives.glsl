// SSIM's derivatives of a channel in the room of three planes, see ssim_planes.glsl: those by the mean and by the square of
// a column side by side, in the first two, and those by the product in the third. There column x is at BY_PRODUCT + x,
// so that pairs of columns begin at an even place.
// Needs ssim_sweep.glsl.

const uint BY_PRODUCT = 8;

// Texels of a row, in the first two planes and in the third, that hold the derivatives around a strip.
const uint MEAN_SQUARE_TEXELS = SWEEP_ROW / 2;
const uint PRODUCT_TEXELS = (BY_PRODUCT - SSIM_RADIUS + SWEEP_ROW + 3) / 4;

// The places, in pairs, of column c of the strip, which must be even for a pair of products.
uint mean_square_pair(Sweep sweep, uint plane, uint c, uint y) {
    uint at = uint(sweep.first.x) + SSIM_RADIUS + c;
    return 2 * (plane_texel(plane, at / 2) + y * GROUP_TEXELS) + at % 2;
}

uint product_pair(Sweep sweep, uint plane, uint c, uint y) {
    uint at = uint(sweep.first.x) + BY_PRODUCT + c;
    return 2 * (plane_texel(plane + 2, at / 4) + y * GROUP_TEXELS) + at / 2 % 2;
}
