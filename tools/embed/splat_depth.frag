// The splats' depth for a host's depth attachment, from expected depth. The depth test keeps the host's own where it is nearer.
//
//   d = a / z + b, or d = a z + b of an orthographic projection (DepthMapping::coefficients)
#version 460
layout(set = 0, binding = 0) uniform sampler2D expected_depth;
layout(push_constant) uniform Push {
    float a;
    float b;
    // 1 if DepthMapping::linear.
    uint linear;
    // DepthTarget::empty.
    float empty;
    // DepthMapping::clear_value: a depth that no surface exceeds.
    float clear_value;
};

void main() {
    float z = texelFetch(expected_depth, ivec2(gl_FragCoord.xy), 0).x;
    float depth = clamp(a * (linear == 1 ? z : 1.0 / z) + b, 0.0, 1.0);
    // `empty` may be NaN, which equals nothing.
    gl_FragDepth = z == empty || !(z > 0.0) ? clear_value : depth;
}
