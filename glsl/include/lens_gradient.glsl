// Gradient of a lens's parameters: focal lengths, principal point, then the words of lens_members.glsl. Its sum over the points of
// the invocation's Gaussian is `d_lens`. r_max, r_limit and which points are shown or held count as constants.
// Needs lens.glsl, LENS_GRADIENT.

const uint LENS_WORDS = LENS_SUMS - 6;

struct LensGradient {
    vec2 focal;
    vec2 center;
    float words[LENS_WORDS];
};

LensGradient d_lens;

// Gradient of the coefficients of g and of its derivative by s, which are weighted with `of_g` and `of_slope`.
void add_polynomial(uint word, uint power, float s, float of_g, float of_slope) {
    float below = 1.0;
    for (uint k = 1; k < power; ++k) {
        below *= s;
    }
    d_lens.words[word] += of_g * below * s + of_slope * float(power) * below;
}

void add_radial(float s, float of_g, float of_slope) {
    vec3 g = radial_at(s);
    if (PROJECTION == PROJECTION_BROWN) {
        vec3 d = lens_b.yzw;
        float below = 1.0 + s * (d.x + s * (d.y + s * d.z));
        float below_slope = d.x + s * (2.0 * d.y + s * 3.0 * d.z);
        // g = A / B, so g' = (A' - g B') / B.
        float of_above = (of_g - of_slope * below_slope / below) / below;
        add_polynomial(0, 1, s, of_above, of_slope / below);
        add_polynomial(1, 2, s, of_above, of_slope / below);
        add_polynomial(4, 3, s, of_above, of_slope / below);
        add_polynomial(8, 4, s, of_above, of_slope / below);
        float of_below = -g.x * of_above - of_slope * g.y / below;
        add_polynomial(5, 1, s, of_below, -of_slope * g.x / below);
        add_polynomial(6, 2, s, of_below, -of_slope * g.x / below);
        add_polynomial(7, 3, s, of_below, -of_slope * g.x / below);
    } else if (PROJECTION == PROJECTION_FOV) {
        // g = a F(b s).
        d_lens.words[0] += (of_g * g.x + of_slope * g.y) / lens_a.x;
        d_lens.words[1] += (of_g * g.y * s + of_slope * (g.y + g.z * s)) / lens_a.y;
    } else if (PROJECTION == PROJECTION_DIVISION) {
        float k = lens_a.x;
        float root = sqrt(1.0 - 4.0 * k * s);
        // g' = k h(k s), and the derivative of g by k is s h.
        float h = g.x * g.x / root;
        float h_slope = 2.0 * g.x * (h + g.x / (root * root)) / root;
        d_lens.words[0] += of_g * s * h + of_slope * (h + k * s * h_slope);
    } else if (PROJECTION == PROJECTION_EUCM) {
        float alpha = lens_a.x;
        float beta = lens_a.y;
        float root = sqrt(beta * s + 1.0);
        float square = g.x * g.x;
        float by_alpha = -square * (root - 1.0);
        float by_beta = -square * alpha * s / (2.0 * root);
        float rise = alpha * beta / (2.0 * root);
        d_lens.words[0] += of_g * by_alpha - of_slope * (beta / (2.0 * root) * square + 2.0 * rise * g.x * by_alpha);
        d_lens.words[1] += of_g * by_beta
            - of_slope * ((alpha / (2.0 * root) - rise * s / (2.0 * root * root)) * square + 2.0 * rise * g.x * by_beta);
    } else if (PROJECTION == PROJECTION_FISHEYE) {
        add_polynomial(0, 1, s, of_g, of_slope);
        add_polynomial(1, 2, s, of_g, of_slope);
        add_polynomial(4, 3, s, of_g, of_slope);
        add_polynomial(5, 4, s, of_g, of_slope);
    } else {
        [[unroll]] for (uint k = 0; k < 6; ++k) {
            add_polynomial(k, k + 1, s, of_g, of_slope);
        }
    }
}

// Gradients of p1, p2 and of the thin-prism terms from those of bend_at and of bend_slope.
void add_bend(vec2 m, vec2 d, mat2 d_slope) {
    float s = dot(m, m);
    vec2 twice = 2.0 * m.x * m.y * d + (s + 2.0 * m * m).yx * d.yx;
    float mixed = d_slope[0].y + d_slope[1].x;
    vec2 own = vec2(d_slope[0].x, d_slope[1].y);
    vec2 p = twice + 2.0 * m.yx * own + 2.0 * mixed * m + 6.0 * m.yx * own.yx;
    vec2 along = m * d_slope;
    vec2 first = d * s + 2.0 * along;
    vec2 second = s * (d * s + 4.0 * along);
    if (BENDS_RADIAL) {
        d_lens.words[7] += p.x;
        d_lens.words[6] += p.y;
        d_lens.words[8] += first.x;
        d_lens.words[9] += second.x;
        d_lens.words[10] += first.y;
        d_lens.words[11] += second.y;
    } else {
        d_lens.words[2] += p.x;
        d_lens.words[3] += p.y;
        if (PROJECTION == PROJECTION_FISHEYE) {
            d_lens.words[6] += first.x;
            d_lens.words[7] += first.y;
        }
    }
}

// From the gradients of D(m) and of its derivative.
void add_distortion(vec2 m, vec2 d, mat2 d_slope) {
    if (BENDS_RADIAL) {
        // D = B(N(m)), N = g m: its derivative is B' N'.
        vec3 g = radial_at(dot(m, m));
        vec2 radial = g.x * m;
        mat2 slope = g.x * IDENTITY + 2.0 * g.y * outerProduct(m, m);
        mat2 d_bend = slope * d_slope;
        mat2 bent = IDENTITY + bend_slope(radial);
        add_bend(radial, d, d_bend);
        d = bent * d + bend_curvature(radial, d_bend);
        d_slope = d_slope * transpose(bent);
    } else if (BENDS) {
        add_bend(m, d, d_slope);
    }
    add_radial(dot(m, m), dot(d, m) + d_slope[0].x + d_slope[1].y, 2.0 * dot(m, d_slope * m));
}

// From the gradient of a point's screen position.
void add_lens_position(vec3 at, vec2 d_screen) {
    if (LENS_GRADIENT && !SPHERICAL) {
        vec2 m = at.xy * plane_at(at).t;
        mat2 slope;
        d_lens.focal += d_screen * distorted(m, slope);
        d_lens.center += d_screen;
        add_distortion(m, focal_px * d_screen, mat2(0.0));
    }
}

// From the gradient of a Jacobian's rows.
void add_lens_jacobian(vec3 at, Jacobian j, JacobianGradient d) {
    if (!SPHERICAL) {
        vec3 place = held(at);
        Plane plane = plane_at(place);
        vec3 row_a, row_b;
        plane_rows(plane, place.xy, row_a, row_b);
        vec3 d_x = focal_px.x * d.row_x;
        vec3 d_y = focal_px.y * d.row_y;
        d_lens.focal += vec2(dot(d.row_x, j.row_x), dot(d.row_y, j.row_y)) / focal_px;
        mat2 d_slope = mat2(dot(d_x, row_a), dot(d_x, row_b), dot(d_y, row_a), dot(d_y, row_b));
        add_distortion(place.xy * plane.t, vec2(0.0), d_slope);
    }
}
