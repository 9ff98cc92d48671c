// How a workgroup of one tile divides it: each subgroup owns a region 8 pixels wide, 8 high (16 high for subgroups of
// 128), each lane COLUMNS x ROWS of its pixels. A subgroup then culls Gaussians against its own region only, and no
// barrier is needed to blend. Works for any subgroup size from 4 to 128.
// Needs constants.glsl, SUBGROUP_SIZE, GL_KHR_shader_subgroup_basic.

const uint REGION_WIDTH = 8;
const uint REGION_HEIGHT = SUBGROUP_SIZE <= 64 ? 8 : 16;
const uint REGIONS_X = TILE_SIZE / REGION_WIDTH;
const uint REGIONS = REGIONS_X * (TILE_SIZE / REGION_HEIGHT);
// Lanes side by side in a row, and the pixels of one lane.
const uint LANES_X = SUBGROUP_SIZE < REGION_WIDTH ? SUBGROUP_SIZE : REGION_WIDTH;
const uint LANES_Y = SUBGROUP_SIZE / LANES_X;
const uint COLUMNS = REGION_WIDTH / LANES_X;
const uint ROWS = REGION_HEIGHT / LANES_Y;
const uint PIXELS = COLUMNS * ROWS;

// First pixel of this subgroup's region, and this lane's first pixel.
uvec2 region_origin(uvec2 tile) {
    return tile * TILE_SIZE + uvec2(gl_SubgroupID % REGIONS_X * REGION_WIDTH, gl_SubgroupID / REGIONS_X * REGION_HEIGHT);
}

uvec2 lane_offset() {
    return uvec2(gl_SubgroupInvocationID % LANES_X, gl_SubgroupInvocationID / LANES_X);
}

// Pixel k of a lane: column k / ROWS, row k % ROWS, LANES_X and LANES_Y apart.
uvec2 pixel_step(uint k) {
    return uvec2(k / ROWS * LANES_X, k % ROWS * LANES_Y);
}

// Whether the box mean +- half_extent meets the region's pixel centres.
bool meets_region(vec4 mean2d_extent_px, uvec2 origin) {
    vec2 low = vec2(origin);
    vec2 high = low + vec2(REGION_WIDTH - 1, REGION_HEIGHT - 1);
    return all(greaterThanEqual(mean2d_extent_px.xy + mean2d_extent_px.zw, low))
        && all(lessThanEqual(mean2d_extent_px.xy - mean2d_extent_px.zw, high));
}
