// Lanes of a subgroup with equal keys, for any subgroup size from 4 to 128.
// Needs SUBGROUP_SIZE, GL_EXT_control_flow_attributes, GL_KHR_shader_subgroup_ballot and _shuffle.

// Maximum number of bits in a key.
const uint MATCHED_BITS = 8;

// For lanes with `valid`: `peers` is the number of lanes with the same `key`, `below` the number of those below this lane.
// Narrow subgroups compare by shuffles, wide ones by one ballot per bit of the key (multisplit).
void match_key(uint key, uint bits, bool valid, out uint below, out uint peers) {
    if (SUBGROUP_SIZE <= 8) {
        uint tagged = valid ? key : 0xFFFFFFFF;
        below = 0;
        peers = 0;
        for (uint lane = 0; lane < SUBGROUP_SIZE; ++lane) {
            uint same = subgroupShuffle(tagged, lane) == tagged ? 1 : 0;
            peers += same;
            below += lane < gl_SubgroupInvocationID ? same : 0;
        }
    } else if (SUBGROUP_SIZE <= 32) {
        uint match = subgroupBallot(valid).x;
        // A fixed number of rounds unrolls. Bits that no key sets change nothing.
        [[unroll]] for (uint bit = 0; bit < MATCHED_BITS; ++bit) {
            bool set = ((key >> bit) & 1) != 0;
            uint ballot = subgroupBallot(set).x;
            match &= set ? ballot : ~ballot;
        }
        below = bitCount(match & ((1u << gl_SubgroupInvocationID) - 1));
        peers = bitCount(match);
    } else {
        uvec4 match = subgroupBallot(valid);
        for (uint bit = 0; bit < bits; ++bit) {
            bool set = ((key >> bit) & 1) != 0;
            uvec4 ballot = subgroupBallot(set);
            match &= set ? ballot : ~ballot;
        }
        below = subgroupBallotExclusiveBitCount(match);
        peers = subgroupBallotBitCount(match);
    }
}
