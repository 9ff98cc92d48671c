// Gradient of the loss with respect to a camera's pose. Adds the sums of project_backward in a fixed order, and converts them
// to the parameters of the pose.
//
// The pose of image i is T = exp(xi^) T_i from world to camera, xi = (nu, omega). With g = dL/d(delta) of exp(delta^) T at
// delta = 0 the gradient is dL/d(xi) = J_l(xi)^T g, with the left Jacobian of SE(3): J_l = sum of ad^k / (k + 1)!,
// ad = [omega^, nu^; 0, omega^] (Barfoot 2017, section 7.1.5).
//
// invocation: every WORKGROUP_SIZE-th partial sum; one workgroup in all
// in: pose_sums, two vec3 per subgroup of visible Gaussians; pose_parameters, two vec3 per image: nu, omega
// out: pose_gradient = g, then dL/d(xi): (nu, omega) of each
// shared: two vec3 per subgroup; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(constant_id = 1) const uint SUBGROUP_SIZE = 32;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) readonly buffer PoseSums { vec3 pose_sums[]; };
layout(set = 0, binding = 1, scalar) readonly buffer PoseParameters { vec3 pose_parameters[]; };
layout(set = 0, binding = 2, scalar) writeonly buffer PoseGradient { vec3 pose_gradient[]; };

layout(push_constant, scalar) uniform Push {
    // Number of partial sums.
    uint sums;
    uint image;
};

// The next term is below float32 for turns of up to half a circle.
const uint TERMS = 18;

shared vec3 moved_sums[WORKGROUP_SIZE / SUBGROUP_SIZE];
shared vec3 turned_sums[WORKGROUP_SIZE / SUBGROUP_SIZE];

void main() {
    vec3 moved = vec3(0.0);
    vec3 turned = vec3(0.0);
    for (uint at = gl_LocalInvocationID.x; at < sums; at += WORKGROUP_SIZE) {
        moved += pose_sums[2 * at];
        turned += pose_sums[2 * at + 1];
    }
    moved = subgroupAdd(moved);
    turned = subgroupAdd(turned);
    if (gl_SubgroupInvocationID == 0) {
        moved_sums[gl_SubgroupID] = moved;
        turned_sums[gl_SubgroupID] = turned;
    }
    barrier();
    if (gl_LocalInvocationID.x == 0) {
        moved = vec3(0.0);
        turned = vec3(0.0);
        for (uint k = 0; k < WORKGROUP_SIZE / SUBGROUP_SIZE; ++k) {
            moved += moved_sums[k];
            turned += turned_sums[k];
        }
        pose_gradient[0] = moved;
        pose_gradient[1] = turned;
        vec3 nu = pose_parameters[2 * image];
        vec3 omega = pose_parameters[2 * image + 1];
        vec3 term_moved = moved;
        vec3 term_turned = turned;
        for (uint k = 2; k < TERMS + 2; ++k) {
            // Applies ad^T to the last term.
            term_turned = -(cross(nu, term_moved) + cross(omega, term_turned)) / float(k);
            term_moved = -cross(omega, term_moved) / float(k);
            moved += term_moved;
            turned += term_turned;
        }
        pose_gradient[2] = moved;
        pose_gradient[3] = turned;
    }
}
