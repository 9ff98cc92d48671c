// Volumes that keep or remove the Gaussians inside (engine/scene/cut_out.rs): boxes, ellipsoids, half-spaces. A cut-out is four
// vec4: rows that take a point relative to the centre to the volume's axes, behind each a coordinate of the centre; and what is
// compared with, behind it CUT_OUT_ with CUT_OUT_REMOVES.
// Needs constants.glsl and `cut_outs`.

// As CutOutLimits::contains, bit for bit: `precise`, so that products and sums are rounded one by one.
bool in_cut_out(uint at, uint shape, vec3 point) {
    vec4 row_x = VEC4_AT(cut_outs, at), row_y = VEC4_AT(cut_outs, at + 1), row_z = VEC4_AT(cut_outs, at + 2);
    vec3 bounds = VEC4_AT(cut_outs, at + 3).xyz;
    precise vec3 from = point - vec3(row_x.w, row_y.w, row_z.w);
    precise float x = row_x.x * from.x + row_x.y * from.y + row_x.z * from.z;
    precise float y = row_y.x * from.x + row_y.y * from.y + row_y.z * from.z;
    precise float z = row_z.x * from.x + row_z.y * from.y + row_z.z * from.z;
    precise float squared = x * x + y * y + z * z;
    bool in_box = abs(x) <= bounds.x && abs(y) <= bounds.y && abs(z) <= bounds.z;
    return shape == CUT_OUT_BOX ? in_box : shape == CUT_OUT_ELLIPSOID ? squared <= 1.0 : x <= bounds.x;
}

// Whether `count` cut-outs from the `first` on leave a Gaussian with this mean: inside of one that keeps, if there are any, and
// of none that removes. As CutOutLimits::keep.
bool kept_by_cut_outs(uint first, uint count, vec3 mean) {
    bool removed = false, kept = false, any_keeps = false;
    for (uint i = 0; i < count; ++i) {
        uint at = CUT_OUT_PLANES * (first + i);
        uint kind = uint(VEC4_AT(cut_outs, at + 3).w);
        bool removes = kind >= CUT_OUT_REMOVES;
        bool inside = in_cut_out(at, kind % CUT_OUT_REMOVES, mean);
        removed = removed || inside && removes;
        kept = kept || inside && !removes;
        any_keeps = any_keeps || !removes;
    }
    return !removed && (kept || !any_keeps);
}
