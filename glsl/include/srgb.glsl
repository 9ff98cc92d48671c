// Curve of sRGB (IEC 61966-2-1). Below 0 it is odd, and above 1 it continues with the same power.

// Linear light from display-encoded values.
vec3 linear_from_srgb(vec3 encoded) {
    vec3 size = abs(encoded);
    vec3 power = pow((size + 0.055) / 1.055, vec3(2.4));
    return sign(encoded) * mix(power, size / 12.92, lessThanEqual(size, vec3(0.04045)));
}

// Display-encoded values from linear light.
vec3 srgb_from_linear(vec3 light) {
    vec3 size = abs(light);
    vec3 power = 1.055 * pow(size, vec3(1.0 / 2.4)) - 0.055;
    return sign(light) * mix(power, 12.92 * size, lessThanEqual(size, vec3(0.0031308)));
}
