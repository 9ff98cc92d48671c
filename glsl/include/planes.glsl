// Where the planes of a Gaussian lie: see PLANE_ROW in constants.glsl, and ScenePlan::place, which says the same.

// Index of the first plane of geometry of the `index`-th Gaussian of a chunk; the next ones lie PLANE_ROW apart.
uint geometry_at(uint index) {
    return index + index / PLANE_ROW * PLANE_ROW * (PLANE_SH - 1);
}

// Planes of SH that a chunk has, and the Gaussians that it holds: see ScenePlan::layout_word.
uint stored_sh_planes(uint layout_word) {
    return layout_word & 0xFF;
}

uint chunk_gaussians(uint layout_word) {
    return layout_word & ~0xFF;
}

// Index of its first plane of SH; the next ones lie PLANE_ROW apart.
uint sh_at(uint index, uint layout_word) {
    uint row = index / PLANE_ROW * PLANE_ROW;
    return PLANE_SH * chunk_gaussians(layout_word) + index + row * (stored_sh_planes(layout_word) - 1);
}
