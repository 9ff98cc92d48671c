// EWA projection of one Gaussian (Zwicker et al. 2001; paper, section 4), shared by culling, projection and the backward pass.
// Needs constants.glsl, camera_block.glsl and `parameters`.
// Needs filter_3d.glsl, FILTER_3D, PROJECTION (see pinhole.glsl, lens.glsl), and the push constant `antialias` with ANTIALIAS_ bits.
// Culling and projection can draw ellipsoids or points instead. They define DRAWS_SHAPES and get footprint_of. They need
// tile_span.glsl and the push constant `extent`, DROPOUT (dropout.glsl) and TINTED (true if the scene has its own factors).

#include "opacity.glsl"
#include "camera.glsl"
#ifdef LENSES
#include "lens.glsl"
#else
#include "pinhole.glsl"
#endif
#include "rotation.glsl"

#ifdef DRAWS_SHAPES
#define SCALE_MODIFIER shape_scale
#define SCREEN_DILATION_PX2 shape_dilation_px2
#else
// Only Gaussians themselves are differentiated. The backward pass has OWN_DILATION.
#define SCALE_MODIFIER 1.0
#define SCREEN_DILATION_PX2 (OWN_DILATION ? shape_dilation_px2 : DILATION_PX2)
#endif

struct ProjectedGaussian {
    vec3 mean_camera;      // R mean + t
    mat3 axes_camera;      // R R(q), columns: the Gaussian's axes in camera space, of the length of the object's scale
    vec3 scale;            // exp(log_scale) times the scale modifier
    vec4 quat;             // unit, or zero
    float inverse_norm;    // 1 / |q|, or 0 for a zero quaternion
    Jacobian jacobian;
    // Rows of M = J R R(q) S: cov2d = M M^T + dilation I.
    vec3 row_x;
    vec3 row_y;
    vec3 cov2d;            // (xx, xy, yy) with the dilation, px^2
    float det_raw;         // determinant before the dilation
    float det;             // determinant after the dilation
#ifdef LENSES
    Spread spread;         // its rows replace those of the Jacobian if it is valid
    // In the space of the camera halfway. mean_camera and axes_camera are in that of the camera at `time`.
    vec3 mean_halfway;
    mat3 axes_halfway;
    float time;
#endif
};

ProjectedGaussian project_gaussian(vec3 mean, vec4 quat, vec3 log_scale) {
    ProjectedGaussian p;
    p.mean_camera = to_camera(mean) + camera_translation;
    float norm = length(quat);
    p.inverse_norm = norm > QUAT_NORM_MIN ? 1.0 / norm : 0.0;
    p.quat = quat * p.inverse_norm;
    p.scale = exp(log_scale) * SCALE_MODIFIER;
    mat3 axes = rotation_of(p.quat);
    p.axes_camera = mat3(to_camera(axes[0]), to_camera(axes[1]), to_camera(axes[2]));
#ifdef LENSES
    Reading reading = reading_of(p.mean_camera);
    p.mean_halfway = p.mean_camera;
    p.axes_halfway = p.axes_camera;
    p.time = reading.time;
    p.mean_camera = reading.at;
    p.axes_camera = turned_columns(p.axes_camera, reading.time);
#endif

    p.jacobian = jacobian_at(PROJECTION, p.mean_camera);
    jacobian_rows(p.jacobian, p.axes_camera, p.row_x, p.row_y);
    p.row_x *= p.scale;
    p.row_y *= p.scale;

    // det(M M^T) = |row_x x row_y|^2 (Cauchy-Binet). The difference of products would cancel for a needle-shaped Gaussian.
    float xx = dot(p.row_x, p.row_x);
    float yy = dot(p.row_y, p.row_y);
    vec3 minors = cross(p.row_x, p.row_y);
    p.det_raw = dot(minors, minors);
    p.cov2d = vec3(xx + SCREEN_DILATION_PX2, dot(p.row_x, p.row_y), yy + SCREEN_DILATION_PX2);
    p.det = p.det_raw + SCREEN_DILATION_PX2 * (xx + yy + SCREEN_DILATION_PX2);
#ifdef LENSES
    p.spread = spread_at(p.mean_halfway, p.axes_halfway, p.scale);
    if (p.spread.valid) {
        Spread s = p.spread;
        p.row_x = s.row_x;
        p.row_y = s.row_y;
        xx = dot(s.row_x, s.row_x) + dot(s.bend_x, s.bend_x) + s.shift.x * s.shift.x;
        yy = dot(s.row_y, s.row_y) + dot(s.bend_y, s.bend_y) + s.shift.y * s.shift.y;
        float xy = dot(s.row_x, s.row_y) + dot(s.bend_x, s.bend_y) + s.shift.x * s.shift.y;
        // xx times the square of y's part perpendicular to x, which does not cancel either.
        float along = xx > 0.0 ? xy / xx : 0.0;
        vec3 row = s.row_y - along * s.row_x;
        vec3 bend = s.bend_y - along * s.bend_x;
        float shift = s.shift.y - along * s.shift.x;
        p.det_raw = xx * (dot(row, row) + dot(bend, bend) + shift * shift);
        p.cov2d = vec3(xx + SCREEN_DILATION_PX2, xy, yy + SCREEN_DILATION_PX2);
        p.det = p.det_raw + SCREEN_DILATION_PX2 * (xx + yy + SCREEN_DILATION_PX2);
    }
#endif
    return p;
}

