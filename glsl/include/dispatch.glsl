// Linear workgroup index: a dispatch above the axis limit is two-dimensional.
uint linear_workgroup() {
    return gl_WorkGroupID.y * gl_NumWorkGroups.x + gl_WorkGroupID.x;
}

uint linear_invocation() {
    return linear_workgroup() * WORKGROUP_SIZE + gl_LocalInvocationID.x;
}
