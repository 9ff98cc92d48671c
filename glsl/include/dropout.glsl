// Random omission of Gaussians in training frames (DropGaussian, Park et al. 2025, section 3.2). Each is omitted with
// probability dropout_below / 2^24, and the opacities of the others are multiplied by dropout_factor.
// Needs camera_block.glsl and random.glsl.

// Distinguishes these numbers from others with the same seed and iteration.
const uint DROPOUT_STREAM = 6;

bool dropped_out(uint gaussian) {
    return pcg4d(uvec4(dropout_seed, dropout_iteration, gaussian, DROPOUT_STREAM)).x >> 8 < dropout_below;
}
