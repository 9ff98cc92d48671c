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
