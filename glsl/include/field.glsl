// A field of signed distances to a surface, positive in front of it, in blocks of FIELD_SIDE^3 voxels (engine/surface). A voxel is a
// point of a lattice; voxel `place` of block b lies at (FIELD_SIDE b + place) times the size of a voxel. An edge leads from
// a voxel to the next one along an axis and belongs to the first. Needs constants.glsl.

layout(push_constant, scalar) uniform Push {
    uint voxels;
    // World units.
    float voxel_size;
    // A voxel that fewer views have seen counts as unseen.
    uint least_views;
};

// Per block: the blocks at the offsets (0 or 1, 0 or 1, 0 or 1), x first; NO_BLOCK for a missing one.
layout(set = 0, binding = 0, scalar) readonly buffer Neighbours { uint neighbours[]; };
// Per voxel: mean distance, world units, a float; sum of weights as half float in the low 16 bits, number of views in the high ones.
layout(set = 0, binding = 1, scalar) readonly buffer Distances { uvec2 distances[]; };

float distance_of(uint voxel) {
    return uintBitsToFloat(distances[voxel].x);
}

uvec3 place_in_block(uint voxel) {
    return uvec3(voxel, voxel / FIELD_SIDE, voxel / (FIELD_SIDE * FIELD_SIDE)) % FIELD_SIDE;
}

// The voxel `along` farther, which is 0 or 1 per axis; NO_BLOCK if its block is missing.
uint voxel_beside(uint voxel, uvec3 along) {
    uvec3 place = place_in_block(voxel) + along;
    uvec3 over = place / FIELD_SIDE;
    uint block = neighbours[voxel / FIELD_VOXELS * 8 + over.x + 2 * over.y + 4 * over.z];
    place %= FIELD_SIDE;
    uint beside = block * FIELD_VOXELS + (place.z * FIELD_SIDE + place.y) * FIELD_SIDE + place.x;
    return block == NO_BLOCK ? NO_BLOCK : beside;
}

// Offset of corner 0 to 7 of a cube, x first.
uvec3 corner_offset(uint corner) {
    return uvec3(corner, corner >> 1, corner >> 2) & 1u;
}

// True if a voxel has been seen, and its distance.
bool seen(uint voxel, out float distance) {
    // A driver may load before it tests.
    uint place = voxel == NO_BLOCK ? 0 : voxel;
    distance = distance_of(place);
    return voxel != NO_BLOCK && distances[place].y >> 16 >= max(least_views, 1);
}

// A bit for each axis along which the voxel's edge crosses the surface.
uint crossings_of(uint voxel) {
    float own, other;
    bool own_seen = seen(voxel, own);
    uint crossings = 0;
    for (uint axis = 0; axis < 3; ++axis) {
        bool both_seen = seen(voxel_beside(voxel, corner_offset(1 << axis)), other) && own_seen;
        crossings |= uint(both_seen && (own < 0.0) != (other < 0.0)) << axis;
    }
    return crossings;
}

// Case of the cube whose first corner is a voxel: a bit for each corner behind the surface; 0 if some corner is unseen.
uint case_of(uint voxel) {
    uint inside = 0;
    bool all_seen = true;
    for (uint corner = 0; corner < 8; ++corner) {
        float own;
        all_seen = seen(voxel_beside(voxel, corner_offset(corner)), own) && all_seen;
        inside |= uint(own < 0.0) << corner;
    }
    return all_seen ? inside : 0;
}
