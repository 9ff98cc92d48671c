// Where the planes of a Gaussian lie: see PLANE_ROW in constants.glsl, and ScenePlan::place, which says the same.

// Index of plane `plane` of the `index`-th Gaussian of a chunk that holds `gaussians`.
uint plane_at(uint plane, uint index, uint gaussians) {
    uint first = 0, end = PLANE_SH;
    if (plane >= PLANE_SH + SH_PLANES_2) {
        first = PLANE_SH + SH_PLANES_2;
        end = PLANE_SH + SH_PLANES_3;
    } else if (plane >= PLANE_SH + SH_PLANES_1) {
        first = PLANE_SH + SH_PLANES_1;
        end = PLANE_SH + SH_PLANES_2;
    } else if (plane >= PLANE_SH + SH_PLANES_0) {
        first = PLANE_SH + SH_PLANES_0;
        end = PLANE_SH + SH_PLANES_1;
    } else if (plane >= PLANE_SH) {
        first = PLANE_SH;
        end = PLANE_SH + SH_PLANES_0;
    }
    uint row = index / PLANE_ROW;
    return first * gaussians + (row * (end - first) + plane - first) * PLANE_ROW + index % PLANE_ROW;
}

// The same of a plane of geometry: they come first, however many Gaussians the chunk holds.
uint geometry_at(uint plane, uint index) {
    return plane_at(plane, index, 0);
}
