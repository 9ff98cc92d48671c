// A photograph with 8 bits per channel at 1 / `factor` of its width and height, in its storage layout. A pixel is the rounded
// mean of a square of `factor` pixels. Columns and rows beyond the last whole square are omitted. With TRANSPARENT the colour
// behind the photograph changes by `background_change`: C' = C + (1 - opacity) change.
//
// invocation: with STRIPS four rows of a column of a plane of the result, otherwise a pixel of it
// in: photo, with STRIPS planes of bytes in strips (strips.glsl): three, and with MASKED a fourth with the coverage; otherwise
//     r | g << 8 | b << 16 | coverage << 24 per pixel. Coverage needs MASKED: 0 for a pixel that does not count; with
//     TRANSPARENT 1 + 254 opacity for all others
// out: reduced, in the same layout, with a coverage of 0 or 255; padding is 0
// shared: none; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(constant_id = 2) const bool STRIPS = false;
layout(constant_id = 3) const bool MASKED = false;
layout(constant_id = 4) const bool TRANSPARENT = false;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) readonly buffer Photo { uint photo[]; };
layout(set = 0, binding = 1, scalar) writeonly buffer Reduced { uint reduced[]; };

// image_width, image_height: size of the photograph. background_change: r, g, b; 1 to replace black by white.
layout(push_constant, scalar) uniform Push {
    uint image_width;
    uint image_height;
    uint factor;
    vec3 background_change;
};

#include "constants.glsl"
#include "dispatch.glsl"
#include "strips.glsl"

uint byte_at(uint plane, uvec2 at) {
    if (!STRIPS) {
        return bitfieldExtract(photo[at.y * image_width + at.x], int(8 * plane), 8);
    }
    uint value = strip_value(plane, at);
    return bitfieldExtract(photo[value / 4], int(8 * (value % 4)), 8);
}

// Mean of the square that begins at `from`. With MASKED a square counts if all of its pixels do: then plane 3 has 255, else all
// planes have 0.
uint mean(uint plane, uvec2 from) {
    uint sum = 0;
    uint opacities = 0;
    bool counts = true;
    for (uint y = from.y; y < from.y + factor; ++y) {
        for (uint x = from.x; x < from.x + factor; ++x) {
            sum += byte_at(plane, uvec2(x, y));
            if (MASKED) {
                uint coverage = byte_at(3, uvec2(x, y));
                counts = counts && coverage != 0;
                opacities += max(coverage, 1) - 1;
            }
        }
    }
    uint squares = factor * factor;
    if (TRANSPARENT && plane < 3) {
        float through = float(squares) - float(opacities) / 254.0;
        float shown = (float(sum) + 255.0 * through * background_change[plane]) / float(squares);
        return counts ? uint(clamp(shown, 0.0, 255.0) + 0.5) : 0;
    }
    uint rounded = MASKED && plane == 3 ? 255 : (sum + squares / 2) / squares;
    return counts ? rounded : 0;
}

void main() {
    uvec2 size = uvec2(image_width, image_height) / factor;
    uint index = linear_invocation();
    uint word = 0;
    if (!STRIPS) {
        if (index >= size.x * size.y) {
            return;
        }
        uvec2 from = factor * uvec2(index % size.x, index / size.x);
        for (uint plane = 0; plane < 4; ++plane) {
            word |= mean(plane, from) << 8 * plane;
        }
        reduced[index] = word;
        return;
    }
    // Strips of the result.
    uint strips = (size.y + STRIP_ROWS - 1) / STRIP_ROWS;
    uint pitch = (size.x + 1) / 4 * 4 + 2;
    uint column = index / (STRIP_ROWS / 4);
    uint strip = column / pitch;
    uint plane = strip / strips;
    if (plane >= (MASKED ? 4 : 3)) {
        return;
    }
    uint x = column % pitch;
    uint first = strip % strips * STRIP_ROWS + index % (STRIP_ROWS / 4) * 4;
    for (uint row = 0; row < 4; ++row) {
        if (x < size.x && first + row < size.y) {
            word |= mean(plane, factor * uvec2(x, first + row)) << 8 * row;
        }
    }
    reduced[index] = word;
}
