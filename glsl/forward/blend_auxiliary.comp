// Same as blend.comp, with further outputs besides the picture (blend_auxiliary.glsl): the splat of the largest weight in each
// pixel, and the mean motion. Colours and depths have the bits of blend.comp.
//
// invocation, subgroup, workgroup: same as blend.comp
// in: same as blend.comp; with MOTION motions (PerVisible)
// out: same as blend.comp; PerPixel, with PICK picks, with MOTION motion_sums
// shared: see splat_shuffle.glsl; subgroup sizes 4 to 128
#version 460
#define AUXILIARY
#include "blend.comp"
