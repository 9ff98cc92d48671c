// blend.comp with the inputs and outputs of blend_auxiliary.glsl.
#version 460
#define AUXILIARY
#include "blend.comp"
