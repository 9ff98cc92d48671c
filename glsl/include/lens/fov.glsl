// Field of view (Devernay and Faugeras): g = arctan(2 r tan(omega / 2)) / (r omega).
// Words 2 tan(omega / 2) / omega, 4 tan^2(omega / 2).
vec3 fov_radial(float s) {
    return lens_a.x * arctan_ratio(lens_a.y * s) * vec3(1.0, lens_a.y, lens_a.y * lens_a.y);
}

#ifdef DIFFERENTIATES_LENS
void fov_backward(float s, vec3 g, float of_g, float of_slope) {
    // g = a F(b s).
    d_lens.words[0] += (of_g * g.x + of_slope * g.y) / lens_a.x;
    d_lens.words[1] += (of_g * g.y * s + of_slope * (g.y + g.z * s)) / lens_a.y;
}
#endif
