// Sums of 3 x 4 values over a workgroup, in a fixed order.
// Needs WORKGROUP_SIZE, SUBGROUP_SIZE.

shared vec4 subgroup_sums[3 * (WORKGROUP_SIZE / SUBGROUP_SIZE)];

// All invocations of the workgroup must call it; all receive the sums.
void add_over_workgroup(inout vec4 values[3]) {
    for (uint k = 0; k < 3; ++k) {
        vec4 sum = subgroupAdd(values[k]);
        if (gl_SubgroupInvocationID == 0) {
            subgroup_sums[3 * gl_SubgroupID + k] = sum;
        }
    }
    barrier();
    for (uint k = 0; k < 3; ++k) {
        values[k] = vec4(0.0);
        for (uint s = 0; s < WORKGROUP_SIZE / SUBGROUP_SIZE; ++s) {
            values[k] += subgroup_sums[3 * s + k];
        }
    }
    // Precedes the next sums.
    barrier();
}
