// A unit cube from its vertex number alone: six faces of two triangles.
#version 460
layout(push_constant) uniform Push { mat4 clip_from_object; };
layout(location = 0) out vec2 uv;
layout(location = 1) out vec3 normal;

void main() {
    uint face = gl_VertexIndex / 6;
    uint corner = uint[](0, 1, 2, 2, 1, 3)[gl_VertexIndex % 6];
    vec2 at = vec2(corner & 1, corner >> 1);
    float side = face % 2 == 0 ? 1.0 : -1.0;
    vec3 p = vec3(2.0 * at - 1.0, side);
    uint axis = face / 2;
    normal = axis == 0 ? vec3(0, 0, side) : axis == 1 ? vec3(side, 0, 0) : vec3(0, side, 0);
    p = axis == 0 ? p : axis == 1 ? p.zxy : p.yzx;
    uv = at;
    gl_Position = clip_from_object * vec4(0.5 * p, 1.0);
}
