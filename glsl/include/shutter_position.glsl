// Position of the camera when it reads a Gaussian, for kernels that do not project: their form for lenses is only used with a rolling
// shutter. Needs PROJECTION and the requirements of lens.glsl.

const bool SHUTTER = true;
// The push constants have this name already.
#define camera_position camera_position_of_block
#include "camera.glsl"
#include "lens.glsl"
