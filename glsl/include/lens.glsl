// Cameras with a lens, in place of pinhole.glsl: the projection p -> focal D(A(p)) + center of points in camera space.
//
//   A: (x, y)/z, or for ANGULAR lenses (x, y) theta / rho, with theta the angle from the axis and rho = |(x, y)|
//   D: g(s) m, s = m . m, and with BENDS tangential and thin-prism terms
//
// Means and covariances on the screen are those of the unscented transform, or where one of its points is not shown, of the
// lens's Jacobian at the mean. A new family of lenses needs a PROJECTION_ constant; a file below lens/ with g, its two
// derivatives and the gradient of its coefficients; a case in radial_at and in radial_backward; ANGULAR and BENDS below; the
// host's file below engine/scene/lens/ and its lines in lens.rs; a camera in tests/lenses.rs; and C's enum. If COLMAP has it, lens.rs
// has its models (COLMAP_MODELS, COLMAP_PARAMETERS, to_colmap); if nerfstudio has it, engine/files/transforms.rs has its keys.
// Matrices are stored by rows: M v is `v * M`, and A B is `B * A`.
// Needs constants.glsl, camera.glsl, camera_block.glsl, PROJECTION, and the requirements of shutter.glsl.

#define SPHERICAL (PROJECTION == PROJECTION_EQUIRECTANGULAR)
// Pinholes have this form with a rolling shutter. Their means and covariances stay those of the Jacobian, with its own limits: the
// unscented transform would draw Gaussians beside the camera over the whole picture.
const bool PINHOLE = PROJECTION == PROJECTION_PERSPECTIVE;
const bool ANGULAR = PROJECTION == PROJECTION_FISHEYE || PROJECTION == PROJECTION_THIN_PRISM_FISHEYE;
// True if the tangential and thin-prism terms are those of the radially distorted point.
const bool BENDS_RADIAL = PROJECTION == PROJECTION_THIN_PRISM_FISHEYE;
const bool BENDS = PROJECTION == PROJECTION_BROWN || PROJECTION == PROJECTION_FISHEYE || BENDS_RADIAL;

// Largest |m|, where the picture folds, and largest |m| at which the Jacobian is taken; 0 without a limit. Lenses with more than
// nine coefficients have no other limit, and store the last three in its place.
#define LENS_FOLD (PINHOLE ? 0.0 : jacobian_limits.x)
#define LENS_HOLD jacobian_limits.y
// Largest distance from the middle of the picture, focal lengths, of a point of the unscented transform of a lens on the plane; 0 without
// a limit.
#define LENS_FAR jacobian_limits.z

#ifdef DIFFERENTIATES_LENS
// Gradient of a lens's parameters: focal lengths, principal point, then the words of lens_members.glsl. Its sum over the points of
// the invocation's Gaussian is `d_lens`.
const uint LENS_WORDS = LENS_SUMS - 9;

struct LensGradient {
    vec2 focal;
    vec2 center;
    float words[LENS_WORDS];
};

LensGradient d_lens;

// Adds the gradients of the coefficients of g: `of_g` is dL/dg, `of_slope` is dL/d(dg/ds).
void add_polynomial(uint word, uint power, float s, float of_g, float of_slope) {
    float below = 1.0;
    for (uint k = 1; k < power; ++k) {
        below *= s;
    }
    d_lens.words[word] += of_g * below * s + of_slope * float(power) * below;
}
#endif

#include "lens/arctan.glsl"
#include "lens/brown.glsl"
#include "lens/fov.glsl"
#include "lens/division.glsl"
#include "lens/eucm.glsl"
#include "lens/fisheye.glsl"
#include "lens/thin_prism_fisheye.glsl"
#include "lens/equirectangular.glsl"

// g and its two derivatives.
vec3 radial_at(float s) {
    switch (PROJECTION) {
    case PROJECTION_PERSPECTIVE: return vec3(1.0, 0.0, 0.0);
    case PROJECTION_BROWN: return brown_radial(s);
    case PROJECTION_FOV: return fov_radial(s);
    case PROJECTION_DIVISION: return division_radial(s);
    case PROJECTION_EUCM: return eucm_radial(s);
    case PROJECTION_FISHEYE: return fisheye_radial(s);
    case PROJECTION_THIN_PRISM_FISHEYE: return thin_prism_fisheye_radial(s);
    }
    return vec3(0.0);
}

