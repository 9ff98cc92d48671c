// Subgroup helpers that hold for any subgroup size from 4 to 128.
// Needs SUBGROUP_SIZE.

// Number of ballot words for this subgroup size.
const uint BALLOT_WORDS = (SUBGROUP_SIZE + 31) / 32;
