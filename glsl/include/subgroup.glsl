// Subgroup helpers that hold for any subgroup size from 4 to 128.
// Needs SUBGROUP_SIZE, GL_KHR_shader_subgroup_ballot and _shuffle.

// Number of ballot words for this subgroup size.
const uint BALLOT_WORDS = (SUBGROUP_SIZE + 31) / 32;

// Among lanes with `valid`: `peers` is the number of lanes that hold the same `key`, `below` the number of them below this
// lane. Narrow subgroups compare by shuffles, wide ones by one ballot per bit of the key (multisplit).
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
