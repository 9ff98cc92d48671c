// Arctangents with float32's precision. Vulkan allows atan an error of 4096 ulp, half a pixel in a thousand.

// Angle of (x, y) from the x axis.
float arctan(float y, float x) {
    float small = min(abs(x), abs(y));
    float ratio = small / max(max(abs(x), abs(y)), 1e-30);
    // Beyond tan(pi/8): pi/4 + arctan((r - 1) / (r + 1)).
    bool far = ratio > 0.41421356;
    float t = far ? (ratio - 1.0) / (ratio + 1.0) : ratio;
    float w = t * t;
    float series = ((8.05374449538e-2 * w - 1.38776856032e-1) * w + 1.99777106478e-1) * w - 3.33329491539e-1;
    float angle = (far ? 0.785398163 : 0.0) + (series * w * t + t);
    angle = abs(y) > abs(x) ? 1.57079633 - angle : angle;
    angle = x < 0.0 ? 3.14159265 - angle : angle;
    return y < 0.0 ? -angle : angle;
}

// F(w) = arctan(sqrt(w)) / sqrt(w) and its two derivatives. The closed forms lose their digits near 0.
vec3 arctan_ratio(float w) {
    if (w < 0.04) {
        // The series of (-w)^n / (2n + 1).
        float f = 1.0 - w * (1.0 / 3.0 - w * (1.0 / 5.0 - w * (1.0 / 7.0 - w * (1.0 / 9.0 - w / 11.0))));
        float first = -1.0 / 3.0 + w * (2.0 / 5.0 - w * (3.0 / 7.0 - w * (4.0 / 9.0 - w * (5.0 / 11.0 - w * 6.0 / 13.0))));
        float second = 2.0 / 5.0 - w * (6.0 / 7.0 - w * (12.0 / 9.0 - w * (20.0 / 11.0 - w * (30.0 / 13.0 - w * 42.0 / 15.0))));
        return vec3(f, first, second);
    }
    float root = sqrt(w);
    float inverse = 1.0 / (1.0 + w);
    float f = arctan(root, 1.0) / root;
    float first = (inverse - f) / (2.0 * w);
    return vec3(f, first, -(inverse * inverse + 3.0 * first) / (2.0 * w));
}
