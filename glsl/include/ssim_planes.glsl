// Pictures as planes of one channel each, four columns in a texel: a texel costs a processor as much as a value, and what
// a sweep reads of a row is few texels. Column x is at SSIM_RADIUS + x, so that a strip with what is windowed into it
// begins at the first column of a texel. A plane is cut into groups of columns, each row by row, so that who goes down a
// strip goes on in memory.
// Needs image_height, `groups`: how many make a plane.

const uint GROUP_TEXELS = 16;

// Where texel `column` of the first row of a plane lies.
uint plane_texel(uint plane, uint column) {
    return (plane * groups + column / GROUP_TEXELS) * image_height * GROUP_TEXELS + column % GROUP_TEXELS;
}

// Two values that are written at once: a store is a loop over the lanes, whatever it stores.
uint64_t pair(float first, float second) {
    return packUint2x32(floatBitsToUint(vec2(first, second)));
}
