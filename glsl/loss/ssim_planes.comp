// Both pictures as planes of one channel each, as ssim_planes.glsl describes: what sweeps read.
//
// invocation: one texel, four columns of all channels; subgroup, workgroup: nothing in common
// in, PerPixel: accumulated (r, g, b, T), photo (RGBA8); out, planes: rendered_planes (composited on the background),
//     photo_planes (four bytes to a word); both 0 outside of the picture and where a pixel does not count
// shared: none; any subgroup size; reads texels,
//     writes pairs
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_control_flow_attributes : require
#extension GL_EXT_samplerless_texture_functions : require
#extension GL_EXT_shader_explicit_arithmetic_types_int64 : require
#extension GL_GOOGLE_include_directive : require

layout(constant_id = 0) const uint WORKGROUP_SIZE = 64;
// The photograph is three floats per pixel instead of RGBA8, and its planes are floats too.
layout(constant_id = 3) const bool FLOAT_PHOTO = false;
// The fourth byte of a photograph's pixel is 0 where it does not count.
layout(constant_id = 4) const bool MASKED = false;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0) uniform textureBuffer accumulated;
layout(set = 0, binding = 1) uniform utextureBuffer photo;
layout(set = 0, binding = 2, scalar) writeonly buffer RenderedPlanes { u64vec2 rendered_planes[]; };
layout(set = 0, binding = 3, scalar) writeonly buffer PhotoPlanes { uint photo_planes[]; };

layout(push_constant, scalar) uniform Push {
    uint image_width;
    uint image_height;
    vec3 background;
    // Groups of columns of a plane.
    uint groups;
    // Texels of a row that sweeps read.
    uint columns;
};

#include "ssim.glsl"
#include "ssim_planes.glsl"
#include "dispatch.glsl"

void main() {
    uint invocation = linear_invocation();
    if (invocation >= columns * image_height) {
        return;
    }
    uint row = invocation / columns;
    uint column = invocation - row * columns;
    int first_x = int(column * 4) - int(SSIM_RADIUS);
    mat4x3 rendered;
    uvec3 words[4];
    [[unroll]] for (uint k = 0; k < 4; ++k) {
        int x = first_x + int(k);
        bool inside = x >= 0 && x < int(image_width);
        uint pixel = inside ? row * image_width + uint(x) : 0;
        vec4 value = texelFetch(accumulated, int(pixel));
        if (FLOAT_PHOTO) {
            [[unroll]] for (uint channel = 0; channel < 3; ++channel) {
                words[k][channel] = texelFetch(photo, int(3 * pixel + channel)).x;
            }
        } else {
            uint word = texelFetch(photo, int(pixel)).x;
            words[k] = (uvec3(word) >> uvec3(0, 8, 16)) & 0xFF;
            inside = inside && !(MASKED && word >> 24 == 0);
        }
        rendered[k] = inside ? value.rgb + value.w * background : vec3(0.0);
        words[k] = inside ? words[k] : uvec3(0);
    }
    [[unroll]] for (uint channel = 0; channel < 3; ++channel) {
        uint texel = plane_texel(channel, column) + row * GROUP_TEXELS;
        rendered_planes[texel] =
            u64vec2(pair(rendered[0][channel], rendered[1][channel]), pair(rendered[2][channel], rendered[3][channel]));
        if (FLOAT_PHOTO) {
            [[unroll]] for (uint k = 0; k < 4; ++k) {
                photo_planes[4 * texel + k] = words[k][channel];
            }
        } else {
            photo_planes[texel] = words[0][channel] | words[1][channel] << 8 | words[2][channel] << 16 | words[3][channel] << 24;
        }
    }
}
