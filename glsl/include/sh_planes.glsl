// Reads the active SH coefficients of one Gaussian from its planes: coefficient k is floats 3 k to 3 k + 2.
// Needs sh.glsl, planes.glsl, `parameters`, `chunk_gaussians`.

vec4 sh_plane(uint plane, uint index) {
    // Planes above the active degree may not exist: read plane 0 instead, and discard it.
    vec4 value = VEC4_AT(parameters, plane_at(PLANE_SH + (plane < SH_PLANES ? plane : 0), index, chunk_gaussians));
    return plane < SH_PLANES ? value : vec4(0.0);
}

void sh_coefficients(uint index, out vec3 sh[16]) {
    vec4 a = sh_plane(0, index);
    sh[0] = a.xyz;
    if (SH_DEGREE >= 1) {
        vec4 b = sh_plane(1, index), c = sh_plane(2, index);
        sh[1] = vec3(a.w, b.xy);
        sh[2] = vec3(b.zw, c.x);
        sh[3] = c.yzw;
    } else {
        sh[1] = sh[2] = sh[3] = vec3(0.0);
    }
    if (SH_DEGREE >= 2) {
        vec4 d = sh_plane(3, index), e = sh_plane(4, index), f = sh_plane(5, index), g = sh_plane(6, index);
        sh[4] = d.xyz;
        sh[5] = vec3(d.w, e.xy);
        sh[6] = vec3(e.zw, f.x);
        sh[7] = f.yzw;
        sh[8] = g.xyz;
        sh[9] = vec3(g.w, 0.0, 0.0);
    } else {
        sh[4] = sh[5] = sh[6] = sh[7] = sh[8] = sh[9] = vec3(0.0);
    }
    if (SH_DEGREE >= 3) {
        vec4 h = sh_plane(7, index), i = sh_plane(8, index), j = sh_plane(9, index);
        vec4 k = sh_plane(10, index), l = sh_plane(11, index);
        sh[9].yz = h.xy;
        sh[10] = vec3(h.zw, i.x);
        sh[11] = i.yzw;
        sh[12] = j.xyz;
        sh[13] = vec3(j.w, k.xy);
        sh[14] = vec3(k.zw, l.x);
        sh[15] = l.yzw;
    } else {
        sh[9] = sh[10] = sh[11] = sh[12] = sh[13] = sh[14] = sh[15] = vec3(0.0);
    }
}
