// Blends one Gaussian over a column of pixels, front to back. Every variant of the kernel shares this arithmetic. A column is a
// vertical run of COLUMN_ROWS pixels that belongs to one invocation.
//
// Needs constants.glsl, INVERSE_DEPTH, DEPTH_LIMIT, DISTANCE_ORDER, LINEAR_DEPTH, INCREMENTAL_EXP, LAST_ENTRIES and COLUMN_ROWS;
// with AUXILIARY buffers.glsl.

// Maximum number of rows in a column. A literal instead of COLUMN_ROWS: an array sized by a specialization constant has a
// distinct type in every declaration. A function that returns such an array returns undefined values.
const uint MAX_COLUMN_ROWS = 8;

const float LOG2_E = 1.4426950408889634;

// log2 exp(power) = form.x dx^2 + form.y dx dy + form.z dy^2.
vec3 quadratic_form(vec3 conic) {
    return vec3(-0.5 * LOG2_E, -LOG2_E, -0.5 * LOG2_E) * conic;
}

struct Splat {
    vec2 mean;
    vec3 form;
    float opacity;
    vec3 rgb;
    float inverse_z;
    // Factor of the opacity ratio of neighbouring pixels from one pixel of a column to the next.
    float curvature;
};

#ifdef AUXILIARY
#include "blend_auxiliary.glsl"
#endif

// T < 0: the pixel has stopped, and -T is its transmittance.
struct Pixel {
    float transmittance;
    vec3 color;
    float depth;
    // Splats with a smaller 1/z lie behind the host's opaque surface and do not count.
    float least_inverse_z;
    uint last;
#ifdef AUXILIARY
    PixelExtra extra;
#endif
};

Splat splat_of(vec2 mean, vec4 conic_opacity, vec4 color_inverse_depth) {
    vec3 form = quadratic_form(conic_opacity.xyz);
    float curvature = INCREMENTAL_EXP ? exp2(2.0 * form.z) : 0.0;
    return Splat(mean, form, conic_opacity.w, color_inverse_depth.xyz, color_inverse_depth.w, curvature);
}

// Opacity before the clamp at ALPHA_MAX, or 0 if it does not count. If rounding alone makes the form indefinite, the opacity
// exceeds the splat's own.
float counted(float alpha, float opacity) {
    return alpha >= ALPHA_MIN && alpha <= opacity ? alpha : 0.0;
}

// Opacities of a splat at the pixels of a column; `first_px` is the first pixel. `precise` keeps the compiler from
// contracting the products in one kernel only: all kernels must take the same decisions.
//
// INCREMENTAL_EXP: along a column, a Gaussian is a second-order geometric sequence, alpha(k + 1) = alpha(k) r(k) and r(k + 1) =
// r(k) curvature. It is evaluated from the middle of the column outwards. This takes three exponentials, and two products per
// pixel instead of one exponential per pixel. It pays if exp2 takes many instructions. A half column has at most 4 px. Within
// it, opacities that count are within 2^82 of the middle's, because the dilation keeps the form's coefficient at -2.41 or
// above. So no opacity that counts underflows float32.
void column_alphas(Splat splat, vec2 first_px, out float alphas[MAX_COLUMN_ROWS]) {
    const uint middle = COLUMN_ROWS / 2;
    float dx = splat.mean.x - first_px.x;
#ifdef LENSES
    dx = to_nearest_turn(dx);
#endif
    precise float b_dx = splat.form.y * dx;
    precise float a_dx_dx = splat.form.x * dx * dx;
    // The power is at most 0 except for rounding of the products.
    float limit = splat.opacity * 1.00001;
    if (INCREMENTAL_EXP && COLUMN_ROWS > 2) {
        float dy = splat.mean.y - (first_px.y + float(middle));
        precise float power = a_dx_dx + dy * (splat.form.z * dy + b_dx);
        precise float slope = 2.0 * splat.form.z * dy + b_dx;
        precise float bend = splat.form.z;
        precise float alpha = splat.opacity * exp2(power);
        alphas[middle] = counted(alpha, limit);
        // The limit makes the product with 0 equal 0, not NaN.
        precise float below = exp2(min(bend - slope, 100.0));
        precise float down = alpha;
        [[unroll]] for (uint k = middle + 1; k < COLUMN_ROWS; ++k) {
            down *= below;
            below *= splat.curvature;
            alphas[k] = counted(down, limit);
        }
        precise float above = exp2(min(bend + slope, 100.0));
        precise float up = alpha;
        [[unroll]] for (uint k = 1; k <= middle; ++k) {
            up *= above;
            above *= splat.curvature;
            alphas[middle - k] = counted(up, limit);
        }
    } else {
        [[unroll]] for (uint k = 0; k < COLUMN_ROWS; ++k) {
            float dy = splat.mean.y - (first_px.y + float(k));
            precise float power = a_dx_dx + dy * (splat.form.z * dy + b_dx);
            precise float alpha = splat.opacity * exp2(power);
            alphas[k] = power <= 0.0 && alpha >= ALPHA_MIN ? alpha : 0.0;
        }
    }
}

// `unclamped` is the opacity from column_alphas. Returns the splat's weight.
float blend_splat(Splat splat, float unclamped, uint place, inout Pixel pixel) {
    // Tested even if the splat does not count at this pixel, but not after the pixel has stopped. If splats come by z, all later
    // ones lie behind the limit too, and the pixel stops. With DISTANCE_ORDER it skips this one.
    bool behind = DEPTH_LIMIT && splat.inverse_z < pixel.least_inverse_z;
    float alpha = DISTANCE_ORDER && behind ? 0.0 : min(ALPHA_MAX, unclamped);
    precise float next = pixel.transmittance * (1.0 - alpha);
    bool goes_on = next >= TRANSMITTANCE_MIN && (DISTANCE_ORDER || !behind);
    float weight = goes_on ? alpha * pixel.transmittance : 0.0;
    pixel.color += weight * splat.rgb;
    if (INVERSE_DEPTH) {
        pixel.depth += weight * (LINEAR_DEPTH ? 1.0 / splat.inverse_z : splat.inverse_z);
    }
    pixel.transmittance = goes_on ? next : -abs(pixel.transmittance);
    if (LAST_ENTRIES) {
        pixel.last = weight > 0.0 ? place : pixel.last;
    }
    return weight;
}

Pixel fresh_pixel(bool inside) {
#ifdef AUXILIARY
    return Pixel(inside ? 1.0 : -1.0, vec3(0.0), 0.0, 0.0, 0, fresh_extra());
#else
    return Pixel(inside ? 1.0 : -1.0, vec3(0.0), 0.0, 0.0, 0);
#endif
}
