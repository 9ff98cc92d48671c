// Addresses of a Gaussian's parameter planes: see PLANE_ROW in constants.glsl. ScenePlan::place is the same formula on the
// host. The tests compare both with a third one, place in tests/common/layout.rs.

// First vec4 of a chunk in its buffer: see batch.glsl.
#ifndef PARAMETERS_BEGIN
#define PARAMETERS_BEGIN 0
#endif

// Index of a plane of Gaussian `index`. `place` has the first vec4 of the planes stored together, their number, and the plane's
// number among them. ScenePlan::plane_place makes it.
uint place_in(uvec3 place, uint index) {
    return PARAMETERS_BEGIN + place.x + (index / PLANE_ROW * place.y + place.z) * PLANE_ROW + index % PLANE_ROW;
}

// Index of `plane` of Gaussian `index` in a chunk with capacity `gaussians`.
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
    return PARAMETERS_BEGIN + first * gaussians + (row * (end - first) + plane - first) * PLANE_ROW + index % PLANE_ROW;
}

// Same as plane_at with two SH planes in one.
uint half_plane_at(uint plane, uint index, uint gaussians) {
    uint first = 0, end = PLANE_SH;
    if (plane >= PLANE_SH + HALF_SH_PLANES_2) {
        first = PLANE_SH + HALF_SH_PLANES_2;
        end = PLANE_SH + HALF_SH_PLANES_3;
    } else if (plane >= PLANE_SH + HALF_SH_PLANES_1) {
        first = PLANE_SH + HALF_SH_PLANES_1;
        end = PLANE_SH + HALF_SH_PLANES_2;
    } else if (plane >= PLANE_SH + HALF_SH_PLANES_0) {
        first = PLANE_SH + HALF_SH_PLANES_0;
        end = PLANE_SH + HALF_SH_PLANES_1;
    } else if (plane >= PLANE_SH) {
        first = PLANE_SH;
        end = PLANE_SH + HALF_SH_PLANES_0;
    }
    return place_in(uvec3(first * gaussians, end - first, plane - first), index);
}

// Same as plane_at for an SH plane of a scene with SH in bytes: each is stored alone.
uint byte_plane_at(uint plane, uint index, uint gaussians) {
    return place_in(uvec3(plane * gaussians, 1, 0), index);
}

// Same as plane_at, but for a geometry plane. Geometry comes first, so the index does not depend on the chunk's capacity.
uint geometry_at(uint plane, uint index) {
    return plane_at(plane, index, 0);
}
