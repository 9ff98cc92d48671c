// Converts a host's depth image into the depth limit of the blending: 1/z of the nearest opaque surface per pixel.
//
//   1/z = scale * d + offset is exact for every perspective projection: standard, reversed or with an infinite far plane;
//   with LINEAR, z = scale * d + offset for every orthographic one
//   (engine/scene/view.rs derives scale and offset from the projection matrix).
//
// invocation: one pixel
// in: depth, a host's depth image; out, PerPixel: depth_limits (1/z; 0 where the image holds its clear value)
// shared: none; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_samplerless_texture_functions : require
#extension GL_GOOGLE_include_directive : require

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
// True if z itself is linear in the depth.
layout(constant_id = 2) const bool LINEAR = false;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) writeonly buffer DepthLimits { float depth_limits[]; };
layout(set = 0, binding = 17) uniform texture2D depth;

layout(push_constant, scalar) uniform Push {
    uint image_width;
    uint image_height;
    // Texel of the depth image that belongs to pixel (0, 0).
    uint offset_x;
    uint offset_y;
    float scale;
    float offset;
    // Clear value of the depth image, which marks a pixel without a surface.
    float clear_value;
};

#include "dispatch.glsl"

const float HIDES_ALL = 3e38;

float limit_of(float value) {
    if (LINEAR) {
        // A surface at the camera hides everything.
        return value > 0.0 ? 1.0 / value : HIDES_ALL;
    }
    return max(value, 0.0);
}

void main() {
    uint index = linear_invocation();
    if (index >= image_width * image_height) {
        return;
    }
    uvec2 at = uvec2(index % image_width, index / image_width);
    float d = texelFetch(depth, ivec2(at + uvec2(offset_x, offset_y)), 0).x;
    depth_limits[index] = d == clear_value ? 0.0 : limit_of(scale * d + offset);
}