#ifdef DIFFERENTIATES_LENS
// Adds the gradient of the coefficients of g, from those of g and of its derivative.
void radial_backward(float s, float of_g, float of_slope) {
    switch (PROJECTION) {
    case PROJECTION_BROWN: brown_backward(s, radial_at(s), of_g, of_slope); break;
    case PROJECTION_FOV: fov_backward(s, radial_at(s), of_g, of_slope); break;
    case PROJECTION_DIVISION: division_backward(s, radial_at(s), of_g, of_slope); break;
    case PROJECTION_EUCM: eucm_backward(s, radial_at(s), of_g, of_slope); break;
    case PROJECTION_FISHEYE: fisheye_backward(s, of_g, of_slope); break;
    case PROJECTION_THIN_PRISM_FISHEYE: thin_prism_fisheye_backward(s, of_g, of_slope); break;
    }
}
#endif

// Coefficients p1, p2 of the tangential term (2 p1 a b + p2 (s + 2 a^2), 2 p2 a b + p1 (s + 2 b^2)).
vec2 tangential() {
    return BENDS_RADIAL ? lens_b.wz : lens_a.zw;
}

// Coefficients of the thin-prism term: of s and s^2 for x, then for y.
vec4 thin_prism() {
    vec4 of_fisheye = PROJECTION == PROJECTION_FISHEYE ? vec4(lens_b.z, 0.0, lens_b.w, 0.0) : vec4(0.0);
    return BENDS_RADIAL ? vec4(lens_c, jacobian_limits.yzw) : of_fisheye;
}

// Tangential and thin-prism terms.
vec2 bend_at(vec2 m) {
    vec2 p = tangential();
    vec4 prism = thin_prism();
    float s = dot(m, m);
    return 2.0 * m.x * m.y * p + p.yx * (s + 2.0 * m * m) + s * (prism.xz + s * prism.yw);
}

mat2 bend_slope(vec2 m) {
    vec2 p = tangential();
    vec4 prism = thin_prism();
    vec2 rise = 2.0 * (prism.xz + 2.0 * dot(m, m) * prism.yw);
    float mixed = 2.0 * dot(p, m);
    vec2 own = 2.0 * p * m.yx + 6.0 * p.yx * m;
    return mat2(own.x + rise.x * m.x, mixed + rise.x * m.y, mixed + rise.y * m.x, own.y + rise.y * m.y);
}

// Gradient of m from that of bend_slope.
vec2 bend_curvature(vec2 m, mat2 d) {
    vec2 p = tangential();
    vec4 prism = thin_prism();
    vec2 rise = 2.0 * (prism.xz + 2.0 * dot(m, m) * prism.yw);
    float mixed = d[0].y + d[1].x;
    vec2 own = vec2(d[0].x, d[1].y);
    vec2 of_tangential = 2.0 * (mixed * p + p.yx * (3.0 * own + own.yx));
    return of_tangential + d * rise + 8.0 * m * dot(prism.yw, m * d);
}

const mat2 IDENTITY = mat2(1.0);

// Gradient of v from that of the matrix v -> f v with df/dv = v first and d first/dv = v second, which is f I + first v v^T.
vec2 radial_curvature(vec2 v, float first, float second, mat2 d) {
    return v * (first * (d[0].x + d[1].y) + second * dot(v, d * v)) + first * (v * d + d * v);
}

// D(m) and its derivative.
vec2 distorted(vec2 m, out mat2 slope) {
    vec3 g = radial_at(dot(m, m));
    vec2 radial = g.x * m;
    slope = g.x * IDENTITY + 2.0 * g.y * outerProduct(m, m);
    if (!BENDS) {
        return radial;
    }
    vec2 at = BENDS_RADIAL ? radial : m;
    mat2 bend = bend_slope(at);
    slope = BENDS_RADIAL ? slope * (IDENTITY + bend) : slope + bend;
    return radial + bend_at(at);
}

// Gradient of m from that of the derivative of D.
vec2 distorted_backward(vec2 m, mat2 d) {
    vec3 g = radial_at(dot(m, m));
    float first = 2.0 * g.y;
    float second = 4.0 * g.z;
    if (!BENDS_RADIAL) {
        return radial_curvature(m, first, second, d) + (BENDS ? bend_curvature(m, d) : vec2(0.0));
    }
    // D = B(N(m)), N = g m: its derivative is B' N', and N' is symmetric.
    vec2 radial = g.x * m;
    mat2 slope = g.x * IDENTITY + first * outerProduct(m, m);
    mat2 d_bend = slope * d;
    mat2 d_radial = d * transpose(IDENTITY + bend_slope(radial));
    return radial_curvature(m, first, second, d_radial) + slope * bend_curvature(radial, d_bend);
}

