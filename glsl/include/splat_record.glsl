// Where the attributes of a visible Gaussian lie. One record of SPLAT_PLANES vec4 behind the other in one buffer, which is
// then bound to all of them: a Gaussian's attributes are gathered from one cache line; or a buffer for each, where one for
// all would exceed what a binding may cover.
// Needs constants.glsl and a push constant `splat_stride`: SPLAT_PLANES, or 1.
uint splat_at(uint visible, uint plane) {
    return visible * splat_stride + (splat_stride == 1 ? 0 : plane);
}
