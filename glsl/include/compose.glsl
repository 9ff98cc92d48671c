// Writes a blended picture into a host's storage image, either replacing the image or composited over it. Each format has its
// own kernel, because the format is part of the image's type. Needs constants.glsl and COMPOSE_FORMAT. COMPOSE_LARGEST is the
// format's largest number, if colours can exceed it. COMPOSE_STEPS is its number of steps between 0 and 1, if it is limited to
// these. If texels are not colours, COMPOSE_IMAGE is the image's type, COMPOSE_LOAD the colour of a texel and COMPOSE_STORE its
// inverse.
//
// Splats are trained and blended in display-encoded values. Linear light is computed from the blended colour:
//
//   background: exposure f(C + T background), opaque: the picture as trained, decoded by the curve f of sRGB
//   else:       a exposure f(C / a) + T below, a = 1 - T: the mean colour that covers the pixel, decoded, and mixed with
//               `below` in linear light, like a host mixes premultiplied colours

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
// COMPOSE_AS_TRAINED, COMPOSE_LINEAR or COMPOSE_LINEAR_IN_SRGB.
layout(constant_id = 2) const uint ENCODING = 0;
layout(local_size_x_id = 0) in;

#ifndef COMPOSE_IMAGE
#define COMPOSE_IMAGE image2D
#endif
#ifndef COMPOSE_LOAD
#define COMPOSE_LOAD(texel) (texel)
#define COMPOSE_STORE(color) (color)
#endif

layout(set = 0, binding = 0, scalar) readonly buffer Accumulated { vec4 accumulated[]; };
layout(set = 0, binding = 16, COMPOSE_FORMAT) uniform COMPOSE_IMAGE target;

layout(push_constant, scalar) uniform Push {
    uint image_width;
    uint image_height;
    // Texel of the target that receives pixel (0, 0).
    uint offset_x;
    uint offset_y;
    // COMPOSE_BACKGROUND, COMPOSE_PREMULTIPLIED or COMPOSE_OVER.
    uint mode;
    vec3 background;
    // Factor of linear light; unused as trained.
    float exposure;
};

#include "dispatch.glsl"
#include "srgb.glsl"

void main() {
    uint index = linear_invocation();
    if (index >= image_width * image_height) {
        return;
    }
    ivec2 at = ivec2(uvec2(index % image_width, index / image_width) + uvec2(offset_x, offset_y));
    vec4 splats = accumulated[index];
    float transmittance = splats.w;
    vec4 behind = vec4(0.0);
    if (mode == COMPOSE_BACKGROUND) {
        behind = vec4(background, 1.0);
    } else if (mode == COMPOSE_OVER) {
        behind = COMPOSE_LOAD(imageLoad(target, at));
    }
    if (ENCODING != COMPOSE_AS_TRAINED && mode != COMPOSE_BACKGROUND) {
        float alpha = 1.0 - transmittance;
        splats.xyz = alpha > 0.0 ? alpha * exposure * linear_from_srgb(splats.xyz / alpha) : vec3(0.0);
        if (ENCODING == COMPOSE_LINEAR_IN_SRGB) {
            behind.xyz = linear_from_srgb(behind.xyz);
        }
    }
    vec4 picture = vec4(splats.xyz, 1.0 - transmittance) + transmittance * behind;
    if (ENCODING != COMPOSE_AS_TRAINED) {
        if (mode == COMPOSE_BACKGROUND) {
            picture.xyz = exposure * linear_from_srgb(picture.xyz);
        }
        if (ENCODING == COMPOSE_LINEAR_IN_SRGB) {
            picture.xyz = srgb_from_linear(picture.xyz);
        }
    }
#ifdef COMPOSE_STEPS
    // A store between two numbers of the format may become either (Vulkan prefers the nearer one): an H200 is off by up to 0.56
    // of their distance.
    picture = floor(clamp(picture, 0.0, 1.0) * COMPOSE_STEPS + 0.5) / COMPOSE_STEPS;
#endif
#ifdef COMPOSE_LARGEST
    // The format rounds larger values to infinity.
    picture = min(picture, vec4(COMPOSE_LARGEST));
#endif
    imageStore(target, at, COMPOSE_STORE(picture));
}
