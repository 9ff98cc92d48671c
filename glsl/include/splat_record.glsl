// Address of an attribute of a visible Gaussian. The attributes form records of SPLAT_PLANES vec4 in one buffer. That buffer is
// bound at every attribute's binding, so the gather of one Gaussian touches one cache line. If the buffer would exceed the
// largest binding, each attribute has its own buffer.
// Needs constants.glsl and a push constant `splat_stride`: SPLAT_PLANES, or 1 for separate buffers.
uint splat_at(uint visible, uint plane) {
    return visible * splat_stride + (splat_stride == 1 ? 0 : plane);
}
