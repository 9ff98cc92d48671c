// One step of Adam on all parameters of a Gaussian: see adam.comp.
//
// Needs planes.glsl, sh_gradient.glsl, SH_DEGREE; SH_GRADIENT(plane of a group, the plane's index); buffers moments_1, moments_2, old_moments_1, old_moments_2, and the names of the
// parameters' buffers, OLD_PARAMETERS to read and NEW_PARAMETERS to write; push constants: chunk_gaussians, constants and rates.

void update(uint at, vec4 g, vec4 rate, vec4 inverse_bias) {
    vec4 m = beta_1 * VEC4_AT(old_moments_1, at) + one_minus_beta_1 * g;
    vec4 v = beta_2 * VEC4_AT(old_moments_2, at) + one_minus_beta_2 * g * g;
    VEC4_PUT(moments_1, at, m);
    VEC4_PUT(moments_2, at, v);
    vec4 p = VEC4_AT(OLD_PARAMETERS, at) - rate * (m / (sqrt(v) * inverse_bias + epsilon));
    VEC4_PUT(NEW_PARAMETERS, at, p);
}

void update_group(uint group, uint index, vec3 d_color, vec3 direction) {
    vec4 basis = sh_basis_group(group, direction);
    [[unroll]] for (uint k = 0; k < 3; ++k) {
        uint plane = 3 * group + k;
        vec4 rate = plane == 0 ? vec4(vec3(rate_sh_dc), rate_sh_rest) : vec4(rate_sh_rest);
        uint at = plane_at(PLANE_SH + plane, index, chunk_gaussians);
        if (plane < SH_PLANES) {
            update(at, SH_GRADIENT(k, at), rate, vec4(inverse_bias_2));
        }
    }
}

// `direction`: of the forward pass.
void update_all(uint index, vec4 d_mean_opacity, vec4 d_quat, vec4 d_log_scale, vec3 d_color, vec3 direction) {
    vec4 bias = vec4(inverse_bias_2);
    update(plane_at(PLANE_MEAN_OPACITY, index, chunk_gaussians), d_mean_opacity, vec4(vec3(rate_mean), rate_opacity),
        vec4(bias.xyz, inverse_bias_2_opacity));
    update(plane_at(PLANE_QUAT, index, chunk_gaussians), d_quat, vec4(rate_quat), bias);
    update(plane_at(PLANE_LOG_SCALE, index, chunk_gaussians), d_log_scale, vec4(vec3(rate_log_scale), 0.0), bias);
#define UPDATE_GROUP(GROUP) update_group(GROUP, index, d_color, direction)
    EACH_SH_GROUP(SH_GROUPS, UPDATE_GROUP)
}