// A Gaussian after its 3D filter. `shrink` is the factor of its opacity.
struct Filtered {
    vec3 log_scale;
    float opacity_logit;
    float shrink;
};

Filtered filter_3d(vec4 log_scale, float opacity_logit) {
    Filtered f = Filtered(log_scale.xyz, opacity_logit, 1.0);
    if (FILTER_3D && log_scale.w > 0.0) {
        vec3 ratio = filter_ratio(log_scale);
        f.log_scale = log(log_scale.w) + 0.5 * log(1.0 + ratio * ratio);
        f.shrink = filter_shrink(ratio);
        // The logit of shrink * sigmoid(opacity_logit). Negative logits multiply both sides of the fraction by their exponential, so
        // that nothing overflows.
        float e = exp(-abs(opacity_logit));
        float numerator = opacity_logit < 0.0 ? e * f.shrink : f.shrink;
        f.opacity_logit = log(numerator / (1.0 + e - numerator));
    }
    return f;
}

bool is_finite(float x) {
    return (floatBitsToUint(x) & 0x7F800000u) != 0x7F800000u;
}

#ifdef DRAWS_SHAPES
// Screen area that a Gaussian covers.
struct Footprint {
    bool visible;
    float opacity;         // after the antialiasing compensation and the factors of TINTED and DROPOUT
    vec2 mean2d_px;
    vec2 half_extent_px;   // where alpha falls to 1/255
    uint radius_px;        // the reference's radius; 0 in exact extent
    uvec4 tiles;           // first and one past the last tile, x then y: (x0, x1, y0, y1)
};

Footprint footprint_of(ProjectedGaussian p, float opacity_logit) {
    Footprint f;
    float ratio = p.det_raw / p.det;
    float opacity = opacity_of(opacity_logit);
    bool compensated = (antialias & ANTIALIAS_COMPENSATED) != 0;
    f.opacity = opacity * (compensated ? sqrt(max(ANTIALIAS_MIN_RATIO, ratio)) : 1.0);
    if (TINTED) {
        f.opacity *= scene_opacity;
    }
    // Members of the camera block may only select between values: see camera_block.glsl.
    float least_opacity = shape_opacity > 0.0 ? 0.0 : ELLIPSOID_LEAST_OPACITY;
    float drawn_opacity = abs(shape_opacity);
    drawn_opacity = opacity >= least_opacity ? drawn_opacity : 0.0;
    f.opacity = shape_opacity != 0.0 ? drawn_opacity : f.opacity;
    if (DROPOUT) {
        f.opacity *= dropout_factor;
    }
    f.mean2d_px = screen_of(PROJECTION, p.mean_camera, focal_px, center_px);
#ifdef LENSES
    f.mean2d_px += p.spread.valid ? p.spread.shift : vec2(0.0);
#endif
    bool valid = IS_SHOWN(p.mean_camera) && is_finite(p.det) && p.det > 0.0 && is_finite(p.cov2d.x)
        && is_finite(p.cov2d.z) && is_finite(f.mean2d_px.x) && is_finite(f.mean2d_px.y) && is_finite(f.opacity);

    // Extent at which opacity * exp(-q/2) = 1/255, widened by more than the float32 error. The excess only costs time.
    float level = 2.0 * log(255.0 * f.opacity);
    level = f.opacity >= ALPHA_MIN ? max(level, 0.0) * 1.0001 + 0.002 : 0.0;
    vec2 half_extent = sqrt(level * p.cov2d.xz) * 1.0001 + 0.001;
    f.half_extent_px = f.opacity >= ALPHA_MIN ? half_extent : vec2(-1e30);

    uvec2 grid = (uvec2(image_width, image_height) + TILE_SIZE - 1) / TILE_SIZE;
    if (extent == EXTENT_REFERENCE) {
        float mid = 0.5 * (p.cov2d.x + p.cov2d.z);
        float radius = ceil(3.0 * sqrt(mid + sqrt(max(0.1, mid * mid - p.det))));
        f.radius_px = uint(clamp(radius, 0.0, 2147483520.0));
        vec2 low = trunc((f.mean2d_px - radius) / float(TILE_SIZE));
        vec2 high = trunc((f.mean2d_px + radius + float(TILE_SIZE - 1)) / float(TILE_SIZE));
        uvec2 tile_low = uvec2(clamp(low, vec2(0.0), vec2(grid)));
        uvec2 tile_high = uvec2(clamp(high, vec2(0.0), vec2(grid)));
#ifdef LENSES
        if (SPHERICAL) {
            float x = f.mean2d_px.x;
            uvec2 columns = turned_columns(x - radius, x + radius, grid.x, image_width, whole_width);
            tile_low.x = columns.x;
            tile_high.x = columns.y;
        }
#endif
        f.tiles = uvec4(tile_low.x, tile_high.x, tile_low.y, tile_high.y);
    } else {
        f.radius_px = 0;
        f.tiles = tile_box(vec4(f.mean2d_px, f.half_extent_px), grid);
        valid = valid && f.opacity >= ALPHA_MIN;
    }
    f.visible = valid && f.tiles.x < f.tiles.y && f.tiles.z < f.tiles.w;
    f.tiles = f.visible ? f.tiles : uvec4(0);
    return f;
}
#endif
