// Camera position for the view direction: from the push constants, or from the camera block if the device has moved the camera.
// Needs camera_block.glsl, the push constant `camera_position`, and MOVED_CAMERA.

#define POSITION_SEEING(WORLD) position_of_camera()

vec3 position_of_camera() {
    vec3 t = camera_translation;
    vec3 moved = -(camera_row_x * t.x + camera_row_y * t.y + camera_row_z * t.z) * inverse_scale_squared;
    return MOVED_CAMERA ? moved : camera_position;
}
