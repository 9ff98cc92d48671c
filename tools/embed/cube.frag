// The texture under a lamp and ambient light, in linear light.
#version 460
layout(set = 0, binding = 0) uniform sampler2D image;
layout(location = 0) in vec2 uv;
layout(location = 1) in vec3 normal;
layout(location = 0) out vec4 color;

void main() {
    float light = 0.6 + 0.5 * dot(normal, normalize(vec3(0.3, -0.8, -0.5)));
    color = vec4(light * texture(image, uv).rgb, 1.0);
}
