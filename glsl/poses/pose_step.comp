// Adam over the poses of all images as one tensor, and the resulting cameras:
//
//   g <- P^T (dL/d(xi) for the image `seen`, 0 for all others, + weight_decay xi)
//   m <- b1 m + (1 - b1) g,  v <- b2 v + (1 - b2) g^2,  xi <- xi - rate / (1 - b1^t) P m / (sqrt(v / (1 - b2^t)) + eps)
//   T = exp(xi^) T_0, from world to camera: R = exp(omega^) R_0, t = exp(omega^) t_0 + V nu,
//   exp(omega^) = I + a omega^ + b omega^ omega^,  V = I + b omega^ + c omega^ omega^,
//   a = sin w / w,  b = (1 - cos w) / w^2,  c = (w - sin w) / w^3,  w = |omega|
//
// P converts steps from turns about a pivot, p = (0, 0, depth) of the camera, to turns about its centre: P (nu, omega) = (s nu
// + p x omega, omega), the adjoint of a displacement. s is the depth, so displacements learn at the rate times the depth. About
// the centre a turn and a displacement look nearly the same, and Adam, which scales each parameter separately, cannot tell them
// apart. Without a pivot (depth 0) P is the identity.
//
// Without `makes_step` only the cameras are computed. A gradient that is not finite counts as 0. If the frame overflowed, nothing
// changes.
//
// invocation: one image
// in: pose_gradient (pose_gradient.comp), pose_starts (four vec3 per image: the rows of R_0, t_0), pose_depths (one per image),
//     state
// in/out: pose_parameters (two vec3 per image: nu, omega), pose_moments (four: m of both, v of both)
// out: pose_cameras (four vec3 per image: the rows of R, t)
// shared: none; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require

#include "constants.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) readonly buffer PoseGradient { vec3 pose_gradient[]; };
layout(set = 0, binding = 1, scalar) readonly buffer PoseStarts { vec3 pose_starts[]; };
layout(set = 0, binding = 2, scalar) buffer PoseParameters { vec3 pose_parameters[]; };
layout(set = 0, binding = 3, scalar) buffer PoseMoments { vec3 pose_moments[]; };
layout(set = 0, binding = 4, scalar) writeonly buffer PoseCameras { vec3 pose_cameras[]; };
layout(set = 0, binding = 5, scalar) readonly buffer State { uint state[]; };
layout(set = 0, binding = 6, scalar) readonly buffer PoseDepths { float pose_depths[]; };

layout(push_constant, scalar) uniform Push {
    uint images;
    // Index of the image with a gradient.
    uint seen;
    // Nonzero to make a step.
    uint makes_step;
    // Divided by 1 - b1^t.
    float rate;
    // 1 / sqrt(1 - b2^t).
    float inverse_bias_2;
    float weight_decay;
};

#include "adam_constants.glsl"
#include "dispatch.glsl"

// Number of terms in the series of a, b and c in w^2. The next is below float32 for turns of up to a circle.
const uint TERMS = 14;

vec3 gradient_of(uint image, uint part) {
    vec3 g = image == seen ? pose_gradient[2 + part] : vec3(0.0);
    uvec3 exponent = floatBitsToUint(g) & 0x7F800000u;
    return all(notEqual(exponent, uvec3(0x7F800000u))) ? g : vec3(0.0);
}

// Step of nu (part 0) or omega (part 1).
vec3 step_of(uint image, uint part, vec3 g) {
    vec3 m = ADAM_BETA_1 * pose_moments[4 * image + part] + ADAM_ONE_MINUS_BETA_1 * g;
    vec3 v = ADAM_BETA_2 * pose_moments[4 * image + 2 + part] + ADAM_ONE_MINUS_BETA_2 * g * g;
    pose_moments[4 * image + part] = m;
    pose_moments[4 * image + 2 + part] = v;
    return rate * (m / (sqrt(v) * inverse_bias_2 + ADAM_EPSILON));
}

// (a, b, c) by their series, which avoid sines, because drivers' sines have 11 bits.
vec3 coefficients(float square) {
    vec3 sum = vec3(1.0);
    for (uint k = TERMS; k > 0; --k) {
        float n = 2.0 * float(k);
        sum = 1.0 - sum * square / vec3(n * (n + 1.0), (n + 1.0) * (n + 2.0), (n + 2.0) * (n + 3.0));
    }
    return sum * vec3(1.0, 0.5, 1.0 / 6.0);
}

void main() {
    uint image = linear_invocation();
    if (image >= images || state[STATE_OVERFLOW] != 0) {
        return;
    }
    vec3 nu = pose_parameters[2 * image];
    vec3 omega = pose_parameters[2 * image + 1];
    if (makes_step != 0) {
        float depth = pose_depths[image];
        vec3 pivot = vec3(0.0, 0.0, depth);
        float scale = depth > 0.0 ? depth : 1.0;
        vec3 of_nu = gradient_of(image, 0) + weight_decay * nu;
        vec3 of_omega = gradient_of(image, 1) + weight_decay * omega;
        vec3 turn = step_of(image, 1, of_omega - cross(pivot, of_nu));
        nu -= scale * step_of(image, 0, of_nu) + cross(pivot, turn);
        omega -= turn;
        pose_parameters[2 * image] = nu;
        pose_parameters[2 * image + 1] = omega;
    }
    vec3 c = coefficients(dot(omega, omega));
    mat3 start_t = mat3(pose_starts[4 * image], pose_starts[4 * image + 1], pose_starts[4 * image + 2]);
    vec3 start = pose_starts[4 * image + 3];
    // Each column of R_0 is a row of `start_t` transposed.
    mat3 columns = transpose(start_t);
    for (uint k = 0; k < 3; ++k) {
        vec3 turned = cross(omega, columns[k]);
        columns[k] += c.x * turned + c.y * cross(omega, turned);
    }
    vec3 turned = cross(omega, start);
    vec3 moved = cross(omega, nu);
    vec3 t = start + c.x * turned + c.y * cross(omega, turned) + nu + c.y * moved + c.z * cross(omega, moved);
    mat3 rows = transpose(columns);
    pose_cameras[4 * image] = rows[0];
    pose_cameras[4 * image + 1] = rows[1];
    pose_cameras[4 * image + 2] = rows[2];
    pose_cameras[4 * image + 3] = t;
}
