// Backward pass of the projection: from the sums of a Gaussian's instances to the gradients of its parameters (paper,
// appendix A; the exact derivative of project.comp, including the Jacobian's clamp).
//
// invocation: one visible Gaussian; subgroup: adds the instances of a Gaussian with many tiles together, over the lanes in a
// fixed order, so that results do not depend on scheduling
// in: parameters (PerGaussian planes), visible_ranges, visible_list, footprints, first_instances, conic_opacity,
//      instance_gradients_a, instance_gradients_b, instance_gradients_c, with ABSOLUTE instance_gradients_d
// out: gradients, PerVisible planes: (d mean, d opacity logit), d quaternion, (d log-scale, dL/dx px),
//      (d colour before its clamp at 0, dL/dy px)
// in/out: statistics[Gaussian] += (norm of dL/d(mean2d) in NDC, 1) if `accumulate` is set, nothing overflowed
//         and the norm is finite; with ABSOLUTE the norm of the sums of |dL/d(mean2d)|, and both norms must be finite
// out, with POSE_GRADIENT: pose_sums[subgroup] = sums of dL/d(nu), dL/d(omega) over the subgroup's Gaussians. They are dL/d(delta)
//         at delta = 0 of the pose exp(delta^) T, delta = (nu, omega), T from world to camera. A turn about the camera's centre
//         keeps the directions of the colours. Gaussians with a contribution that is not finite are excluded. With a rolling
//         shutter T is the pose halfway, and its motion stays the same in the camera's own space.
// out, with LENS_GRADIENT: from pose_sums[first_lens_sum] on, a row per workgroup: sums of the gradient of the lens's parameters
//         (lens_gradient.glsl)
// shared: with LENS_GRADIENT a value per subgroup and parameter; subgroup sizes 4 to 128
#version 460
#extension GL_EXT_control_flow_attributes : require
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#extension GL_KHR_shader_subgroup_ballot : require
#extension GL_KHR_shader_subgroup_shuffle : require

#include "constants.glsl"
#include "buffers.glsl"
#include "sh_storage.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 128;
layout(constant_id = 1) const uint SUBGROUP_SIZE = 32;
layout(constant_id = 2) const uint SH_DEGREE = 3;
// A Gaussian with more instances is summed by its whole subgroup.
layout(constant_id = 3) const uint LANE_INSTANCES = 64;
// True if the statistics have the absolute gradients of the 2D mean.
layout(constant_id = 4) const bool ABSOLUTE = false;
// True if the camera's pose has a gradient.
layout(constant_id = 6) const bool POSE_GRADIENT = false;
// True if Gaussians have a 3D filter: see project_gaussian.glsl.
layout(constant_id = 5) const bool FILTER_3D = false;
// True if the dilation differs from DILATION_PX2. That value is a constant, because a driver may compute with constants in
// another order, and the bits of training would change.
layout(constant_id = 7) const bool OWN_DILATION = false;
// Same as in project.comp.
layout(constant_id = 8) const bool DROPOUT = false;
layout(constant_id = 9) const bool Z_RECORD = false;
// True if loops over SH coefficients stay loops (see sh.glsl), and if cheap values are recomputed instead of kept in registers.
layout(constant_id = 10) const bool SH_LOOPS = false;
// Projection of the camera: see pinhole.glsl.
layout(constant_id = 11) const uint PROJECTION = PROJECTION_PERSPECTIVE;
// Storage of the scene's SH coefficients: see sh_storage.glsl.
layout(constant_id = 12) const uint SH_STORAGE = 0;
#ifdef LENSES
// True if the parameters of a lens have gradients.
layout(constant_id = 13) const bool LENS_GRADIENT = false;
// True for a rolling shutter: see shutter.glsl.
layout(constant_id = 14) const bool SHUTTER = false;
#endif
layout(local_size_x_id = 0) in;

