// Regions of a tile, one per subgroup, and pixels of a lane: see tile_region.glsl.
// Needs constants.glsl, SUBGROUP_SIZE, REGION_HEIGHT: 4, 8 or 16, at least an eighth of the subgroup.

const uint REGION_WIDTH = 8;
const uint REGIONS_X = TILE_SIZE / REGION_WIDTH;
const uint REGIONS = REGIONS_X * (TILE_SIZE / REGION_HEIGHT);
// Number of lanes side by side in a row, and shape of a lane's pixels.
const uint LANES_X = SUBGROUP_SIZE < REGION_WIDTH ? SUBGROUP_SIZE : REGION_WIDTH;
const uint LANES_Y = SUBGROUP_SIZE / LANES_X;
const uint COLUMNS = REGION_WIDTH / LANES_X;
const uint ROWS = REGION_HEIGHT / LANES_Y;
