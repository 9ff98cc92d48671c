// Division: g = 2 / (1 + sqrt(1 - 4 k s)). Coefficient k.
vec3 division_radial(float s) {
    float k = lens_a.x;
    float root = sqrt(1.0 - 4.0 * k * s);
    float g = 2.0 / (1.0 + root);
    float first = k * g * g / root;
    return vec3(g, first, 2.0 * k * g * (first + k * g / (root * root)) / root);
}
