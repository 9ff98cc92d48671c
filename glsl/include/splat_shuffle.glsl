// Reads the splat of another lane, the same lane for the whole subgroup.
// Needs blending.glsl, WORKGROUP_SIZE, SUBGROUP_SIZE, BROADCAST, SHARED_SPLATS, GL_KHR_shader_subgroup_ballot and _shuffle.
//
// shared: with SHARED_SPLATS three vec4 per invocation

// With SHARED_SPLATS: number of vec4 per splat.
const uint SPLAT_WORDS = 3;
shared vec4 shared_splats[SHARED_SPLATS ? SPLAT_WORDS * WORKGROUP_SIZE : 1];

// Intel's compiler treats a broadcast as a scalar and a shuffle as a gather. On llvmpipe a broadcast takes a fifth longer.
float lane_value(float value, uint lane) {
    return BROADCAST ? subgroupBroadcast(value, lane) : subgroupShuffle(value, lane);
}

// First word of a lane's splat; its words are SUBGROUP_SIZE apart.
uint shared_place(uint lane) {
    return gl_SubgroupID * SPLAT_WORDS * SUBGROUP_SIZE + lane;
}

// All lanes of a subgroup must call it before they read the splats of a batch. With SHARED_SPLATS it stores them so that a read
// takes four numbers at once. An NVIDIA multiprocessor does as many of those per clock as shuffles of one number.
void share_splat(Splat splat) {
    if (SHARED_SPLATS) {
        uint place = shared_place(gl_SubgroupInvocationID);
        // Other lanes may read the previous batch until now.
        subgroupMemoryBarrierShared();
        subgroupBarrier();
        shared_splats[place] = vec4(splat.mean, splat.form.xy);
        shared_splats[place + SUBGROUP_SIZE] = vec4(splat.form.z, splat.opacity, splat.inverse_z, splat.curvature);
        shared_splats[place + 2 * SUBGROUP_SIZE] = vec4(splat.rgb, 0.0);
        subgroupMemoryBarrierShared();
        subgroupBarrier();
    }
}

#ifdef AUXILIARY
#define READS_DEPTH (INVERSE_DEPTH || DEPTH_LIMIT || SURFACE)
#else
#define READS_DEPTH (INVERSE_DEPTH || DEPTH_LIMIT)
#endif

Splat splat_of_lane(Splat splat, uint lane) {
    if (SHARED_SPLATS) {
        uint place = shared_place(lane);
        vec4 a = shared_splats[place];
        vec4 b = shared_splats[place + SUBGROUP_SIZE];
        vec4 c = shared_splats[place + 2 * SUBGROUP_SIZE];
        return Splat(a.xy, vec3(a.zw, b.x), b.y, c.xyz, b.z, b.w);
    }
    return Splat(
        vec2(lane_value(splat.mean.x, lane), lane_value(splat.mean.y, lane)),
        vec3(lane_value(splat.form.x, lane), lane_value(splat.form.y, lane), lane_value(splat.form.z, lane)),
        lane_value(splat.opacity, lane),
        vec3(lane_value(splat.rgb.x, lane), lane_value(splat.rgb.y, lane), lane_value(splat.rgb.z, lane)),
        READS_DEPTH ? lane_value(splat.inverse_z, lane) : 0.0,
        INCREMENTAL_EXP ? lane_value(splat.curvature, lane) : 0.0);
}
