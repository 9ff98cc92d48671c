// Split along the longest axis (Improved-GS). Its children overlap the parent's picture more closely than drawn ones. Their
// means are mean +- R(q) e_k 3 d s_k, where k is the first axis of the largest scale and d is LONG_AXIS_SHARE. Scale k becomes
// (1 - d) s_k, the others shrink by sqrt(1 - d^2), and the opacity becomes LONG_AXIS_OPACITY o.
// Needs constants.glsl.

const float LOG_LONG_AXIS_SCALE = log(1.0 - LONG_AXIS_SHARE);
const float LOG_LONG_AXIS_OTHERS = 0.5 * log(1.0 - LONG_AXIS_SHARE * LONG_AXIS_SHARE);

uint longest_axis(vec3 log_scale) {
    uint axis = log_scale.y > log_scale.x ? 1 : 0;
    return log_scale.z > log_scale[axis] ? 2 : axis;
}

vec3 long_axis_log_scale(vec3 log_scale) {
    uint axis = longest_axis(log_scale);
    return log_scale
        + mix(vec3(LOG_LONG_AXIS_OTHERS), vec3(LOG_LONG_AXIS_SCALE), equal(uvec3(axis), uvec3(0, 1, 2)));
}

// Offset of the first child, in the Gaussian's own axes; the second child's is its opposite.
vec3 long_axis_offset(vec3 log_scale) {
    uint axis = longest_axis(log_scale);
    float offset = 3.0 * LONG_AXIS_SHARE * exp(log_scale[axis]);
    return mix(vec3(0.0), vec3(offset), equal(uvec3(axis), uvec3(0, 1, 2)));
}

// Logit of LONG_AXIS_OPACITY times the opacity. exp of a non-positive number cannot overflow.
float long_axis_logit(float logit) {
    float small = exp(-abs(logit));
    return logit > 0.0 ? log(LONG_AXIS_OPACITY / (1.0 - LONG_AXIS_OPACITY + small))
                       : logit + log(LONG_AXIS_OPACITY / (1.0 + (1.0 - LONG_AXIS_OPACITY) * small));
}
