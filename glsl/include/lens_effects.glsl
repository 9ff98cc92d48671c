// Effects of a lens on colours (after PPISP, NVIDIA 2025): vignetting V and response, one each per channel: y = (V x)^gamma,
//
//   V = 1 + a1 r^2 + a2 r^4 + a3 r^6,  gamma = exp(g),
//
// where r is the distance from the principal point in halves of the picture's diagonal. Below LEAST the response is a straight
// line from 0, t LEAST^(gamma - 1), so that dark and negative colours have finite gradients. Row c of a lens' matrix is (a1, a2,
// a3, g).
// Needs the push constants `center_px` and `inverse_square` (1 / half of the diagonal, squared).

const float LEAST = 1.0 / 1024.0;

float square_of_radius(uvec2 at) {
    vec2 from_center = vec2(at) - center_px;
    return dot(from_center, from_center) * inverse_square;
}

float vignetting(vec4 row, float r2) {
    return 1.0 + r2 * (row.x + r2 * (row.y + r2 * row.z));
}

// Response, its derivative with respect to t, and that with respect to g.
vec3 response(float t, float gamma) {
    float log_base = log(max(t, LEAST));
    float slope = exp((gamma - 1.0) * log_base);
    float y = t * slope;
    return vec3(y, t > LEAST ? gamma * slope : slope, gamma * y * log_base);
}
