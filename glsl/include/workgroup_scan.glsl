// Exclusive prefix sum over the invocations of a workgroup, for any subgroup size.
// Needs WORKGROUP_SIZE, SUBGROUP_SIZE and GL_KHR_shader_subgroup_arithmetic.
// All invocations must call it. It ends with a barrier, so the next call may follow immediately.

shared uint scan_subgroup_sums[WORKGROUP_SIZE / SUBGROUP_SIZE + 1];

uint workgroup_exclusive_add(uint value, out uint total) {
    const uint subgroups = WORKGROUP_SIZE / SUBGROUP_SIZE;
    uint before = subgroupExclusiveAdd(value);
    // A compile-time condition. Omitting the barriers saves time on a processor.
    if (subgroups == 1) {
        total = subgroupAdd(value);
        return before;
    }
    if (gl_SubgroupInvocationID == SUBGROUP_SIZE - 1) {
        scan_subgroup_sums[gl_SubgroupID] = before + value;
    }
    barrier();
    if (gl_SubgroupID == 0) {
        // The subgroups' sums may outnumber the lanes, so the first subgroup loops over them.
        uint carry = 0;
        for (uint first = 0; first < subgroups; first += SUBGROUP_SIZE) {
            uint index = first + gl_SubgroupInvocationID;
            uint sum = index < subgroups ? scan_subgroup_sums[min(index, subgroups - 1)] : 0;
            uint exclusive = subgroupExclusiveAdd(sum) + carry;
            if (index < subgroups) {
                scan_subgroup_sums[index] = exclusive;
            }
            carry += subgroupAdd(sum);
        }
        if (gl_SubgroupInvocationID == 0) {
            scan_subgroup_sums[subgroups] = carry;
        }
    }
    barrier();
    uint result = before + scan_subgroup_sums[gl_SubgroupID];
    total = scan_subgroup_sums[subgroups];
    barrier();
    return result;
}
