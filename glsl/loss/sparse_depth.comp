// Loss of sparse points' depths (gsplat, `depth_loss`): the mean over the points of |1/Z - 1/z| times its weight. Z is the
// expected depth sum(w z) / sum(w) with the blending weights w, bilinear at the point, and 1/z is the point's. If nothing is
// blended, 1/Z counts as 0 and has no gradient.
//
// invocation: every (number of invocations)-th point; the number of workgroups is TERM_PARTIALS
// in: points[point] = (x, y, px; 1/z); PerPixel: accumulated (.w = T, so that sum(w) = 1 - T), depth_sums (sum of w z)
// out: sample_gradients[point] = dL/dZ at the point; partials[workgroup] = (sum of |1/Z - 1/z|, 0)
// shared: one vec2 per subgroup; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require

#include "constants.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(constant_id = 1) const uint SUBGROUP_SIZE = 32;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) readonly buffer Points { vec3 points[]; };
layout(set = 0, binding = 1, scalar) readonly buffer Accumulated { vec4 accumulated[]; };
layout(set = 0, binding = 2, scalar) readonly buffer DepthSums { float depth_sums[]; };
layout(set = 0, binding = 3, scalar) writeonly buffer SampleGradients { float sample_gradients[]; };
layout(set = 0, binding = 4, scalar) writeonly buffer Partials { vec2 partials[]; };

layout(push_constant, scalar) uniform Push {
    uint image_width;
    uint image_height;
    uint count;
    // Weight of a point: that of the mean divided by the number of points.
    float weight;
};

#include "depth_points.glsl"
#include "workgroup_sum.glsl"

void main() {
    float sum = 0.0;
    uint stride = TERM_PARTIALS * WORKGROUP_SIZE;
    for (uint index = gl_WorkGroupID.x * WORKGROUP_SIZE + gl_LocalInvocationID.x; index < count; index += stride) {
        vec3 point = points[index];
        float depth = 0.0;
        for (uint corner = 0; corner < 4; ++corner) {
            uint pixel = corner_pixel(point.xy, corner);
            depth += corner_weight(point.xy, corner) * depth_sums[pixel] / covered(accumulated[pixel].w);
        }
        bool exists = depth > 0.0;
        float inverse = exists ? 1.0 / depth : 0.0;
        float difference = inverse - point.z;
        sample_gradients[index] = exists ? -weight * sign(difference) * inverse * inverse : 0.0;
        sum += abs(difference);
    }
    vec2 total = workgroup_sum(vec2(sum, 0.0), vec2(0.0));
    if (gl_LocalInvocationID.x == 0) {
        partials[gl_WorkGroupID.x] = total;
    }
}
