// Uniform block of the kernels that project Gaussians: the camera, and the drawing of Gaussians. Each scene of a frame has its
// own block, which engine/frame/camera_block.rs fills.
// Modes that kernels branch on are push constants. If a condition only had members and constants, llvmpipe 22.3 would rebuild
// the kernel at each dispatch (1.3 to 1.7 ms). Elsewhere the members select between two values.
// Frame: x_camera = R x_world + t, x right, y down, z forward; pixel centres are the integers.
layout(set = 0, binding = 18, scalar) uniform CameraBlock {
#include "camera_members.glsl"
#ifdef LENSES
#include "lens_members.glsl"
#endif
};
