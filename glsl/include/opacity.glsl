// The opacity of a logit, with the same bits wherever it is compiled: bounds that one kernel computes are another's.
float opacity_of(float logit) {
    precise float opacity = 1.0 / (1.0 + exp(-logit));
    return opacity;
}
