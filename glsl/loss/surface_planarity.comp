// Planarity of a picture's surface. A pinhole shows a plane with an inverse depth d that is linear over the picture, so its second
// differences h over `stride_px` pixels are 0, along both axes. The loss is the mean of s^2 / (1 + s^2) over the pixels, with
// s = h / (d SURFACE_BEND). It is bounded, so that its gradient at edges between surfaces is small. The factor 1 / (d (1 - T)) is a constant in
// gradients.
//
// invocation: every (number of invocations)-th pixel; the number of workgroups is TERM_PARTIALS
// in, PerPixel: accumulated (.w = T), surface_depths (surface_depth.comp)
// in/out: image_gradient, dL/d(inverse depth): with STRIPS the fourth plane in strips (strips.glsl), otherwise the fourth component
//     of each pixel
// out: partials[workgroup] = (sum of the losses, 0)
// shared: one vec2 per subgroup; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require

#include "constants.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(constant_id = 1) const uint SUBGROUP_SIZE = 32;
layout(constant_id = 2) const bool STRIPS = false;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) readonly buffer Accumulated { vec4 accumulated[]; };
layout(set = 0, binding = 1, scalar) readonly buffer SurfaceDepths { float surface_depths[]; };
layout(set = 0, binding = 2, scalar) buffer ImageGradient { float image_gradient[]; };
layout(set = 0, binding = 3, scalar) writeonly buffer Partials { vec2 partials[]; };

layout(push_constant, scalar) uniform Push {
    uint image_width;
    uint image_height;
    int stride_px;
    // Weight of a pixel: that of the mean divided by the number of pixels.
    float weight;
};

#include "strips.glsl"
#include "surface_loss.glsl"
#include "workgroup_sum.glsl"

float depth_at(ivec2 at) {
    bool inside = all(greaterThanEqual(at, ivec2(0))) && all(lessThan(at, ivec2(image_width, image_height)));
    return inside ? surface_depths[at.y * image_width + at.x] : 0.0;
}

// Loss of the second difference at a pixel, and its derivative by the difference. Both are 0 without a surface at all three pixels.
vec2 bend(ivec2 at, ivec2 step_px) {
    vec3 d = vec3(depth_at(at - step_px), depth_at(at), depth_at(at + step_px));
    if (any(equal(d, vec3(0.0)))) {
        return vec2(0.0);
    }
    float factor = 1.0 / (d.y * SURFACE_BEND);
    float s = (d.x - 2.0 * d.y + d.z) * factor;
    float bound = 1.0 / (1.0 + s * s);
    return vec2(s * s * bound, 2.0 * s * bound * bound * factor);
}

void main() {
    float sum = 0.0;
    uint pixels_per_turn = TERM_PARTIALS * WORKGROUP_SIZE;
    uint first = gl_WorkGroupID.x * WORKGROUP_SIZE + gl_LocalInvocationID.x;
    for (uint index = first; index < image_width * image_height; index += pixels_per_turn) {
        uvec2 pixel = uvec2(index % image_width, index / image_width);
        ivec2 at = ivec2(pixel);
        float gradient = 0.0;
        for (uint axis = 0; axis < 2; ++axis) {
            ivec2 step_px = axis == 0 ? ivec2(stride_px, 0) : ivec2(0, stride_px);
            vec2 own = bend(at, step_px);
            sum += own.x;
            // The differences that this pixel takes part in.
            gradient += bend(at - step_px, step_px).y - 2.0 * own.y + bend(at + step_px, step_px).y;
        }
        if (gradient != 0.0) {
            float coverage = 1.0 - accumulated[index].w;
            image_gradient[STRIPS ? strip_value(3, pixel) : 4 * index + 3] += weight * gradient / coverage;
        }
    }
    vec2 total = workgroup_sum(vec2(sum, 0.0), vec2(0.0));
    if (gl_LocalInvocationID.x == 0) {
        partials[gl_WorkGroupID.x] = total;
    }
}
