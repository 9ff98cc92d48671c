// Push constants of the kernels that project Gaussians: the camera, and the range of Gaussians of a dispatch. A kernel
// defines CAMERA_PUSH_EXTRA to append its own push constants.
// Frame: x_camera = R x_world + t, x right, y down, z forward; pixel centres are the integers.
layout(push_constant, scalar) uniform Push {
    // Rows of R (camera from world), times the object's scale if the object has one.
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
    // First Gaussian of the bound parameter range, number of Gaussians drawn, and capacity of the range.
    uint first;
    uint count;
    uint chunk_gaussians;
    // `extent` is EXTENT_EXACT or EXTENT_REFERENCE. `antialias` != 0 turns on the opacity compensation of Mip-Splatting's 2D
    // filter.
    uint extent;
    uint antialias;
    uint splat_stride;
    // 1 / scale^2.
    float inverse_scale_squared;
#ifdef CAMERA_PUSH_SHAPE
    // How Gaussians are drawn (engine/forward/shape.rs): a factor of the scales; a term added to both screen variances; an
    // opacity override. The override is off at 0. If positive, it replaces every opacity; if negative, only opacities of at
    // least ELLIPSOID_LEAST_OPACITY.
    float scale_modifier;
    float dilation_px2;
    float opacity_drawn;
#endif
#ifdef CAMERA_PUSH_EXTRA
    CAMERA_PUSH_EXTRA
#endif
};
