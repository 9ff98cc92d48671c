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
