// Volumes that keep or remove the Gaussians inside (engine/scene/cut_out.rs): boxes, ellipsoids, half-spaces. A cut-out is four
// vec4. Three have a row that transforms a point, relative to the centre, to the volume's axes, and a coordinate of the centre.
// The fourth has the limits of the comparison, and CUT_OUT_ with CUT_OUT_REMOVES.
// Needs constants.glsl and `cut_outs`.

// Same as CutOutLimits::contains, bit for bit: `precise` rounds each product and sum separately.
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

// True if `count` cut-outs from `first` on leave a Gaussian with this mean: inside some keep volume (when there are any), and
// inside no remove volume. Same as CutOutLimits::keep.
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
