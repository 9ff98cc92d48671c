// Division: g = 2 / (1 + sqrt(1 - 4 k s)). Coefficient k.
vec3 division_radial(float s) {
    float k = lens_a.x;
    float root = sqrt(1.0 - 4.0 * k * s);
    float g = 2.0 / (1.0 + root);
    float first = k * g * g / root;
    return vec3(g, first, 2.0 * k * g * (first + k * g / (root * root)) / root);
}

#ifdef DIFFERENTIATES_LENS
void division_backward(float s, vec3 g, float of_g, float of_slope) {
    float k = lens_a.x;
    float root = sqrt(1.0 - 4.0 * k * s);
    // g' = k h(k s), and the derivative of g by k is s h.
    float h = g.x * g.x / root;
    float h_slope = 2.0 * g.x * (h + g.x / (root * root)) / root;
    d_lens.words[0] += of_g * s * h + of_slope * (h + k * s * h_slope);
}
#endif
