// Mip-Splatting's 3D filter (Yu et al. 2024, section 5.1): a Gaussian is convolved with one of the standard deviation
// log_scale.w, world units. All of it follows from the ratio of its scales to that, which neither overflows nor vanishes
// where their squares would.

vec3 filter_ratio(vec4 log_scale) {
    return exp(log_scale.xyz) / log_scale.w;
}

// Factor of the opacity.
float filter_shrink(vec3 ratio) {
    vec3 inverse = inversesqrt(1.0 + ratio * ratio);
    return ratio.x * ratio.y * ratio.z * inverse.x * inverse.y * inverse.z;
}
