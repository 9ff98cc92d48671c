// Gradient of the SH planes of one Gaussian: dL/dsh[k] = Y_k(direction) dL/dcolour. It is recomputed, not stored.
// Needs sh.glsl, constants.glsl.

// Plane `plane` (0 to 2) of a group, from the group's basis functions. Cheap only if `plane` is a compile-time constant.
vec4 sh_plane_gradient(uint plane, vec4 basis, vec3 d_color) {
    vec4 g;
    for (uint c = 0; c < 4; ++c) {
        uint f = 4 * plane + c;
        g[c] = basis[f / 3] * d_color[f % 3];
    }
    return g;
}
