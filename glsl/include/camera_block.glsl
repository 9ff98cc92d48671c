// Uniform block of the kernels that project Gaussians: the camera, and how Gaussians are drawn. Each scene of a frame has a
// block of its own, which engine/forward/camera_block.rs fills.
// Modes that kernels branch on are push constants: for a condition of members and constants alone, llvmpipe 22.3 builds the
// kernel anew at each dispatch (1.3 to 1.7 ms). Elsewhere the members select between two values.
// Frame: x_camera = R x_world + t, x right, y down, z forward; pixel centres are the integers.
layout(set = 0, binding = 18, scalar) uniform CameraBlock {
#include "camera_members.glsl"
};