// A(p) = (x, y) t and its derivatives: dt/dx = x q, dq/dx = x r, the same for y; dt/dz = u, du/dx = x v, du/dz = w. So dq/dz = v.
struct Plane {
    float t;
    float q;
    float r;
    float u;
    float v;
    float w;
};

Plane plane_at(vec3 at) {
    float inverse_z = 1.0 / at.z;
    if (!ANGULAR) {
        return Plane(inverse_z, 0.0, 0.0, -inverse_z * inverse_z, 0.0, 2.0 * inverse_z * inverse_z * inverse_z);
    }
    float rho2 = dot(at.xy, at.xy);
    float inverse_d2 = 1.0 / (rho2 + at.z * at.z);
    Plane plane = Plane(0.0, 0.0, 0.0, -inverse_d2, 2.0 * inverse_d2 * inverse_d2, 2.0 * at.z * inverse_d2 * inverse_d2);
    float inverse_z2 = inverse_z * inverse_z;
    if (at.z > 0.0 && rho2 * inverse_z2 < 0.04) {
        vec3 ratio = arctan_ratio(rho2 * inverse_z2) * inverse_z;
        plane.t = ratio.x;
        plane.q = 2.0 * ratio.y * inverse_z2;
        plane.r = 4.0 * ratio.z * inverse_z2 * inverse_z2;
    } else {
        float rho = sqrt(rho2);
        plane.t = arctan(rho, at.z) / rho;
        plane.q = (at.z * inverse_d2 - plane.t) / rho2;
        plane.r = -(plane.w + 3.0 * plane.q) / rho2;
    }
    return plane;
}

// Rows of the derivative of A.
void plane_rows(Plane plane, vec2 v, out vec3 row_a, out vec3 row_b) {
    row_a = vec3(plane.t + v.x * v.x * plane.q, v.x * v.y * plane.q, v.x * plane.u);
    row_b = vec3(v.x * v.y * plane.q, plane.t + v.y * v.y * plane.q, v.y * plane.u);
}

// Depth by which Gaussians are ordered: z, or the distance.
float depth_of(vec3 at) {
    return ANGULAR || SPHERICAL ? length(at) : at.z;
}

// Its derivative by the point.
vec3 depth_slope(vec3 at) {
    return ANGULAR || SPHERICAL ? at / length(at) : vec3(0.0, 0.0, 1.0);
}

#define POSITION_SEEING(WORLD) position_reading(WORLD)
#define DEPTH_OF(AT) depth_of(AT)
#define IS_SHOWN(AT) is_shown_by_lens(AT)
#define SUBTRACT_DEPTH_GRADIENT(D_AT, P, D_DEPTH) D_AT -= (D_DEPTH) * turned(depth_slope(P.mean_camera), -P.time)

bool is_shown_by_lens(vec3 at) {
    bool before_fold = LENS_FOLD == 0.0 || length(at.xy) * plane_at(at).t < LENS_FOLD;
    bool off_pole = length(at.xz) > 1e-6 * length(at);
    return depth_of(at) > NEAR_PLANE && (SPHERICAL ? off_pole : before_fold);
}

vec2 screen_of(uint projection, vec3 at, vec2 focal, vec2 center) {
    mat2 slope;
    return focal * (SPHERICAL ? equirectangular_point(at) : distorted(at.xy * plane_at(at).t, slope)) + center;
}

#include "shutter.glsl"

vec3 direction_to(uint projection, vec3 world) {
    return normalize(world - position_reading(world));
}

// Rows of the derivative of the screen position by the point in camera space.
struct Jacobian {
    vec3 row_x;
    vec3 row_y;
};

struct JacobianGradient {
    vec3 row_x;
    vec3 row_y;
};

// True for points at which the Jacobian would be taken too far outside the picture.
bool is_held(vec3 at) {
    return !(ANGULAR || SPHERICAL || PINHOLE) && LENS_HOLD > 0.0 && length(at.xy) > LENS_HOLD * at.z;
}

// Point at which the Jacobian is taken.
vec3 held(vec3 at) {
    if (PINHOLE) {
        return vec3(clamp(at.xy / at.z, jacobian_limits.xz, jacobian_limits.yw) * at.z, at.z);
    }
    return is_held(at) ? vec3(at.xy * (LENS_HOLD * at.z / length(at.xy)), at.z) : at;
}

