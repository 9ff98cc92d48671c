// Reads the splat of another lane.
// Needs blending.glsl and GL_KHR_shader_subgroup_shuffle.

Splat shuffled(Splat splat, uint lane) {
    return Splat(
        vec2(subgroupShuffle(splat.mean.x, lane), subgroupShuffle(splat.mean.y, lane)),
        vec3(subgroupShuffle(splat.form.x, lane), subgroupShuffle(splat.form.y, lane), subgroupShuffle(splat.form.z, lane)),
        subgroupShuffle(splat.opacity, lane),
        vec3(subgroupShuffle(splat.rgb.x, lane), subgroupShuffle(splat.rgb.y, lane), subgroupShuffle(splat.rgb.z, lane)),
        INVERSE_DEPTH || DEPTH_LIMIT ? subgroupShuffle(splat.inverse_z, lane) : 0.0,
        INCREMENTAL_EXP ? subgroupShuffle(splat.curvature, lane) : 0.0);
}
