// Workgroup counts above the axis limit are dispatched in two dimensions: the linear index undoes that.
uint linear_workgroup() {
    return gl_WorkGroupID.y * gl_NumWorkGroups.x + gl_WorkGroupID.x;
}

uint linear_invocation() {
    return linear_workgroup() * WORKGROUP_SIZE + gl_LocalInvocationID.x;
}
