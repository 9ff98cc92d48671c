// Gradient of the SH planes of one Gaussian: dL/dsh[k] = Y_k(direction) dL/dcolour. It is recomputed, not stored.
// Needs sh.glsl, constants.glsl.

// Floats 4 plane to 4 plane + 3 of the coefficients' gradient. Cheap only if `plane` is a compile-time constant.
vec4 sh_plane_gradient(uint plane, float basis[16], vec3 d_color) {
    vec4 g;
    for (uint c = 0; c < 4; ++c) {
        uint f = 4 * plane + c;
        g[c] = f / 3 < 16 ? basis[min(f / 3, 15)] * d_color[f % 3] : 0.0;
    }
    return g;
}