VEC4_READS(0, Parameters, parameters);
layout(set = 0, binding = 1, scalar) readonly buffer State { uint state[]; };
UINT_READS(2, VisibleList, visible_list);
UVEC4_READS(3, Footprints, footprints);
UINT_READS(4, FirstInstances, first_instances);
VEC4_READS(5, ConicOpacity, conic_opacity);
VEC4_READS(6, InstanceGradientsA, instance_gradients_a);
VEC4_READS(7, InstanceGradientsB, instance_gradients_b);
VEC2_READS(8, InstanceGradientsC, instance_gradients_c);
layout(set = 0, binding = 10, scalar) buffer Statistics { vec2 statistics[]; };
UVEC4_READS(11, VisibleRanges, visible_ranges);
layout(set = 0, binding = 9, scalar) writeonly buffer Gradients { vec4 gradients[]; };
// Only used with ABSOLUTE.
VEC2_READS(12, InstanceGradientsD, instance_gradients_d);
layout(set = 0, binding = 13, scalar) writeonly buffer PoseSums { vec3 pose_sums[]; };

layout(push_constant, scalar) uniform Push {
    // First Gaussian of the bound parameter range, and capacity of the range.
    uint first;
    uint chunk_gaussians;
    // Same as in project.comp.
    uint antialias;
    uint splat_stride;
    // Stride of the gradient planes; nonzero to update the statistics.
    uint gradient_stride;
    uint accumulate;
#ifdef LENSES
    uint first_lens_sum;
#endif
#include "shutter_push.glsl"
};

#include "camera_block.glsl"
#include "dispatch.glsl"
#include "planes.glsl"
#include "splat_record.glsl"
#include "subgroup.glsl"
#include "filter_3d.glsl"
#define DIFFERENTIATES_LENS
#include "project_gaussian.glsl"
#include "sh.glsl"
#include "sh_planes.glsl"

struct Sums {
    vec4 a;
    vec4 b;
    vec2 c;
    vec2 absolute;
};

Sums no_sums() {
    return Sums(vec4(0.0), vec4(0.0), vec2(0.0), vec2(0.0));
}

void add_instance(inout Sums sums, uint at) {
    sums.a += VEC4_AT(instance_gradients_a, at);
    sums.b += VEC4_AT(instance_gradients_b, at);
    sums.c += VEC2_AT(instance_gradients_c, at);
    if (ABSOLUTE) {
        sums.absolute += VEC2_AT(instance_gradients_d, at);
    }
}

Sums subgroup_sum(Sums sums) {
    vec2 absolute = ABSOLUTE ? subgroupAdd(sums.absolute) : vec2(0.0);
    return Sums(subgroupAdd(sums.a), subgroupAdd(sums.b), subgroupAdd(sums.c), absolute);
}

Sums sum_instances(uint begin, uint count, bool exists) {
    Sums sums = no_sums();
    uint alone = count <= LANE_INSTANCES ? count : 0;
    for (uint k = 0; k < alone; ++k) {
        add_instance(sums, begin + k);
    }
    uvec4 large = subgroupBallot(exists && count > LANE_INSTANCES);
    for (uint word = 0; word < BALLOT_WORDS; ++word) {
        uint bits = large[word];
        while (bits != 0) {
            uint lane = findLSB(bits) + 32 * word;
            bits &= bits - 1;
            uint their_begin = subgroupShuffle(begin, lane);
            uint their_count = subgroupShuffle(count, lane);
            Sums share = no_sums();
            for (uint k = gl_SubgroupInvocationID; k < their_count; k += SUBGROUP_SIZE) {
                add_instance(share, their_begin + k);
            }
            share = subgroup_sum(share);
            if (gl_SubgroupInvocationID == lane) {
                sums = share;
            }
        }
    }
    return sums;
}

