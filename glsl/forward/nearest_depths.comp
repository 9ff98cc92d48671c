// Smallest depth of each Gaussian in the cameras that show it, for the size of Mip-Splatting's 3D filter (Yu et al. 2024,
// section 5.1; its compute_3D_filter).
//
// invocation: one Gaussian of a chunk
// in: poses, four vec3 per camera: the rows of R, then t, camera from world (layout of pose_step.comp); bounds, a vec4 per
//     camera: least and largest x/z, least and largest y/z; for fisheyes and panoramas 1, -1, the cosine of the widest angle
//     from the axis, and their depths are distances
// in/out: parameters (PerGaussian planes): log_scale.w is the depth, or 0 if no camera shows the mean; farthest is the bits of
//     the largest depth. Nothing changes if the frame overflowed.
// shared: none; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require

#include "constants.glsl"
#include "buffers.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(constant_id = 1) const uint SUBGROUP_SIZE = 32;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) buffer Parameters { vec4 parameters[]; };
VEC4_READS(1, Bounds, bounds);
UINT_READS(2, State, state);
layout(set = 0, binding = 3, scalar) buffer Farthest { uint farthest[]; };
layout(set = 0, binding = 4, scalar) readonly buffer Poses { vec3 poses[]; };

layout(push_constant, scalar) uniform Push {
    uint count;
    uint cameras_count;
};

#include "dispatch.glsl"
#include "planes.glsl"

const float NONE = 3.4e38;

void main() {
    uint local = linear_invocation();
    bool exists = local < count && UINT_AT(state, STATE_OVERFLOW) == 0;
    uint index = exists ? local : 0;
    vec4 mean = vec4(parameters[geometry_at(PLANE_MEAN_OPACITY, index)].xyz, 1.0);
    float nearest = NONE;
    for (uint camera = 0; camera < cameras_count; ++camera) {
        vec3 t = poses[4 * camera + 3];
        vec3 position = vec3(dot(vec4(poses[4 * camera], t.x), mean), dot(vec4(poses[4 * camera + 1], t.y), mean),
            dot(vec4(poses[4 * camera + 2], t.z), mean));
        vec4 slopes = VEC4_AT(bounds, camera);
        vec2 slope = position.xy / position.z;
        bool by_distance = slopes.x > slopes.y;
        float depth = by_distance ? length(position) : position.z;
        bool inside = by_distance ? position.z >= slopes.z * depth
            : slope.x >= slopes.x && slope.x <= slopes.y && slope.y >= slopes.z && slope.y <= slopes.w;
        nearest = depth > NEAR_PLANE && inside ? min(nearest, depth) : nearest;
    }
    nearest = exists && nearest < NONE ? nearest : 0.0;
    // Positive floats sort like their bits, and a maximum does not depend on the order.
    uint largest = subgroupMax(floatBitsToUint(nearest));
    if (subgroupElect() && largest > 0) {
        atomicMax(farthest[0], largest);
    }
    if (exists) {
        parameters[geometry_at(PLANE_LOG_SCALE, index)].w = nearest;
    }
}
