// Enhanced unified model: g = 1 / (alpha sqrt(beta s + 1) + 1 - alpha). Coefficients alpha, beta.
vec3 eucm_radial(float s) {
    float alpha = lens_a.x;
    float beta = lens_a.y;
    float root = sqrt(beta * s + 1.0);
    float g = 1.0 / (alpha * root + 1.0 - alpha);
    float rise = alpha * beta / (2.0 * root);
    float first = -rise * g * g;
    return vec3(g, first, g * (rise * g * beta / (2.0 * root * root) - 2.0 * rise * first));
}

#ifdef DIFFERENTIATES_LENS
void eucm_backward(float s, vec3 g, float of_g, float of_slope) {
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
}
#endif