// Gradient of the rows of M, from that of the dilated covariance.
void covariance_backward(ProjectedGaussian p, vec3 d_conic, float d_opacity, float opacity_raw, out vec3 d_row_x,
    out vec3 d_row_y) {
    // The conic is (c, -b, a) / det for the covariance (a, b, c). The determinant's form does not cancel along the major axis
    // of an elongated Gaussian, unlike the equal form -conic d_conic conic.
    vec3 cov = p.cov2d;
    // Divides twice, because the square of the determinant may overflow.
    float s = (cov.z * d_conic.x - cov.y * d_conic.y + cov.x * d_conic.z) / p.det / p.det;
    float d_xx = d_conic.z / p.det - s * cov.z;
    float d_xy = s * cov.y - 0.5 * d_conic.y / p.det;
    float d_yy = d_conic.x / p.det - s * cov.x;
    float ratio = p.det_raw / p.det;
    bool through_ratio = (antialias & (ANTIALIAS_COMPENSATED | ANTIALIAS_DETACHED)) == ANTIALIAS_COMPENSATED;
    if (through_ratio && ratio > ANTIALIAS_MIN_RATIO) {
        // opacity = raw sqrt(det_raw / det).
        float d_ratio = d_opacity * opacity_raw * 0.5 * inversesqrt(ratio);
        vec3 raw = p.cov2d - vec3(SCREEN_DILATION_PX2, 0.0, SCREEN_DILATION_PX2);
        d_xx += d_ratio * (raw.z - ratio * p.cov2d.z) / p.det;
        d_yy += d_ratio * (raw.x - ratio * p.cov2d.x) / p.det;
        d_xy += d_ratio * (ratio - 1.0) * p.cov2d.y / p.det;
    }
    d_row_x = 2.0 * (d_xx * p.row_x + d_xy * p.row_y);
    d_row_y = 2.0 * (d_xy * p.row_x + d_yy * p.row_y);
}

#include "quaternion_gradient.glsl"

// Gradient of the raw quaternion from that of the axes in camera space.
vec4 axes_backward(ProjectedGaussian p, mat3 d_axes) {
    mat3 d_rotation = mat3(from_camera(d_axes[0]), from_camera(d_axes[1]), from_camera(d_axes[2]));
    return quaternion_backward(p.quat, p.inverse_norm, d_rotation);
}

// With SH_LOOPS the coefficients become four products before the derivatives are computed, so both never occupy registers at
// once.
void add_direction_gradient(uint group, uint index, vec3 direction, vec3 d_color, inout vec3 d_direction) {
    vec3 derivative[4];
    vec3 sh[4];
    if (SH_LOOPS) {
        sh_coefficient_group(group, index, sh);
        vec4 along = vec4(dot(sh[0], d_color), dot(sh[1], d_color), dot(sh[2], d_color), dot(sh[3], d_color));
        sh_derivative_group(group, direction, derivative);
        [[unroll]] for (uint k = 0; k < 4; ++k) {
            d_direction += derivative[k] * along[k];
        }
    } else {
        sh_derivative_group(group, direction, derivative);
        sh_coefficient_group(group, index, sh);
        [[unroll]] for (uint k = 0; k < 4; ++k) {
            d_direction += derivative[k] * dot(sh[k], d_color);
        }
    }
}

// Gradient of the direction of a colour. With SH_LOOPS the coefficients are read again, from the cache, because keeping them
// takes 48 registers.
vec3 sh_direction_gradient(uint index, vec3 direction, vec3 d_color) {
    vec3 d_direction = vec3(0.0);
#define ADD_DIRECTION_GRADIENT(GROUP) add_direction_gradient(GROUP, index, direction, d_color, d_direction)
    EACH_SH_GROUP(SH_GROUPS, ADD_DIRECTION_GRADIENT)
    return d_direction;
}

bool all_finite(vec3 v) {
    return is_finite(v.x) && is_finite(v.y) && is_finite(v.z);
}

// The subgroup that begins at this visible Gaussian writes its sums to its own place among the subgroups of all Gaussians. The
// visible Gaussians of a range never outnumber the Gaussians of the range.
void write_pose_sums(vec3 d_moved, vec3 d_turned, bool exists, uint end) {
    bool counts = exists && all_finite(d_moved) && all_finite(d_turned);
    vec3 moved = subgroupAdd(counts ? d_moved : vec3(0.0));
    vec3 turned = subgroupAdd(counts ? d_turned : vec3(0.0));
    uint begin = linear_workgroup() * WORKGROUP_SIZE + gl_SubgroupID * SUBGROUP_SIZE;
    if (gl_SubgroupInvocationID == 0 && begin < end) {
        uint at = (first + begin) / SUBGROUP_SIZE;
        pose_sums[2 * at] = moved;
        pose_sums[2 * at + 1] = turned;
    }
}

