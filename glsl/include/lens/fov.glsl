// Field of view (Devernay and Faugeras): g = arctan(2 r tan(omega / 2)) / (r omega).
// Words 2 tan(omega / 2) / omega, 4 tan^2(omega / 2).
vec3 fov_radial(float s) {
    return lens_a.x * arctan_ratio(lens_a.y * s) * vec3(1.0, lens_a.y, lens_a.y * lens_a.y);
}
