// Gradient of the raw quaternion, through the normalisation, from that of its rotation matrix (columns of `d`).
vec4 quaternion_backward(vec4 q, float inverse_norm, mat3 d) {
    float w = q.x, x = q.y, y = q.z, z = q.w;
    vec4 g;
    g.x = 2.0 * (z * (d[0].y - d[1].x) + y * (d[2].x - d[0].z) + x * (d[1].z - d[2].y));
    g.y = 2.0 * (y * (d[1].x + d[0].y) + z * (d[2].x + d[0].z) + w * (d[1].z - d[2].y) - 2.0 * x * (d[1].y + d[2].z));
    g.z = 2.0 * (x * (d[1].x + d[0].y) + w * (d[2].x - d[0].z) + z * (d[2].y + d[1].z) - 2.0 * y * (d[0].x + d[2].z));
    g.w = 2.0 * (w * (d[0].y - d[1].x) + x * (d[2].x + d[0].z) + y * (d[2].y + d[1].z) - 2.0 * z * (d[0].x + d[1].y));
    return (g - q * dot(q, g)) * inverse_norm;
}
