// Reads active SH coefficients of one Gaussian from its planes: coefficient k is floats 3 k to 3 k + 2.
// Needs sh.glsl, planes.glsl, `parameters`, `chunk_gaussians`; kernels that read scenes of other storages include sh_storage.glsl and
// have SH_STORAGE.

// Four floats of a Gaussian's coefficients.
vec4 stored_sh_plane(uint plane, uint index) {
#ifdef SH_STORAGES
    if (SH_STORAGE == SH_HALVES) {
        uvec4 pair = floatBitsToUint(VEC4_AT(parameters, half_plane_at(PLANE_SH + plane / 2, index, chunk_gaussians)));
        uvec2 own = plane % 2 == 0 ? pair.xy : pair.zw;
        return vec4(unpackHalf2x16(own.x), unpackHalf2x16(own.y));
    }
    if (SH_STORAGE == SH_BYTES) {
        vec4 base_and_step = VEC4_AT(parameters, byte_plane_at(PLANE_SH, index, chunk_gaussians));
        vec4 value = vec4(0.0);
        if (SH_DEGREE > 0) {
            uint place = byte_plane_at(PLANE_SH + 1 + plane / 4, index, chunk_gaussians);
            int bytes = floatBitsToInt(VEC4_AT(parameters, place)[plane % 4]);
            ivec4 steps = ivec4(bytes << 24, bytes << 16, bytes << 8, bytes) >> 24;
            value = base_and_step.w * vec4(steps);
        }
        return plane == 0 ? vec4(base_and_step.xyz, value.w) : value;
    }
#endif
    return VEC4_AT(parameters, plane_at(PLANE_SH + plane, index, chunk_gaussians));
}

vec4 sh_plane(uint plane, uint index) {
    // Planes above the active degree may not exist, so plane 0 is read and discarded instead.
    vec4 value = stored_sh_plane(plane < SH_PLANES ? plane : 0, index);
    return plane < SH_PLANES ? value : vec4(0.0);
}

// Coefficients 4 group to 4 group + 3; those above SH_DEGREE are 0, regardless of the stored values.
void sh_coefficient_group(uint group, uint index, out vec3 sh[4]) {
    vec4 a = sh_plane(3 * group, index), b = sh_plane(3 * group + 1, index), c = sh_plane(3 * group + 2, index);
    // At degrees 0 and 2 the last active coefficient shares its plane with the next one.
    a.w = 4 * group + 1 < (SH_DEGREE + 1) * (SH_DEGREE + 1) ? a.w : 0.0;
    sh[0] = a.xyz;
    sh[1] = vec3(a.w, b.xy);
    sh[2] = vec3(b.zw, c.x);
    sh[3] = c.yzw;
}

void add_color(uint group, uint index, vec3 direction, inout vec3 color) {
    vec4 basis = sh_basis_group(group, direction);
    vec3 sh[4];
    sh_coefficient_group(group, index, sh);
    [[unroll]] for (uint k = 0; k < 4; ++k) {
        color += basis[k] * sh[k];
    }
}

// Colour before its clamp at 0, from a unit direction.
vec3 sh_color(uint index, vec3 direction) {
    vec3 color = vec3(0.5);
#define ADD_COLOR(GROUP) add_color(GROUP, index, direction, color)
    EACH_SH_GROUP(SH_GROUPS, ADD_COLOR)
    return color;
}