// Jacobian at this point, with the longitude held at a distance from the axis of the poles of at least `least_h`.
Jacobian jacobian_of(vec3 at, float least_h) {
    Jacobian j;
    if (SPHERICAL) {
        equirectangular_rows(at, max(length(at.xz), least_h), j.row_x, j.row_y);
    } else {
        Plane plane = plane_at(at);
        mat2 slope;
        distorted(at.xy * plane.t, slope);
        vec3 row_a, row_b;
        plane_rows(plane, at.xy, row_a, row_b);
        j.row_x = slope[0].x * row_a + slope[0].y * row_b;
        j.row_y = slope[1].x * row_a + slope[1].y * row_b;
    }
    j.row_x *= focal_px.x;
    j.row_y *= focal_px.y;
    return j;
}

Jacobian jacobian_at(uint projection, vec3 at) {
    return jacobian_of(held(at), length(at) * lens_a.x);
}

void jacobian_rows(Jacobian j, mat3 axes, out vec3 row_x, out vec3 row_y) {
    row_x = j.row_x * axes;
    row_y = j.row_y * axes;
}

JacobianGradient jacobian_rows_backward(Jacobian j, mat3 axes, vec3 d_row_x, vec3 d_row_y, out mat3 d_axes) {
    d_axes = outerProduct(j.row_x, d_row_x) + outerProduct(j.row_y, d_row_y);
    return JacobianGradient(axes * d_row_x, axes * d_row_y);
}

vec3 jacobian_backward(uint projection, Jacobian j, vec3 at, vec2 d_screen, JacobianGradient d) {
    // The position is that of the point itself, wherever the Jacobian is taken.
    Jacobian own = ANGULAR ? j : jacobian_of(at, 0.0);
    vec3 d_at = d_screen.x * own.row_x + d_screen.y * own.row_y;
    vec3 d_x = focal_px.x * d.row_x;
    vec3 d_y = focal_px.y * d.row_y;
    if (SPHERICAL) {
        return d_at + equirectangular_backward(at, d_x, d_y);
    }
    vec3 place = held(at);
    Plane plane = plane_at(place);
    vec2 v = place.xy;
    vec3 row_a, row_b;
    plane_rows(plane, v, row_a, row_b);
    mat2 slope;
    distorted(v * plane.t, slope);
    // J = D' A'. Through D', which depends on A.
    vec2 d_m = distorted_backward(v * plane.t, mat2(dot(d_x, row_a), dot(d_x, row_b), dot(d_y, row_a), dot(d_y, row_b)));
    vec3 d_place = d_m.x * row_a + d_m.y * row_b;
    // Through A'.
    vec3 d_a = slope[0].x * d_x + slope[1].x * d_y;
    vec3 d_b = slope[0].y * d_x + slope[1].y * d_y;
    mat2 d_across = mat2(d_a.xy, d_b.xy);
    vec2 d_along = vec2(d_a.z, d_b.z);
    float along = dot(d_along, v);
    d_place.xy += radial_curvature(v, plane.q, plane.r, d_across) + plane.u * d_along + plane.v * along * v;
    d_place.z += plane.u * (d_across[0].x + d_across[1].y) + plane.v * dot(v, d_across * v) + plane.w * along;
    if (PINHOLE) {
        // At a limit the place is (limit z, z).
        vec2 slope = at.xy / at.z;
        vec2 limit = clamp(slope, jacobian_limits.xz, jacobian_limits.yw);
        bvec2 is_limited = notEqual(limit, slope);
        d_place.z += dot(mix(vec2(0.0), limit, is_limited), d_place.xy);
        d_place.xy = mix(d_place.xy, vec2(0.0), is_limited);
    }
    if (is_held(at)) {
        // The place is (x, y) LENS_HOLD z / rho.
        vec2 direction = normalize(at.xy);
        float outward = dot(d_place.xy, direction);
        d_place.z += LENS_HOLD * outward;
        d_place.xy = LENS_HOLD * at.z / length(at.xy) * (d_place.xy - direction * outward);
    }
    return d_at + d_place;
}

// Unscented transform (Julier and Uhlmann 1997, with alpha, beta, kappa = 1, 2, 0): mean and covariance of the positions of seven
// points, the mean and those sqrt(3) standard deviations from it along the axes. With a and b half the difference and half the
// sum of the positions of opposite points, from that of the mean, and m = sum(b) / 3, the mean moves by m and
//   cov = sum(a a^T + b b^T) / 3 + m m^T.
struct Spread {
    // True if all points are shown.
    bool valid;
    // a / sqrt(3) and b / sqrt(3), one component per axis.
    vec3 row_x;
    vec3 row_y;
    vec3 bend_x;
    vec3 bend_y;
    // m, the motion of the mean.
    vec2 shift;
};

