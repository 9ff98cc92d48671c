// Outputs of the blending kernels besides the picture, in kernels of their own (blend_auxiliary.comp,
// blend_shared_auxiliary.comp). Colours and depths have the bits of the kernels without them.
//
//   with PICK    the splat with the largest weight alpha T, the nearest among equals
//   with MOTION  sum of alpha T m, where m is the splat's motion on the screen (screen_motion.comp)
//   with SURFACE sum of alpha T n, where n is the splat's normal, and the surface's depth: that of the splat behind which T is
//                below SURFACE_TRANSMITTANCE, at the pixel (splat_surfaces.comp)
//
// in, PerVisible: with MOTION motions, with SURFACE splat_surfaces; out, PerPixel: with PICK picks, with MOTION motion_sums, with
//     SURFACE surfaces
//
// A new output is a constant, buffers, members of both structs, and its lines in the functions. Needs buffers.glsl, Splat.

layout(constant_id = 11) const bool PICK = false;
layout(constant_id = 12) const bool MOTION = false;
layout(constant_id = 15) const bool SURFACE = false;
layout(constant_id = 16) const float SURFACE_TRANSMITTANCE = 0.5;

// Per pixel: 1 + index of the splat in the tile's list, 0 for none; bits of its weight.
layout(set = 0, binding = 11, scalar) buffer Picks { uvec2 picks[]; };
// Motion per visible Gaussian, px.
VEC2_READS(12, Motions, motions);
// Sum of weighted motions per pixel, px.
layout(set = 0, binding = 13, scalar) buffer MotionSums { vec2 motion_sums[]; };
// Per visible Gaussian: normal in the camera's frame; slope of its depth, world units per px, as two half floats.
VEC4_READS(14, SplatSurfaces, splat_surfaces);
// Per pixel: sum of weighted normals, in the camera's frame; depth of the surface, world units, 0 without one.
layout(set = 0, binding = 15, scalar) buffer Surfaces { vec4 surfaces[]; };

// Values of a splat besides those of its record, and true if there are any.
struct SplatExtra {
    vec2 motion;
    vec4 surface;
};
#define HAS_SPLAT_EXTRA (MOTION || SURFACE)

// State of a pixel besides its colour and depth.
struct PixelExtra {
    // Largest weight, and index of its splat.
    float heaviest;
    uint picked;
    // Sum of weighted motions.
    vec2 motion;
    // Sum of weighted normals, depth of the surface.
    vec4 surface;
};

SplatExtra splat_extra(uint visible) {
    return SplatExtra(
        MOTION ? VEC2_AT(motions, visible) : vec2(0.0), SURFACE ? VEC4_AT(splat_surfaces, visible) : vec4(0.0));
}

// Values of another lane's splat. Needs splat_shuffle.glsl.
#define HANDED_EXTRA(own, lane) \
    SplatExtra( \
        MOTION ? vec2(lane_value(own.motion.x, lane), lane_value(own.motion.y, lane)) : vec2(0.0), \
        SURFACE ? vec4(lane_value(own.surface.x, lane), lane_value(own.surface.y, lane), \
                       lane_value(own.surface.z, lane), lane_value(own.surface.w, lane)) \
                : vec4(0.0))

PixelExtra fresh_extra() {
    return PixelExtra(0.0, 0, vec2(0.0), vec4(0.0));
}

// `transmittance` is that behind the splat; its sign has no meaning here. `px` is the pixel.
void note_splat(
    float weight, float transmittance, Splat splat, SplatExtra extra, vec2 px, uint place, inout PixelExtra pixel
) {
    if (PICK) {
        bool heavier = weight > pixel.heaviest;
        pixel.heaviest = heavier ? weight : pixel.heaviest;
        pixel.picked = heavier ? place : pixel.picked;
    }
    if (MOTION) {
        pixel.motion += weight * extra.motion;
    }
    if (SURFACE) {
        pixel.surface.xyz += weight * extra.surface.xyz;
        bool is_surface = abs(transmittance) < SURFACE_TRANSMITTANCE && pixel.surface.w == 0.0;
        vec2 slope = unpackHalf2x16(floatBitsToUint(extra.surface.w));
        float depth = 1.0 / splat.inverse_z + dot(slope, px - splat.mean);
        pixel.surface.w = is_surface ? max(depth, NEAR_PLANE) : pixel.surface.w;
    }
}

void load_extra(uint index, inout PixelExtra pixel) {
    if (PICK) {
        uvec2 before = picks[index];
        pixel.picked = before.x;
        pixel.heaviest = uintBitsToFloat(before.y);
    }
    if (MOTION) {
        pixel.motion = motion_sums[index];
    }
    if (SURFACE) {
        pixel.surface = surfaces[index];
    }
}

void store_extra(uint index, PixelExtra pixel) {
    if (PICK) {
        picks[index] = uvec2(pixel.picked, floatBitsToUint(pixel.heaviest));
    }
    if (MOTION) {
        motion_sums[index] = pixel.motion;
    }
    if (SURFACE) {
        surfaces[index] = pixel.surface;
    }
}
