// Indirect arguments for one workgroup per block of elements. Above the axis limit the dispatch is two-dimensional, and
// dispatch.glsl recovers the linear index. Without elements the arguments are all zero.
// Needs `max_workgroups_per_axis`.
uvec4 workgroup_count(uint elements, uint block) {
    uint groups = elements / block + (elements % block != 0 ? 1 : 0);
    uint x = min(groups, max_workgroups_per_axis);
    uint y = x == 0 ? 0 : groups / x + (groups % x != 0 ? 1 : 0);
    return uvec4(x, y, groups == 0 ? 0 : 1, 0);
}
