// Same as blend_shared.comp, with further outputs besides the picture (blend_auxiliary.glsl): the splat of the largest weight
// in each pixel, and the mean motion. Colours and depths have the bits of blend_shared.comp.
//
// invocation, workgroup: same as blend_shared.comp
// in: same as blend_shared.comp; with MOTION motions (PerVisible)
// out: same as blend_shared.comp; PerPixel, with PICK picks, with MOTION motion_sums
// shared: same as blend_shared.comp, with MOTION WORKGROUP_SIZE * 2 words more; any subgroup size (no subgroup operations)
#version 460
#define AUXILIARY
#include "blend_shared.comp"
