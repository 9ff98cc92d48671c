// Reads the splat of another lane, the same lane for the whole subgroup.
// Needs blending.glsl, BROADCAST, GL_KHR_shader_subgroup_ballot and _shuffle.

// Intel's compiler takes a broadcast for a scalar, a shuffle for a gather. llvmpipe takes a fifth longer for the former.
float lane_value(float value, uint lane) {
    return BROADCAST ? subgroupBroadcast(value, lane) : subgroupShuffle(value, lane);
}

Splat shuffled(Splat splat, uint lane) {
    return Splat(
        vec2(lane_value(splat.mean.x, lane), lane_value(splat.mean.y, lane)),
        vec3(lane_value(splat.form.x, lane), lane_value(splat.form.y, lane), lane_value(splat.form.z, lane)),
        lane_value(splat.opacity, lane),
        vec3(lane_value(splat.rgb.x, lane), lane_value(splat.rgb.y, lane), lane_value(splat.rgb.z, lane)),
        INVERSE_DEPTH || DEPTH_LIMIT ? lane_value(splat.inverse_z, lane) : 0.0,
        INCREMENTAL_EXP ? lane_value(splat.curvature, lane) : 0.0);
}
