// Push constants of the kernels that project Gaussians: the camera, and which Gaussians a dispatch works on.
// A kernel with more to say defines CAMERA_PUSH_EXTRA, which is appended.
// Frame: x_camera = R x_world + t, x right, y down, z forward; pixel centres are the integers.
layout(push_constant, scalar) uniform Push {
    // Rows of R (camera from world), times the object's scale where an object has one of its own.
    vec3 camera_row_x;
    vec3 camera_row_y;
    vec3 camera_row_z;
    vec3 camera_translation;
    vec2 focal_px;
    vec2 center_px;
    // Limits of x/z (low, high) and y/z (low, high) within which the projection is linearised.
    vec4 jacobian_limits;
    uint image_width;
    uint image_height;
    // First Gaussian of the bound range of parameters, how many of it are drawn, and how many it can hold.
    uint first;
    uint count;
    uint chunk_gaussians;
    // EXTENT_EXACT or EXTENT_REFERENCE; opacity compensation of Mip-Splatting's 2D filter when `antialias` != 0.
    uint extent;
    uint antialias;
    uint splat_stride;
    // 1 / scale^2.
    float inverse_scale_squared;
#ifdef CAMERA_PUSH_SHAPE
    // What is drawn (engine/forward/shape.rs): factor of the scales; added to both variances on the screen; if not 0
    // the opacity of all in place of their own, if negative only of those with ELLIPSOID_LEAST_OPACITY or more.
    float scale_modifier;
    float dilation_px2;
    float opacity_drawn;
#endif
#ifdef CAMERA_PUSH_EXTRA
    CAMERA_PUSH_EXTRA
#endif
};
