// Division of a tile within its workgroup. Each subgroup owns a region 8 pixels wide and REGION_HEIGHT high, and each lane owns
// COLUMNS x ROWS pixels of it. A subgroup culls Gaussians only against its own region, so blending needs no barrier. Works for
// any subgroup size from 4 to 128.
// Needs constants.glsl, SUBGROUP_SIZE, REGION_HEIGHT, GL_KHR_shader_subgroup_basic.

#include "region_shape.glsl"

const uint PIXELS = COLUMNS * ROWS;
// Rows of a column, for blending.glsl.
const uint COLUMN_ROWS = ROWS;

// First pixel of a region, and this lane's first pixel in it.
uvec2 region_origin(uvec2 tile, uint region) {
    return tile * TILE_SIZE + uvec2(region % REGIONS_X * REGION_WIDTH, region / REGIONS_X * REGION_HEIGHT);
}

uvec2 lane_offset() {
    return uvec2(gl_SubgroupInvocationID % LANES_X, gl_SubgroupInvocationID / LANES_X * ROWS);
}

// Offset of pixel k of a lane: row k % ROWS of its column k / ROWS. Columns are LANES_X apart, rows are adjacent.
uvec2 pixel_step(uint k) {
    return uvec2(k / ROWS * LANES_X, k % ROWS);
}

// Code for each region of a subgroup that owns several: EACH_REGION(n, DO) is DO(k) for the regions k below n, which is 1, 2 or
// 4. Each region has its own variables, name_0 to name_3, which FOUR_REGIONS declares. An array of arrays would lie in memory
// if the driver does not unroll the loop over it.
#define FOUR_REGIONS(DO) DO(0) DO(1) DO(2) DO(3)
#define EACH_REGION(N, DO) DO(0) if (N > 1) { DO(1) } if (N > 2) { DO(2) DO(3) }

// True if a Gaussian reaches alpha >= 1/255 anywhere in the rectangle of the region's pixel centres. `form` is (a, b, c) of
// log2 exp(power) = a dx^2 + b dx dy + c dy^2. If the mean lies outside, the form is largest on an edge that faces the mean.
// The test is conservative by more than the float32 error: a false hit only costs time.
bool meets_region(vec4 mean2d_extent_px, vec3 form, float opacity, uvec2 origin) {
    vec2 low = vec2(origin) - mean2d_extent_px.xy;
#ifdef LENSES
    float to_middle = 0.5 * float(REGION_WIDTH - 1);
    low.x = to_nearest_turn(low.x + to_middle) - to_middle;
    // Pixels of a region may have different nearest turns.
    if (mean2d_extent_px.z > 0.5 * seam_period - float(REGION_WIDTH)) {
        return true;
    }
#endif
    vec2 high = low + vec2(REGION_WIDTH - 1, REGION_HEIGHT - 1);
    vec2 half_extent = mean2d_extent_px.zw;
    bool boxes_meet = all(lessThanEqual(low, half_extent)) && all(greaterThanEqual(high, -half_extent));
    vec2 near = clamp(vec2(0.0), low, high);
    vec2 on_column = vec2(near.x, clamp(-0.5 * form.y * near.x / form.z, low.y, high.y));
    vec2 on_row = vec2(clamp(-0.5 * form.y * near.y / form.x, low.x, high.x), near.y);
    float column_power = form.x * on_column.x * on_column.x + on_column.y * (form.z * on_column.y + form.y * on_column.x);
    float row_power = form.x * on_row.x * on_row.x + on_row.y * (form.z * on_row.y + form.y * on_row.x);
    float slack = 0.01 - 2e-6 * (form.x * half_extent.x * half_extent.x + form.z * half_extent.y * half_extent.y);
    return boxes_meet && opacity * exp2(max(column_power, row_power) + slack) >= ALPHA_MIN;
}