const float SPREAD = 1.7320508;

// Position relative to that of the mean; in a panorama, that of the nearest turn.
vec2 offset_of(vec3 at, vec2 center) {
    vec2 offset = screen_of(PROJECTION, at, focal_px, center_px) - center;
    float period = float(whole_width);
    offset.x -= SPHERICAL ? period * round(offset.x / period) : 0.0;
    return offset;
}

// True for points far outside the picture of a planar lens. There a lens's polynomial grows as no real lens does, and
// positions of pinholes have no bound, so Gaussians beside the camera would cover the picture.
bool is_far(vec3 at) {
    float s = dot(at.xy, at.xy) / (at.z * at.z);
    return !(ANGULAR || SPHERICAL) && is_held(at) && LENS_FAR > 0.0 && sqrt(s) * radial_at(s).x > LENS_FAR;
}

// Behind a fisheye, a point beyond the axis would land on the other side of the picture.
bool is_point_shown(vec3 at, vec3 mean) {
    return IS_SHOWN(at) && !(ANGULAR && at.z < 0.0 && dot(at.xy, mean.xy) < 0.0) && !is_far(at);
}

Spread spread_at(vec3 mean, mat3 axes, vec3 scale) {
    Spread s = Spread(!PINHOLE, vec3(0.0), vec3(0.0), vec3(0.0), vec3(0.0), vec2(0.0));
    if (PINHOLE) {
        return s;
    }
    vec3 mean_read = reading_of(mean).at;
    vec2 center = screen_of(PROJECTION, mean_read, focal_px, center_px);
    [[unroll]] for (uint k = 0; k < 3; ++k) {
        vec3 step = SPREAD * scale[k] * axes[k];
        vec3 one_read = reading_of(mean + step).at;
        vec3 other_read = reading_of(mean - step).at;
        vec2 one = offset_of(one_read, center);
        vec2 other = offset_of(other_read, center);
        s.valid = s.valid && is_point_shown(one_read, mean_read) && is_point_shown(other_read, mean_read);
        vec2 row = (one - other) * (0.5 / SPREAD);
        vec2 bend = (one + other) * (0.5 / SPREAD);
        s.row_x[k] = row.x;
        s.row_y[k] = row.y;
        s.bend_x[k] = bend.x;
        s.bend_y[k] = bend.y;
        s.shift += (one + other) / 6.0;
    }
    return s;
}

struct SpreadGradient {
    vec3 point;
    mat3 axes;
    vec3 log_scale;
};

#ifdef DIFFERENTIATES_LENS
#include "lens_gradient.glsl"
#endif

// Gradient of a point in camera space from that of its screen position.
vec3 screen_backward(vec3 at, vec2 d_screen) {
    Reading reading = reading_of(at);
#ifdef DIFFERENTIATES_LENS
    add_lens_position(reading.at, d_screen);
#endif
    Jacobian j = jacobian_of(reading.at, 0.0);
    return turned(d_screen.x * j.row_x + d_screen.y * j.row_y, -reading.time);
}

// Gradients of the mean, the axes and the log-scales from those of the position and of a spread's members.
SpreadGradient spread_backward(vec3 mean, mat3 axes, vec3 scale, vec2 d_screen, Spread d) {
    SpreadGradient sum = SpreadGradient(vec3(0.0), mat3(0.0), vec3(0.0));
    vec2 d_center = d_screen;
    vec2 d_both = (d_screen + d.shift) / 6.0;
    [[unroll]] for (uint k = 0; k < 3; ++k) {
        vec3 step = SPREAD * scale[k] * axes[k];
        vec2 d_row = vec2(d.row_x[k], d.row_y[k]) * (0.5 / SPREAD);
        vec2 d_bend = vec2(d.bend_x[k], d.bend_y[k]) * (0.5 / SPREAD) + d_both;
        vec3 d_one = screen_backward(mean + step, d_bend + d_row);
        vec3 d_other = screen_backward(mean - step, d_bend - d_row);
        sum.point += d_one + d_other;
        sum.axes[k] = SPREAD * scale[k] * (d_one - d_other);
        sum.log_scale[k] = dot(sum.axes[k], axes[k]);
        d_center -= 2.0 * d_bend;
    }
    sum.point += screen_backward(mean, d_center);
    return sum;
}
