// Brown's polynomials: g = (1 + k1 s + k2 s^2 + k3 s^3 + n4 s^4) / (1 + k4 s + k5 s^2 + k6 s^3).
// Coefficients k1 k2 p1 p2, k3 k4 k5 k6, n4.
vec3 brown_radial(float s) {
    vec4 k = vec4(lens_a.xy, lens_b.x, lens_c);
    vec3 d = lens_b.yzw;
    float above = 1.0 + s * (k.x + s * (k.y + s * (k.z + s * k.w)));
    float below = 1.0 + s * (d.x + s * (d.y + s * d.z));
    float above_first = k.x + s * (2.0 * k.y + s * (3.0 * k.z + s * 4.0 * k.w));
    float below_first = d.x + s * (2.0 * d.y + s * 3.0 * d.z);
    float g = above / below;
    float first = (above_first - g * below_first) / below;
    float above_second = 2.0 * k.y + s * (6.0 * k.z + s * 12.0 * k.w);
    float below_second = 2.0 * d.y + s * 6.0 * d.z;
    float second = (above_second - 2.0 * first * below_first - g * below_second) / below;
    return vec3(g, first, second);
}

#ifdef DIFFERENTIATES_LENS
void brown_backward(float s, vec3 g, float of_g, float of_slope) {
    vec3 d = lens_b.yzw;
    float below = 1.0 + s * (d.x + s * (d.y + s * d.z));
    float below_slope = d.x + s * (2.0 * d.y + s * 3.0 * d.z);
    // g = A / B, so g' = (A' - g B') / B.
    float of_above = (of_g - of_slope * below_slope / below) / below;
    add_polynomial(0, 1, s, of_above, of_slope / below);
    add_polynomial(1, 2, s, of_above, of_slope / below);
    add_polynomial(4, 3, s, of_above, of_slope / below);
    add_polynomial(8, 4, s, of_above, of_slope / below);
    float of_below = -g.x * of_above - of_slope * g.y / below;
    add_polynomial(5, 1, s, of_below, -of_slope * g.x / below);
    add_polynomial(6, 2, s, of_below, -of_slope * g.x / below);
    add_polynomial(7, 3, s, of_below, -of_slope * g.x / below);
}
#endif
