// Axes of a camera. pinhole.glsl or lens.glsl map its directions to the picture.
// Needs camera_block.glsl.

vec3 to_camera(vec3 world) {
    return vec3(dot(camera_row_x, world), dot(camera_row_y, world), dot(camera_row_z, world));
}

vec3 from_camera(vec3 v) {
    return camera_row_x * v.x + camera_row_y * v.y + camera_row_z * v.z;
}

vec3 camera_position() {
    // The transpose of a scaled rotation is its inverse times scale^2.
    return -from_camera(camera_translation) * inverse_scale_squared;
}
