// Further outputs of the blending kernels besides the picture, in separate kernels (blend_auxiliary.comp,
// blend_shared_auxiliary.comp):
//
//   with PICK    the splat with the largest weight alpha T, the nearest among equals
//   with MOTION  sum of alpha T m, where m is the splat's motion on the screen (screen_motion.comp)
//
// Needs blending.glsl with AUXILIARY, buffers.glsl, PICK, MOTION.

// Per pixel: 1 + index of the splat in the tile's list, 0 for none; bits of its weight.
layout(set = 0, binding = 11, scalar) buffer Picks { uvec2 picks[]; };
// Motion per visible Gaussian, px.
VEC2_READS(12, Motions, motions);
// Sum of weighted motions per pixel, px.
layout(set = 0, binding = 13, scalar) buffer MotionSums { vec2 motion_sums[]; };

void note_splat(float weight, vec2 motion, uint place, inout Pixel pixel) {
    if (PICK) {
        bool heavier = weight > pixel.heaviest;
        pixel.heaviest = heavier ? weight : pixel.heaviest;
        pixel.picked = heavier ? place : pixel.picked;
    }
    if (MOTION) {
        pixel.motion += weight * motion;
    }
}

void load_auxiliary(uint index, inout Pixel pixel) {
    if (PICK) {
        uvec2 before = picks[index];
        pixel.picked = before.x;
        pixel.heaviest = uintBitsToFloat(before.y);
    }
    if (MOTION) {
        pixel.motion = motion_sums[index];
    }
}

void store_auxiliary(uint index, Pixel pixel) {
    if (PICK) {
        picks[index] = uvec2(pixel.picked, floatBitsToUint(pixel.heaviest));
    }
    if (MOTION) {
        motion_sums[index] = pixel.motion;
    }
}
