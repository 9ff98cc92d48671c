// One Gaussian blended over one pixel, front to back: the same arithmetic in every variant of the kernel.
// Needs constants.glsl, INVERSE_DEPTH, DEPTH_LIMIT and LINEAR_DEPTH.

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

// Opacity of a splat at an offset d from its mean before the clamp at ALPHA_MAX, or 0 where it does not count. Precise,
// so that all kernels decide alike: a compiler must not contract the products in one of them only.
float splat_alpha(vec3 form, float opacity, vec2 d) {
    precise float power = form.x * d.x * d.x + d.y * (form.z * d.y + form.y * d.x);
    precise float alpha = opacity * exp2(power);
    return power <= 0.0 && alpha >= ALPHA_MIN ? alpha : 0.0;
}

void blend_splat(Splat splat, vec2 d, uint place, inout Pixel pixel) {
    float alpha = min(ALPHA_MAX, splat_alpha(splat.form, splat.opacity, d));
    bool behind = DEPTH_LIMIT && splat.inverse_z < pixel.least_inverse_z;
    // Splats come front to back, so what follows lies behind as well: the pixel stops.
    bool hit = alpha > 0.0 || behind;
    precise float next = pixel.transmittance * (1.0 - alpha);
    bool blends = hit && next >= TRANSMITTANCE_MIN && !behind;
    float weight = blends ? alpha * pixel.transmittance : 0.0;
    pixel.color += weight * splat.rgb;
    if (INVERSE_DEPTH) {
        pixel.depth += weight * (LINEAR_DEPTH ? 1.0 / splat.inverse_z : splat.inverse_z);
    }
    pixel.transmittance = blends ? next : hit ? -abs(pixel.transmittance) : pixel.transmittance;
    pixel.last = blends ? place : pixel.last;
}

Pixel fresh_pixel(bool inside) {
    return Pixel(inside ? 1.0 : -1.0, vec3(0.0), 0.0, 0.0, 0);
}
