// Inverse-depth term of the loss (the reference's depth regularisation): the mean over the picture of |D - M| times its weight
// w. D is the sum of weights / z and M the map. Adds w / pixels * sign(D - M) to the picture's gradient.
//
// invocation: every (number of invocations)-th pixel; the number of workgroups is TERM_PARTIALS
// in, PerPixel: inverse_depth (D), target_map (M; MAP_NOTHING and above: the pixel does not count), both row by row
// in/out: image_gradient, dL/d(inverse depth): with STRIPS the fourth plane in strips (strips.glsl), otherwise the fourth
//     component of each pixel
// out: partials[workgroup] = (sum of |D - M|, 0)
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

layout(set = 0, binding = 0, scalar) readonly buffer InverseDepth { float inverse_depth[]; };
layout(set = 0, binding = 1, scalar) readonly buffer TargetMap { float target_map[]; };
layout(set = 0, binding = 2, scalar) buffer ImageGradient { float image_gradient[]; };
layout(set = 0, binding = 3, scalar) writeonly buffer Partials { vec2 partials[]; };

layout(push_constant, scalar) uniform Push {
    uint image_width;
    uint image_height;
    // Weight of a pixel: that of the mean divided by the number of pixels.
    float weight;
};

#include "strips.glsl"
#include "workgroup_sum.glsl"

void main() {
    float sum = 0.0;
    uint stride = TERM_PARTIALS * WORKGROUP_SIZE;
    uint first = gl_WorkGroupID.x * WORKGROUP_SIZE + gl_LocalInvocationID.x;
    for (uint index = first; index < image_width * image_height; index += stride) {
        float wanted = target_map[index];
        if (wanted < MAP_NOTHING) {
            float difference = inverse_depth[index] - wanted;
            uvec2 at = uvec2(index % image_width, index / image_width);
            image_gradient[STRIPS ? strip_value(3, at) : 4 * index + 3] += weight * sign(difference);
            sum += abs(difference);
        }
    }
    vec2 total = workgroup_sum(vec2(sum, 0.0), vec2(0.0));
    if (gl_LocalInvocationID.x == 0) {
        partials[gl_WorkGroupID.x] = total;
    }
}
