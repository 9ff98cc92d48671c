// Rows of a sort by matching: the histogram has a row of 2^bits digits for each block, then for each group of blocks, then one
// for all. Needs constants.glsl with SORT_ROWS.

uint blocks_per_group(uint blocks) {
    return max((blocks + SORT_GROUPS - 1) / SORT_GROUPS, SORT_GROUP_BLOCKS);
}

uint group_row(uint blocks, uint block) {
    return blocks + block / blocks_per_group(blocks);
}

uint total_row(uint blocks) {
    return group_row(blocks, blocks - 1) + 1;
}
