// One Gaussian blended over a column of pixels, front to back: the same arithmetic in every variant of the kernel.
// Needs constants.glsl, INVERSE_DEPTH, DEPTH_LIMIT, LINEAR_DEPTH, INCREMENTAL_EXP and COLUMN_ROWS: the pixels of a column, one below
// the other, that belong to an invocation.

// No region gives an invocation more pixels in a column. Not COLUMN_ROWS: an array whose size is a specialization constant
// has a type of its own in every declaration, and comes back from a function undefined.
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
    // What the quotient of neighbouring pixels' opacities is multiplied by from one pixel of a column to the next.
    float curvature;
};

// T < 0: the pixel has stopped, and -T is its transmittance.
struct Pixel {
    float transmittance;
    vec3 color;
    float depth;
    // Nothing whose 1/z is smaller counts: it lies behind what else is in the picture.
    float least_inverse_z;
    uint last;
};

Splat splat_of(vec2 mean, vec4 conic_opacity, vec4 color_inverse_depth) {
    vec3 form = quadratic_form(conic_opacity.xyz);
    float curvature = INCREMENTAL_EXP ? exp2(2.0 * form.z) : 0.0;
    return Splat(mean, form, conic_opacity.w, color_inverse_depth.xyz, color_inverse_depth.w, curvature);
}

// An opacity before the clamp at ALPHA_MAX, or 0 where it does not count. Where the form is indefinite by rounding alone
// the opacity exceeds the splat's.
float counted(float alpha, float opacity) {
    return alpha >= ALPHA_MIN && alpha <= opacity ? alpha : 0.0;
}

// Opacities of a splat at the pixels of a column whose first is at `first_px`. Precise, so that all kernels decide alike: a
// compiler must not contract the products in one of them only.
//
// INCREMENTAL_EXP: along a column a Gaussian is a geometric sequence of second order, alpha(k + 1) = alpha(k) r(k) and
// r(k + 1) = r(k) curvature, from its middle outwards: three exponentials and two products per pixel instead of an
// exponential each. It pays where exp2 is computed by many instructions. Within the half column of at most 4 px,
// opacities that count are within 2^82 of the middle's (the form's coefficient is at least -2.41 because of the
// dilation), so nothing that counts is lost below float32's range.
void column_alphas(Splat splat, vec2 first_px, out float alphas[MAX_COLUMN_ROWS]) {
    const uint middle = COLUMN_ROWS / 2;
    float dx = splat.mean.x - first_px.x;
    precise float b_dx = splat.form.y * dx;
    precise float a_dx_dx = splat.form.x * dx * dx;
    // A power of at most 0 but for the rounding of products.
    float limit = splat.opacity * 1.00001;
    if (INCREMENTAL_EXP && COLUMN_ROWS > 2) {
        float dy = splat.mean.y - (first_px.y + float(middle));
        precise float power = a_dx_dx + dy * (splat.form.z * dy + b_dx);
        precise float slope = 2.0 * splat.form.z * dy + b_dx;
        precise float bend = splat.form.z;
        precise float alpha = splat.opacity * exp2(power);
        alphas[middle] = counted(alpha, limit);
        // Bounded, so that 0 times it stays 0.
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

// `unclamped`: of column_alphas.
void blend_splat(Splat splat, float unclamped, uint place, inout Pixel pixel) {
    float alpha = min(ALPHA_MAX, unclamped);
    precise float next = pixel.transmittance * (1.0 - alpha);
    // Also where the splat does not count, but not where the pixel has stopped before.
    // Splats come front to back, so what follows one behind the limit lies behind it as well: the pixel stops.
    bool behind = DEPTH_LIMIT && splat.inverse_z < pixel.least_inverse_z;
    bool goes_on = next >= TRANSMITTANCE_MIN && !behind;
    float weight = goes_on ? alpha * pixel.transmittance : 0.0;
    pixel.color += weight * splat.rgb;
    if (INVERSE_DEPTH) {
        pixel.depth += weight * (LINEAR_DEPTH ? 1.0 / splat.inverse_z : splat.inverse_z);
    }
    pixel.transmittance = goes_on ? next : -abs(pixel.transmittance);
    pixel.last = weight > 0.0 ? place : pixel.last;
}

Pixel fresh_pixel(bool inside) {
    return Pixel(inside ? 1.0 : -1.0, vec3(0.0), 0.0, 0.0, 0);
}
