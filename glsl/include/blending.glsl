// One Gaussian blended over one pixel, front to back: the same arithmetic in every variant of the kernel.
// Needs constants.glsl and INVERSE_DEPTH.

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
    uint last;
};

void blend_splat(Splat splat, vec2 d, uint place, inout Pixel pixel) {
    float power = splat.form.x * d.x * d.x + d.y * (splat.form.z * d.y + splat.form.y * d.x);
    float alpha = min(ALPHA_MAX, splat.opacity * exp2(power));
    bool hit = power <= 0.0 && alpha >= ALPHA_MIN;
    float next = pixel.transmittance * (1.0 - alpha);
    bool blends = hit && next >= TRANSMITTANCE_MIN;
    float weight = blends ? alpha * pixel.transmittance : 0.0;
    pixel.color += weight * splat.rgb;
    if (INVERSE_DEPTH) {
        pixel.depth += weight * splat.inverse_z;
    }
    pixel.transmittance = blends ? next : hit ? -abs(pixel.transmittance) : pixel.transmittance;
    pixel.last = blends ? place : pixel.last;
}

Pixel fresh_pixel(bool inside) {
    return Pixel(inside ? 1.0 : -1.0, vec3(0.0), 0.0, 0);
}