#ifdef LENSES
shared float lens_partial_sums[LENS_SUMS * (WORKGROUP_SIZE / SUBGROUP_SIZE)];

// Same as write_pose_sums, for a whole workgroup, with the gradient of the mean (world).
void write_lens_sums(vec3 d_mean, bool exists, uint end) {
    const uint own_sums = LENS_WORDS + 7;
    float values[own_sums];
    values[0] = d_lens.focal.x;
    values[1] = d_lens.focal.y;
    values[2] = d_lens.center.x;
    values[3] = d_lens.center.y;
    bool counts = exists;
    [[unroll]] for (uint k = 0; k < LENS_WORDS; ++k) {
        values[4 + k] = d_lens.words[k];
    }
    [[unroll]] for (uint axis = 0; axis < 3; ++axis) {
        values[LENS_WORDS + 4 + axis] = d_mean[axis];
    }
    [[unroll]] for (uint k = 0; k < own_sums; ++k) {
        counts = counts && is_finite(values[k]);
    }
    const uint subgroups = WORKGROUP_SIZE / SUBGROUP_SIZE;
    [[unroll]] for (uint k = 0; k < LENS_SUMS; ++k) {
        float sum = subgroupAdd(counts && k < own_sums ? values[min(k, own_sums - 1)] : 0.0);
        if (gl_SubgroupInvocationID == 0) {
            lens_partial_sums[k * subgroups + gl_SubgroupID] = sum;
        }
    }
    barrier();
    uint begin = linear_workgroup() * WORKGROUP_SIZE;
    // There may be fewer invocations than parameters.
    for (uint k = gl_LocalInvocationID.x; k < LENS_SUMS / 3 && begin < end; k += WORKGROUP_SIZE) {
        vec3 sum = vec3(0.0);
        for (uint subgroup = 0; subgroup < subgroups; ++subgroup) {
            for (uint axis = 0; axis < 3; ++axis) {
                sum[axis] += lens_partial_sums[(3 * k + axis) * subgroups + subgroup];
            }
        }
        pose_sums[first_lens_sum + LENS_SUMS / 3 * ((first + begin) / WORKGROUP_SIZE) + k] = sum;
    }
}
#endif

