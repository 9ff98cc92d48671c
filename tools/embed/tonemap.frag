// Linear light as a display shows it: with a shoulder in place of a cut at 1. The format of the target encodes it.
#version 460
layout(set = 0, binding = 0) uniform sampler2D picture;
layout(location = 0) out vec4 color;

void main() {
    vec3 light = texelFetch(picture, ivec2(gl_FragCoord.xy), 0).rgb;
    // Up to 0.8 as it is: what splats show of a photograph was tone-mapped by the camera already.
    vec3 shoulder = 1.0 - 0.04 / (max(light, 0.8) - 0.6);
    color = vec4(mix(light, shoulder, greaterThan(light, vec3(0.8))), 1.0);
}
