// Edges of a photograph as the gradient of a picture: responses scaled from 0 (smallest of the photograph) to 1 (largest); 0 if
// all are equal. If they are dL/dred, the gradient of a Gaussian's red is the sum of its weights on edges.
//
// invocation: one pixel
// in: responses (edge_response.comp), ranges (edges.glsl)
// out: image_gradient in blending's layout: with STRIPS three planes (strips.glsl), otherwise a vec4 per pixel: the edge, then zeros
// shared: none; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(constant_id = 2) const bool STRIPS = false;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) readonly buffer Responses { uint responses[]; };
layout(set = 0, binding = 1, scalar) readonly buffer Ranges { uint ranges[]; };
layout(set = 0, binding = 2, scalar) writeonly buffer ImageGradient { float image_gradient[]; };

layout(push_constant, scalar) uniform Push {
    uint image_width;
    uint image_height;
};

#include "constants.glsl"
#include "dispatch.glsl"
#include "edges.glsl"
#include "strips.glsl"

void main() {
    uint index = linear_invocation();
    if (index >= image_width * image_height) {
        return;
    }
    uvec2 at = uvec2(index % image_width, index / image_width);
    uint low = ~ranges[RANGE_EDGE_LOW];
    uint span = ranges[RANGE_EDGE_HIGH] - low;
    float edge = float(responses[index] - low) / float(max(span, 1u));
    if (STRIPS) {
        image_gradient[strip_value(0, at)] = edge;
        image_gradient[strip_value(1, at)] = 0.0;
        image_gradient[strip_value(2, at)] = 0.0;
    } else {
        image_gradient[4 * index] = edge;
        image_gradient[4 * index + 1] = 0.0;
        image_gradient[4 * index + 2] = 0.0;
        image_gradient[4 * index + 3] = 0.0;
    }
}
