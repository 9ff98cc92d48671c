// Sum over a workgroup, in a fixed order: of each subgroup, then over the subgroups.
// Needs WORKGROUP_SIZE, SUBGROUP_SIZE.

shared vec2 subgroup_sums[WORKGROUP_SIZE / SUBGROUP_SIZE];

// All invocations of the workgroup must call it. The first one receives `start` plus the sum of all values.
vec2 workgroup_sum(vec2 value, vec2 start) {
    value = subgroupAdd(value);
    if (gl_SubgroupInvocationID == 0) {
        subgroup_sums[gl_SubgroupID] = value;
    }
    barrier();
    if (gl_LocalInvocationID.x == 0) {
        for (uint k = 0; k < WORKGROUP_SIZE / SUBGROUP_SIZE; ++k) {
            start += subgroup_sums[k];
        }
    }
    return start;
}
