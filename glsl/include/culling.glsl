// Visibility of Gaussians and their number per block, for culling of one scene and of a batch. Needs the requirements of
// project_gaussian.glsl with DRAWS_SHAPES, dropout.glsl and cut_outs.glsl; workgroup_scan.glsl; `chunk_gaussians`, `visible_flags`,
// `block_counts`; and SHARED_ORDER: true if the flags already hold the visible Gaussians of an earlier view.

// Same as CutLimits::keeps (engine/scene/cut.rs), bit for bit: comparisons and one subtraction.
bool kept(vec3 mean, vec3 log_scale, float opacity_logit) {
    precise float log_density = opacity_logit - max(max(log_scale.x, log_scale.y), log_scale.z);
    return all(greaterThanEqual(mean, cut_low)) && all(lessThanEqual(mean, cut_high))
        && opacity_logit >= cut_opacity_logit && log_density >= cut_log_density;
}

// `gaussian` is the index in the frame, `index` that in its range of parameters.
bool is_shown(uint gaussian, uint index, uint first_cut_out, uint cut_out_count) {
    vec4 mean_opacity = VEC4_AT(parameters, plane_at(PLANE_MEAN_OPACITY, index, chunk_gaussians));
    vec4 quat = VEC4_AT(parameters, plane_at(PLANE_QUAT, index, chunk_gaussians));
    vec4 log_scale = VEC4_AT(parameters, plane_at(PLANE_LOG_SCALE, index, chunk_gaussians));
    Filtered filtered = filter_3d(log_scale, mean_opacity.w);
    ProjectedGaussian p = project_gaussian(mean_opacity.xyz, quat, filtered.log_scale);
    Footprint f = footprint_of(p, filtered.opacity_logit);
    bool visible = f.visible && kept(mean_opacity.xyz, log_scale.xyz, mean_opacity.w);
    if (DROPOUT) {
        visible = visible && !dropped_out(gaussian);
    }
    if (CUT_OUTS) {
        visible = visible && kept_by_cut_outs(first_cut_out, cut_out_count, mean_opacity.xyz);
    }
    return visible;
}

// Writes the flag of an index of the frame, if it has one, and the sum of a block's flags. `exists`: true if the index has a
// Gaussian.
void write_flag(uint gaussian, bool has_flag, bool exists, bool visible) {
    // No other invocation reads this flag.
    if (SHARED_ORDER && exists) {
        visible = visible || visible_flags[gaussian] != 0;
    }
    uint flag = exists && visible ? 1 : 0;
    if (has_flag) {
        visible_flags[gaussian] = flag;
    }
    uint total;
    workgroup_exclusive_add(flag, total);
    if (gl_LocalInvocationID.x == 0 && has_flag) {
        block_counts[gaussian / WORKGROUP_SIZE] = total;
    }
}
