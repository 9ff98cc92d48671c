// Sorts few keys with a single subgroup, in one dispatch. On a processor, the twelve dispatches of the serial sort cost more
// time than a second core saves.
//
// Each pass works like sort_upsweep_serial and sort_downsweep_serial, with as many runs as lanes.
//
// invocation: a run of ceil(n / lanes) keys in every pass; workgroup: one, a single subgroup
// in/out: keys_a[n], values_a[n], n = counts[count_index], in fours; the passes alternate between them and keys_b[n],
//         values_b[n]; after an even number of passes the result is in a
// scratch: run_counts: 2^digit_bits words (at least 4) per lane, in fours
// shared: none; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_control_flow_attributes : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#extension GL_KHR_shader_subgroup_shuffle : require

layout(constant_id = 0) const uint WORKGROUP_SIZE = 32;
layout(constant_id = 1) const uint SUBGROUP_SIZE = 32;
// The values are the keys' indices (0, 1, 2, ...), and the first pass does not read `values_a`.
layout(constant_id = 3) const bool IDENTITY_VALUES = false;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) readonly buffer Counts { uint counts[]; };
layout(set = 0, binding = 1, scalar) coherent buffer KeysA { uvec4 keys_a[]; };
layout(set = 0, binding = 2, scalar) coherent buffer ValuesA { uvec4 values_a[]; };
layout(set = 0, binding = 3, scalar) coherent buffer KeysB { uvec4 keys_b[]; };
layout(set = 0, binding = 4, scalar) coherent buffer ValuesB { uvec4 values_b[]; };
layout(set = 0, binding = 5, scalar) coherent buffer RunCounts { uvec4 run_counts[]; };

layout(push_constant, scalar) uniform Push {
    uint count_index;
    uint digit_bits;
    uint passes;
};

// Number of groups of four digits.
uint quads;
// Start of this lane's histogram.
uint row;

void synchronize() {
    subgroupMemoryBarrierBuffer();
    subgroupBarrier();
}

void clear_counts() {
    for (uint quad = 0; quad < quads; ++quad) {
        run_counts[row + quad] = uvec4(0);
    }
}

void count_digit(uint digit) {
    run_counts[row + digit / 4][digit % 4] += 1;
}

uint take_place(uint digit) {
    uint place = run_counts[row + digit / 4][digit % 4];
    run_counts[row + digit / 4][digit % 4] = place + 1;
    return place;
}

// Turns the counts into the output index of each run's next key: after all lower digits, and within a digit after earlier runs.
void place_runs() {
    uint carry = 0;
    for (uint low = 0; low < quads; low += SUBGROUP_SIZE) {
        uint quad = low + gl_SubgroupInvocationID;
        uint runs = quad < quads ? SUBGROUP_SIZE : 0;
        uvec4 total = uvec4(0);
        for (uint run = 0; run < runs; ++run) {
            total += run_counts[run * quads + quad];
        }
        uint sum = total.x + total.y + total.z + total.w;
        uint inclusive = carry + subgroupInclusiveAdd(sum);
        carry = subgroupShuffle(inclusive, SUBGROUP_SIZE - 1);
        uvec4 next = inclusive - sum + uvec4(0, total.x, total.x + total.y, total.x + total.y + total.z);
        for (uint run = 0; run < runs; ++run) {
            uint at = run * quads + quad;
            uvec4 count = run_counts[at];
            run_counts[at] = next;
            next += count;
        }
    }
}

// A macro, because a buffer cannot be a function's parameter. The last run may end inside a group of four keys.
#define SORT_PASS(keys, values, sorted_keys, sorted_values, made_up)                            \
    clear_counts();                                                                             \
    for (uint four = first / 4; four < end / 4; ++four) {                                       \
        uvec4 digits = (keys[four] >> shift) & mask;                                            \
        count_digit(digits.x);                                                                  \
        count_digit(digits.y);                                                                  \
        count_digit(digits.z);                                                                  \
        count_digit(digits.w);                                                                  \
    }                                                                                           \
    for (uint index = max(end / 4 * 4, first); index < end; ++index) {                          \
        count_digit((keys[index / 4][index % 4] >> shift) & mask);                              \
    }                                                                                           \
    synchronize();                                                                              \
    place_runs();                                                                               \
    synchronize();                                                                              \
    for (uint four = first / 4; four < end / 4; ++four) {                                       \
        uvec4 key = keys[four];                                                                 \
        uvec4 value = made_up ? four * 4 + uvec4(0, 1, 2, 3) : values[four];                    \
        [[unroll]] for (uint k = 0; k < 4; ++k) {                                               \
            uint place = take_place((key[k] >> shift) & mask);                                  \
            sorted_keys[place / 4][place % 4] = key[k];                                         \
            sorted_values[place / 4][place % 4] = value[k];                                     \
        }                                                                                       \
    }                                                                                           \
    for (uint index = max(end / 4 * 4, first); index < end; ++index) {                          \
        uint key = keys[index / 4][index % 4];                                                  \
        uint place = take_place((key >> shift) & mask);                                         \
        sorted_keys[place / 4][place % 4] = key;                                                \
        sorted_values[place / 4][place % 4] = made_up ? index : values[index / 4][index % 4];   \
    }                                                                                           \
    synchronize();

void main() {
    uint n = counts[count_index];
    uint mask = (1u << digit_bits) - 1;
    quads = max(mask + 1, 4) / 4;
    row = gl_SubgroupInvocationID * quads;
    uint length = (n / (4 * SUBGROUP_SIZE) + 1) * 4;
    uint first = min(gl_SubgroupInvocationID * length, n);
    uint end = min(first + length, n);
    for (uint pass = 0; pass < passes; pass += 2) {
        uint shift = pass * digit_bits;
        bool positions = IDENTITY_VALUES && pass == 0;
        SORT_PASS(keys_a, values_a, keys_b, values_b, positions)
        if (pass + 1 < passes) {
            shift += digit_bits;
            SORT_PASS(keys_b, values_b, keys_a, values_a, false)
        }
    }
}
