// Panoramas: the angles from the z axis around y, and from the plane across y. The focal lengths are pixels per radian.
// Word: sine of the latitude at which the Jacobian is held, half a row from the pole.

vec2 equirectangular_point(vec3 at) {
    return vec2(arctan(at.x, at.z), arctan(at.y, length(at.xz)));
}

// Rows of the Jacobian. The longitude's 1/h^2 is 1/(h h_held).
void equirectangular_rows(vec3 at, float h_held, out vec3 row_x, out vec3 row_y) {
    float h = length(at.xz);
    float inverse_h = 1.0 / h;
    row_x = vec3(at.z, 0.0, -at.x) * (inverse_h / h_held);
    row_y = vec3(-at.x * at.y * inverse_h, h, -at.z * at.y * inverse_h) / dot(at, at);
}

// Gradient of a point from that of the held Jacobian's rows.
vec3 equirectangular_backward(vec3 at, vec3 d_x, vec3 d_y) {
    float h = length(at.xz);
    float d = length(at);
    float held = d * lens_a.x;
    bool is_held = held > h;
    float c = max(h, held);
    float inverse_h = 1.0 / h;
    float inverse_d2 = 1.0 / dot(at, at);
    // row_x . d_x = across / (h c); row_y . d_y = (d_y.y h - y along / h) / d^2.
    float across = d_x.x * at.z - d_x.z * at.x;
    float along = d_y.x * at.x + d_y.z * at.z;
    float of_row_x = across * inverse_h / c;
    float of_row_y = (d_y.y * h - at.y * along * inverse_h) * inverse_d2;
    float d_h = -of_row_x * inverse_h - (is_held ? 0.0 : of_row_x / c) + (d_y.y + at.y * along * inverse_h * inverse_h) * inverse_d2;
    float d_d = -(is_held ? of_row_x / d : 0.0) - 2.0 * of_row_y / d;
    vec3 d_at = vec3(-d_x.z, 0.0, d_x.x) * (inverse_h / c) - vec3(d_y.x * at.y, along, d_y.z * at.y) * (inverse_h * inverse_d2);
    return d_at + vec3(at.x, 0.0, at.z) * (d_h * inverse_h) + at * (d_d / d);
}
