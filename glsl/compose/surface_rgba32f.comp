// Writes the surface of each pixel into a host's storage image of format rgba32f: see compose_surface.glsl.
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require

#include "constants.glsl"

#define SURFACE_FORMAT rgba32f
#include "compose_surface.glsl"
