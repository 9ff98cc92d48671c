// Pinholes and parallel rays. Shaders that include lens.glsl instead draw through lenses. Other shaders pass Jacobian and
// JacobianGradient on without reading them.
// Needs constants.glsl, camera.glsl, camera_block.glsl.

// Depth by which Gaussians are ordered, the condition on a mean to be drawn, and the depth's part in the gradient of a point.
#define DEPTH_OF(AT) AT.z
#define IS_SHOWN(AT) AT.z > NEAR_PLANE
#define SUBTRACT_DEPTH_GRADIENT(D_AT, P, D_DEPTH) D_AT.z -= D_DEPTH

#ifdef PRECISE_SCREEN
#define SCREEN precise vec2
#else
#define SCREEN vec2
#endif

// Position on the screen, px, of a point in camera space. With PRECISE_SCREEN, equal points have equal positions, whatever
// surrounds the call. `focal` are pixels per unit of x/z and y/z, of a parallel projection
// pixels per unit of x and y.
vec2 screen_of(uint projection, vec3 at, vec2 focal, vec2 center) {
    SCREEN screen = focal * at.xy / (projection == PROJECTION_ORTHOGRAPHIC ? 1.0 : at.z) + center;
    return screen;
}

// Centre, world, of the camera that sees a point.
#define POSITION_SEEING(WORLD) camera_position()

// Direction, world, in which the camera sees a point.
vec3 direction_to(uint projection, vec3 world) {
    return normalize(projection == PROJECTION_ORTHOGRAPHIC ? camera_row_z : world - camera_position());
}

// Derivative of the screen position by the point in camera space: rows (diagonal.x, 0, depth.x) and (0, diagonal.y, depth.y).
struct Jacobian {
    vec2 diagonal;
    vec2 depth;
    vec2 slope;            // x/z and y/z, clamped to the Jacobian limits; 0 for a parallel projection
    bvec2 clamped;
};

Jacobian jacobian_at(uint projection, vec3 at) {
    Jacobian j;
    bool parallel = projection == PROJECTION_ORTHOGRAPHIC;
    float inverse_z = parallel ? 1.0 : 1.0 / at.z;
    vec2 slope = parallel ? vec2(0.0) : at.xy * inverse_z;
    j.slope = parallel ? slope : clamp(slope, jacobian_limits.xz, jacobian_limits.yw);
    j.clamped = notEqual(j.slope, slope);
    j.diagonal = focal_px * inverse_z;
    j.depth = -j.diagonal * j.slope;
    return j;
}

// Rows of the Jacobian times three vectors in camera space, the columns of `axes`.
void jacobian_rows(Jacobian j, mat3 axes, out vec3 row_x, out vec3 row_y) {
    vec3 axes_x = vec3(axes[0].x, axes[1].x, axes[2].x);
    vec3 axes_y = vec3(axes[0].y, axes[1].y, axes[2].y);
    vec3 axes_z = vec3(axes[0].z, axes[1].z, axes[2].z);
    row_x = j.diagonal.x * axes_x + j.depth.x * axes_z;
    row_y = j.diagonal.y * axes_y + j.depth.y * axes_z;
}

// Gradient of the Jacobian's elements.
struct JacobianGradient {
    vec2 diagonal;
    vec2 depth;
};

// Gradients of the Jacobian and of the vectors from those of jacobian_rows.
JacobianGradient jacobian_rows_backward(Jacobian j, mat3 axes, vec3 d_row_x, vec3 d_row_y, out mat3 d_axes) {
    mat3 axes_t = transpose(axes);
    JacobianGradient d;
    d.diagonal = vec2(dot(d_row_x, axes_t[0]), dot(d_row_y, axes_t[1]));
    d.depth = vec2(dot(d_row_x, axes_t[2]), dot(d_row_y, axes_t[2]));
    d_axes = transpose(mat3(j.diagonal.x * d_row_x, j.diagonal.y * d_row_y, j.depth.x * d_row_x + j.depth.y * d_row_y));
    return d;
}

// Gradient of a point in camera space from those of its screen position and of the Jacobian there. Perspective only.
vec3 jacobian_backward(uint projection, Jacobian j, vec3 at, vec2 d_screen, JacobianGradient d) {
    float inverse_z = 1.0 / at.z;
    // J = (f/z, -f slope / z). An unclamped slope is x/z; a clamped slope does not depend on the point.
    vec2 through_slope = vec2(j.clamped.x ? 0.0 : 1.0, j.clamped.y ? 0.0 : 1.0);
    vec2 d_slope = -j.diagonal * d.depth * through_slope + d_screen * focal_px;
    vec3 d_at;
    d_at.xy = d_slope * inverse_z;
    d_at.z = -inverse_z * inverse_z * (dot(d.diagonal, focal_px) - dot(d.depth, focal_px * j.slope))
        - inverse_z * dot(d_slope, at.xy * inverse_z);
    return d_at;
}
