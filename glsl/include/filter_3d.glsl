// Mip-Splatting's 3D filter (Yu et al. 2024, section 5.1): convolves a Gaussian with one of standard deviation log_scale.w,
// world units. All values follow from the ratio of its scales to that deviation. The ratio neither overflows nor vanishes,
// unlike the squares.

vec3 filter_ratio(vec4 log_scale) {
    return exp(log_scale.xyz) / log_scale.w;
}

// Factor of the opacity.
float filter_shrink(vec3 ratio) {
    vec3 inverse = inversesqrt(1.0 + ratio * ratio);
    return ratio.x * ratio.y * ratio.z * inverse.x * inverse.y * inverse.z;
}
