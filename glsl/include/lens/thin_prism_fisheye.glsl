// Fisheyes of Meta's Project Aria: g = 1 + sum of k_i s^(i + 1). The other terms apply to the radially distorted point.
// Coefficients k0 k1 k2 k3, k4 k5 p0 p1, s0, s1 s2 s3.
vec3 thin_prism_fisheye_radial(float s) {
    vec4 k = lens_a;
    vec2 l = lens_b.xy;
    return vec3(
        1.0 + s * (k.x + s * (k.y + s * (k.z + s * (k.w + s * (l.x + s * l.y))))),
        k.x + s * (2.0 * k.y + s * (3.0 * k.z + s * (4.0 * k.w + s * (5.0 * l.x + s * 6.0 * l.y)))),
        2.0 * k.y + s * (6.0 * k.z + s * (12.0 * k.w + s * (20.0 * l.x + s * 30.0 * l.y))));
}

#ifdef DIFFERENTIATES_LENS
void thin_prism_fisheye_backward(float s, float of_g, float of_slope) {
    [[unroll]] for (uint k = 0; k < 6; ++k) {
        add_polynomial(k, k + 1, s, of_g, of_slope);
    }
}
#endif
