// Exposure of a photograph (the reference's 3 x 4 matrix E): out_c = sum over k of picture_k E[k][c] + E[c][3]. Row k of E
// is matrices[3 * matrix + k]. Pictures have the layout of blending for the loss: with STRIPS three planes in
// strips (strips.glsl), composited; otherwise per pixel the colour without background and the transmittance.
// Needs constants.glsl, strips.glsl, STRIPS, the buffer `rendered`, and the push constant `background`.

vec3 rendered_color(uint index, uvec2 at) {
    vec3 color;
    if (STRIPS) {
        for (uint plane = 0; plane < 3; ++plane) {
            color[plane] = rendered[strip_value(plane, at)];
        }
    } else {
        color = vec3(rendered[4 * index], rendered[4 * index + 1], rendered[4 * index + 2]);
        color += rendered[4 * index + 3] * background;
    }
    return color;
}
