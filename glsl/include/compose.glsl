// Writes a blended picture into a host's storage image, either replacing the image or composited over it. Each format has
// its own kernel because the format is part of the image's type. Needs constants.glsl and COMPOSE_FORMAT. COMPOSE_LARGEST is
// the format's largest number, where it is below that of the colours.

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) readonly buffer Accumulated { vec4 accumulated[]; };
layout(set = 0, binding = 16, COMPOSE_FORMAT) uniform image2D target;

layout(push_constant, scalar) uniform Push {
    uint image_width;
    uint image_height;
    // Texel of the target that receives pixel (0, 0).
    uint offset_x;
    uint offset_y;
    // COMPOSE_BACKGROUND, COMPOSE_PREMULTIPLIED or COMPOSE_OVER.
    uint mode;
    vec3 background;
};

#include "dispatch.glsl"

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
        behind = imageLoad(target, at);
    }
    vec4 picture = vec4(splats.xyz, 1.0 - transmittance) + transmittance * behind;
#ifdef COMPOSE_LARGEST
    // The format rounds what is larger to infinity.
    picture = min(picture, vec4(COMPOSE_LARGEST));
#endif
    imageStore(target, at, picture);
}