void main() {
    // A workgroup has the size of a culling block.
    uvec4 visible_range = UVEC4_AT(visible_ranges, 2 * (first / WORKGROUP_SIZE) + 1);
    uint visible = visible_range.x + linear_invocation();
    bool exists = visible < visible_range.y;
    uint clamped_visible = exists ? visible : visible_range.x;
    uint gaussian = UINT_AT(visible_list, clamped_visible);
    uint index = exists ? gaussian - first : 0;
    uint instances = exists ? UVEC4_AT(footprints, splat_at(clamped_visible, SPLAT_FOOTPRINT)).w : 0;
    // Instances beyond the capacity do not exist. The frame has then overflowed and will be repeated.
    uint begin = instances == 0 ? 0 : UINT_AT(first_instances, clamped_visible);
    instances = state[STATE_OVERFLOW] != 0 ? 0 : instances;
    Sums sums = sum_instances(begin, instances, exists);

    vec4 mean_opacity = VEC4_AT(parameters, plane_at(PLANE_MEAN_OPACITY, index, chunk_gaussians));
    // Gradient of the colour through the clamp at 0, then through the direction.
    vec3 towards = mean_opacity.xyz - POSITION_SEEING(mean_opacity.xyz);
    float inverse_distance = inversesqrt(dot(towards, towards));
    vec3 direction = towards * inverse_distance;
    vec3 d_color = mix(vec3(sums.b.z, sums.b.w, sums.c.x), vec3(0.0), lessThan(sh_color(index, direction), vec3(0.0)));
    vec3 d_direction = sh_direction_gradient(index, direction, d_color);
    vec3 d_towards = (d_direction - direction * dot(direction, d_direction)) * inverse_distance;

    vec4 quat = VEC4_AT(parameters, plane_at(PLANE_QUAT, index, chunk_gaussians));
    vec4 log_scale = VEC4_AT(parameters, plane_at(PLANE_LOG_SCALE, index, chunk_gaussians));
    vec4 conic = VEC4_AT(conic_opacity, splat_at(clamped_visible, SPLAT_CONIC_OPACITY));
    Filtered filtered = filter_3d(log_scale, mean_opacity.w);
    ProjectedGaussian p = project_gaussian(mean_opacity.xyz, quat, filtered.log_scale);

#ifdef LENSES
    d_lens = LensGradient(vec2(0.0), vec2(0.0), float[LENS_WORDS](0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0));
#endif
    // Converts moments to gradients of mean, conic and opacity.
    float m_1 = sums.a.x, m_x = sums.a.y, m_y = sums.a.z, m_xx = sums.a.w, m_xy = sums.b.x, m_yy = sums.b.y;
    float d_inverse_z = sums.c.y;
    vec2 d_mean2d = -vec2(conic.x * m_x + conic.y * m_y, conic.y * m_x + conic.z * m_y);
    vec3 d_conic = vec3(-0.5 * m_xx, -m_xy, -0.5 * m_yy);
    float d_opacity = m_1 / max(conic.w, 1e-20);
    if (DROPOUT) {
        // Converts to the opacity before the factor.
        d_opacity *= dropout_factor;
    }

    float opacity_raw = opacity_of(filtered.opacity_logit);
    bool compensated = (antialias & ANTIALIAS_COMPENSATED) != 0;
    float compensation = compensated ? sqrt(max(ANTIALIAS_MIN_RATIO, p.det_raw / p.det)) : 1.0;
    float d_logit = d_opacity * compensation * opacity_raw * (1.0 - opacity_raw);

    vec3 d_row_x;
    vec3 d_row_y;
    covariance_backward(p, d_conic, d_opacity, opacity_raw, d_row_x, d_row_y);
    vec3 d_log_scale = d_row_x * p.row_x + d_row_y * p.row_y;
#ifdef LENSES
    SpreadGradient d_points = SpreadGradient(vec3(0.0), mat3(0.0), vec3(0.0));
    if (p.spread.valid) {
        // The other members enter the covariance like the rows.
        Spread d = Spread(true, d_row_x, d_row_y, vec3(0.0), vec3(0.0), vec2(0.0));
        ProjectedGaussian other = p;
        other.row_x = p.spread.bend_x;
        other.row_y = p.spread.bend_y;
        covariance_backward(other, d_conic, d_opacity, opacity_raw, d.bend_x, d.bend_y);
        other.row_x = vec3(p.spread.shift.x, 0.0, 0.0);
        other.row_y = vec3(p.spread.shift.y, 0.0, 0.0);
        vec3 d_shift_x;
        vec3 d_shift_y;
        covariance_backward(other, d_conic, d_opacity, opacity_raw, d_shift_x, d_shift_y);
        d.shift = vec2(d_shift_x.x, d_shift_y.x);
        d_points = spread_backward(p.mean_halfway, p.axes_halfway, p.scale, d_mean2d, d);
        d_log_scale = d_points.log_scale;
    }
#endif
    if (FILTER_3D && log_scale.w > 0.0) {
        // Converts from the filtered parameters to the stored ones. The filter's size is constant.
        vec3 ratio = filter_ratio(log_scale);
        vec3 share = 1.0 / (1.0 + ratio * ratio);
        float d_opacity_filtered = d_opacity * compensation;
        d_log_scale = d_log_scale * (1.0 - share) + d_opacity_filtered * opacity_raw * share;
        float stored = opacity_of(mean_opacity.w);
        d_logit = d_opacity_filtered * filtered.shrink * stored * (1.0 - stored);
    }

    if (SH_LOOPS) {
        // Recomputes the axes and derived values instead of keeping them: 16 registers. The bound holds for every index. It
        // hides from the compiler that this is the same quaternion.
        quat = VEC4_AT(parameters, plane_at(PLANE_QUAT, min(index, chunk_gaussians), chunk_gaussians));
        p = project_gaussian(mean_opacity.xyz, quat, filtered.log_scale);
    }
    // The rows of M are J times the scaled axes.
    d_row_x *= p.scale;
    d_row_y *= p.scale;
    mat3 d_axes;
    JacobianGradient d_jacobian = jacobian_rows_backward(p.jacobian, p.axes_camera, d_row_x, d_row_y, d_axes);
#ifdef LENSES
    d_axes = turned_columns(d_axes, -p.time);
    if (p.spread.valid) {
        d_axes = d_points.axes;
    }
#endif
    vec4 d_quat;
    if (!SH_LOOPS) {
        d_quat = axes_backward(p, d_axes);
    }

    vec3 d_camera = jacobian_backward(PROJECTION, p.jacobian, p.mean_camera, d_mean2d, d_jacobian);
#ifdef LENSES
    d_camera = turned(d_camera, -p.time);
    if (p.spread.valid) {
        d_camera = d_points.point;
    } else if (LENS_GRADIENT) {
        add_lens_position(p.mean_camera, d_mean2d);
        add_lens_jacobian(p.mean_camera, p.jacobian, d_jacobian);
    }
#endif
    // The blended depth is 1/z or z. This is its gradient towards the camera.
    float inverse_z = 1.0 / DEPTH_OF(p.mean_camera);
    SUBTRACT_DEPTH_GRADIENT(d_camera, p, Z_RECORD ? -d_inverse_z : inverse_z * inverse_z * d_inverse_z);
    vec3 d_mean = from_camera(d_camera);

    d_mean += d_towards;
#ifdef LENSES
    if (LENS_GRADIENT) {
        write_lens_sums(d_mean, exists, visible_range.y - visible_range.x);
    }
#endif

    if (POSE_GRADIENT) {
#ifdef LENSES
        p.mean_camera = p.mean_halfway;
        p.axes_camera = p.axes_halfway;
#endif
        vec3 d_turned = cross(p.mean_camera, d_camera);
        for (uint axis = 0; axis < 3; ++axis) {
            d_turned += cross(p.axes_camera[axis], d_axes[axis]);
        }
#ifdef LENSES
        if (SHUTTER) {
            // The centre of the camera that reads the mean turns with the camera halfway.
            d_turned += cross(p.time * shutter_shift, to_camera(d_towards));
        }
#endif
        write_pose_sums(d_camera + to_camera(d_towards), d_turned, exists, visible_range.y - visible_range.x);
    }
    if (SH_LOOPS) {
        // Comes after the pose, which is the last user of the axes.
        d_quat = axes_backward(p, d_axes);
    }
    if (exists) {
        gradients[GRADIENT_MEAN_OPACITY * gradient_stride + visible] = vec4(d_mean, d_logit);
        gradients[GRADIENT_QUAT * gradient_stride + visible] = d_quat;
        gradients[GRADIENT_LOG_SCALE * gradient_stride + visible] = vec4(d_log_scale, d_mean2d.x);
        gradients[GRADIENT_COLOR * gradient_stride + visible] = vec4(d_color, d_mean2d.y);
        if (accumulate != 0 && state[STATE_OVERFLOW] == 0) {
            vec2 ndc = d_mean2d * 0.5 * vec2(whole_width, whole_height);
            float norm = length(ndc);
            float absolute_norm = ABSOLUTE ? length(sums.absolute * 0.5 * vec2(whole_width, whole_height)) : 0.0;
            // A norm that is not finite would spoil the statistics permanently, so it is skipped.
            bool counts = is_finite(norm) && is_finite(absolute_norm);
            statistics[gaussian] += counts ? vec2(ABSOLUTE ? absolute_norm : norm, 1.0) : vec2(0.0);
        }
    }
}
