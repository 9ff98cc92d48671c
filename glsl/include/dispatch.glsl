// A dispatch above the axis limit is two-dimensional; this recovers the linear workgroup index.
uint linear_workgroup() {
    return gl_WorkGroupID.y * gl_NumWorkGroups.x + gl_WorkGroupID.x;
}

uint linear_invocation() {
    return linear_workgroup() * WORKGROUP_SIZE + gl_LocalInvocationID.x;
}
