// Writes the surface of each pixel into a host's storage image: its normal, of unit length in the camera's frame (x right, y
// down, z forward), and its depth, world units. Needs constants.glsl and SURFACE_FORMAT.
//
// invocation: one pixel
// in, PerPixel: surfaces (sum of weighted normals; depth of the surface, 0 without one)
// out: target; zeros without a surface
// shared: none; any subgroup size

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) readonly buffer Surfaces { vec4 surfaces[]; };
layout(set = 0, binding = 16, SURFACE_FORMAT) writeonly uniform image2D target;

layout(push_constant, scalar) uniform Push {
    uint image_width;
    uint image_height;
    // Texel of the target that receives pixel (0, 0).
    uint offset_x;
    uint offset_y;
};

#include "dispatch.glsl"

void main() {
    uint index = linear_invocation();
    if (index >= image_width * image_height) {
        return;
    }
    ivec2 at = ivec2(uvec2(index % image_width, index / image_width) + uvec2(offset_x, offset_y));
    vec4 surface = surfaces[index];
    float norm = length(surface.xyz);
    vec3 normal = norm > 0.0 ? surface.xyz / norm : vec3(0.0);
    imageStore(target, at, surface.w > 0.0 ? vec4(normal, surface.w) : vec4(0.0));
}
