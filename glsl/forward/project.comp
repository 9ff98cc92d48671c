// Screen-space attributes of the visible Gaussians: mean, conic, extent, tiles, depth, and colour from spherical harmonics
// (paper, section 4; reference preprocessCUDA and computeColorFromSH). With TINTED, colours and opacities have the scene's
// factors. With a parallel projection, colours are evaluated along the camera's z axis. With SHARED_ORDER, the list may have
// Gaussians that only another view shows: they touch no tile.
//
// invocation: one visible Gaussian of the bound parameter range; it loops over its rows of tiles to count its tiles
// in: parameters (PerGaussian planes), visible_list, visible_ranges, with SELECTION selection (a bit per Gaussian); out,
//     PerVisible: mean2d_extent (x, y, half extents, px), conic_opacity (A, B, C, opacity), color_inverse_depth (r, g, b, 1/z,
//     or z with Z_RECORD), depth_keys, footprints and tile_lists (tile_span.glsl)
// shared: none; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_control_flow_attributes : require
#extension GL_GOOGLE_include_directive : require

#include "constants.glsl"
#include "buffers.glsl"
#include "sh_storage.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
// True to order by distance instead of z: see RenderSettings in engine/frame/settings.rs.
layout(constant_id = 1) const bool DISTANCE_ORDER = false;
layout(constant_id = 2) const uint SH_DEGREE = 3;
// True if Gaussians have a 3D filter: see project_gaussian.glsl.
layout(constant_id = 3) const bool FILTER_3D = false;
// True if random Gaussians are omitted: see dropout.glsl.
layout(constant_id = 4) const bool DROPOUT = false;
// True if the blended depth is z instead of 1/z.
layout(constant_id = 5) const bool Z_RECORD = false;
// True if the scene has its own tint or opacity: see camera_block.glsl.
layout(constant_id = 6) const bool TINTED = false;
// True if some Gaussians have another colour: those with a set bit in `selection`.
layout(constant_id = 7) const bool SELECTION = false;
// Projection of the camera: see pinhole.glsl.
layout(constant_id = 8) const uint PROJECTION = PROJECTION_PERSPECTIVE;
layout(constant_id = 9) const bool SH_LOOPS = false;
// True if the list has Gaussians of other views.
layout(constant_id = 10) const bool SHARED_ORDER = false;
// Storage of the scene's SH coefficients: see sh_storage.glsl.
layout(constant_id = 11) const uint SH_STORAGE = 0;
#ifdef LENSES
// True for a rolling shutter: see shutter.glsl.
layout(constant_id = 12) const bool SHUTTER = false;
#endif
layout(local_size_x_id = 0) in;

VEC4_READS(0, Parameters, parameters);
UVEC4_READS(1, VisibleRanges, visible_ranges);
UINT_READS(2, VisibleList, visible_list);
layout(set = 0, binding = 3, scalar) writeonly buffer Mean2dExtent { vec4 mean2d_extent[]; };
layout(set = 0, binding = 4, scalar) writeonly buffer ConicOpacity { vec4 conic_opacity[]; };
layout(set = 0, binding = 5, scalar) writeonly buffer ColorInverseDepth { vec4 color_inverse_depth[]; };
layout(set = 0, binding = 6, scalar) writeonly buffer DepthKeys { uint depth_keys[]; };
layout(set = 0, binding = 7, scalar) writeonly buffer Footprints { uvec4 footprints[]; };
layout(set = 0, binding = 8, scalar) writeonly buffer TileLists { uvec2 tile_lists[]; };
UINT_READS(9, Selection, selection);

layout(push_constant, scalar) uniform Push {
    // First Gaussian of the bound parameter range, and capacity of the range.
    uint first;
    uint chunk_gaussians;
    // `extent` is EXTENT_EXACT or EXTENT_REFERENCE; `antialias` has ANTIALIAS_ bits.
    uint extent;
    uint antialias;
    uint splat_stride;
    // With SELECTION: index of the range's first Gaussian in its scene.
    uint first_of_scene;
#include "shutter_push.glsl"
};

#define DRAWS_SHAPES
#include "camera_block.glsl"
#include "dispatch.glsl"
#include "planes.glsl"
#include "splat_record.glsl"
#include "tile_span.glsl"
#include "filter_3d.glsl"
#include "project_gaussian.glsl"
#include "sh.glsl"
#include "sh_planes.glsl"

// Bit i % 32 of word i / 32 belongs to the scene's Gaussian i.
vec3 highlighted(vec3 color, uint index) {
    if (SELECTION) {
        uint gaussian = first_of_scene + index;
        bool selected = (UINT_AT(selection, gaussian / 32) >> gaussian % 32 & 1) != 0;
        color = selected ? mix(color, selection_color, selection_share) : color;
    }
    return color;
}

#include "write_splat.glsl"

void main() {
    // A workgroup has the size of a culling block.
    uvec4 visible_range = UVEC4_AT(visible_ranges, 2 * (first / WORKGROUP_SIZE) + 1);
    uint visible = visible_range.x + linear_invocation();
    if (visible >= visible_range.y) {
        return;
    }
    uint index = UINT_AT(visible_list, visible) - first;
    write_splat(visible, index);
}
