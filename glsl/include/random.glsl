// Counter-based random numbers: a value depends only on its key, not on scheduling.

// PCG-4D (Jarzynski and Olano, "Hash Functions for GPU Rendering", JCGT 2020).
uvec4 pcg4d(uvec4 v) {
    v = v * 1664525u + 1013904223u;
    v.x += v.y * v.w;
    v.y += v.z * v.x;
    v.z += v.x * v.y;
    v.w += v.y * v.z;
    v ^= v >> 16;
    v.x += v.y * v.w;
    v.y += v.z * v.x;
    v.z += v.x * v.y;
    v.w += v.y * v.z;
    return v;
}

// Three standard normal numbers (Box and Muller 1958) for a key.
vec3 random_normal(uvec4 key) {
    uvec4 bits = pcg4d(key);
    // In (0, 1], because the logarithm must exist.
    vec4 uniform_01 = (vec4(bits >> 8) + 1.0) / 16777216.0;
    vec2 radius = sqrt(-2.0 * log(uniform_01.xz));
    vec2 angle = 6.283185307179586 * uniform_01.yw;
    return vec3(radius.x * cos(angle.x), radius.x * sin(angle.x), radius.y * cos(angle.y));
}
