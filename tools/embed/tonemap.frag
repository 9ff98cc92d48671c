// Converts linear light for a display: bright values approach 1 gradually. The format of the target encodes the result.
#version 460
layout(set = 0, binding = 0) uniform sampler2D picture;
layout(location = 0) out vec4 color;

void main() {
    vec3 light = texelFetch(picture, ivec2(gl_FragCoord.xy), 0).rgb;
    // Values up to 0.8 stay, because the camera has already tone-mapped the photographs that splats show.
    vec3 shoulder = 1.0 - 0.04 / (max(light, 0.8) - 0.6);
    color = vec4(mix(light, shoulder, greaterThan(light, vec3(0.8))), 1.0);
}
