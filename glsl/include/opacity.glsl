// Opacity of a logit, with the same bits in every kernel, because kernels exchange limits that depend on it.
float opacity_of(float logit) {
    precise float opacity = 1.0 / (1.0 + exp(-logit));
    return opacity;
}
