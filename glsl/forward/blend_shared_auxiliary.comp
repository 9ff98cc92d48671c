// blend_shared.comp with the inputs and outputs of blend_auxiliary.glsl. Shared memory also holds a SplatExtra per invocation.
#version 460
#define AUXILIARY
#include "blend_shared.comp"
