// Fisheyes: g = 1 + k1 s + k2 s^2 + k3 s^3 + k4 s^4. Coefficients k1 k2 p1 p2, k3 k4 sx1 sy1.
vec3 fisheye_radial(float s) {
    vec4 k = vec4(lens_a.xy, lens_b.xy);
    return vec3(
        1.0 + s * (k.x + s * (k.y + s * (k.z + s * k.w))),
        k.x + s * (2.0 * k.y + s * (3.0 * k.z + s * 4.0 * k.w)),
        2.0 * k.y + s * (6.0 * k.z + s * 12.0 * k.w));
}

#ifdef DIFFERENTIATES_LENS
void fisheye_backward(float s, float of_g, float of_slope) {
    add_polynomial(0, 1, s, of_g, of_slope);
    add_polynomial(1, 2, s, of_g, of_slope);
    add_polynomial(4, 3, s, of_g, of_slope);
    add_polynomial(5, 4, s, of_g, of_slope);
}
#endif
