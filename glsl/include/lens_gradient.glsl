// Gradient of a lens's parameters. LENS_FOLD, LENS_HOLD, and which points are shown or held, count as constants.
// Needs lens.glsl with DIFFERENTIATES_LENS, LENS_GRADIENT.

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
    radial_backward(dot(m, m), dot(d, m) + d_slope[0].x + d_slope[1].y, 2.0 * dot(m, d_slope * m));
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
