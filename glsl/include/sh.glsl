// Real spherical harmonics up to degree 3, with the signs of the reference implementation.
// Needs SH_DEGREE, constants.glsl; for loops over groups SH_LOOPS and GL_EXT_control_flow_attributes.

const float SH_C0 = 0.28209479177387814;
const float SH_C1 = 0.4886025119029199;
const float SH_C2_XY = 1.0925484305920792;
const float SH_C2_ZZ = 0.31539156525252005;
const float SH_C2_XX = 0.5462742152960396;
const float SH_C3_Y3 = 0.5900435899266435;
const float SH_C3_XYZ = 2.890611442640554;
const float SH_C3_YZZ = 0.4570457994644658;
const float SH_C3_ZZZ = 0.3731763325901154;
const float SH_C3_ZXX = 1.445305721320277;

// Number of vec4 planes with the active coefficients.
const uint SH_PLANES = SH_DEGREE == 0 ? SH_PLANES_0
    : SH_DEGREE == 1 ? SH_PLANES_1
    : SH_DEGREE == 2 ? SH_PLANES_2 : SH_PLANES_3;

// Coefficients come in groups of four, which are three planes. With SH_LOOPS loops over groups stay loops: registers hold one
// group at a time instead of 16 coefficients with their basis functions and derivatives. GPUs then run twice as many subgroups
// (tools/gpu_static.md). A processor takes a third longer.
const uint SH_GROUPS = (SH_PLANES + 2) / 3;

// Basis functions 4 group to 4 group + 3 at the unit direction d; those above SH_DEGREE are 0.
vec4 sh_basis_group(uint group, vec3 d) {
    float x = d.x, y = d.y, z = d.z;
    float xx = x * x, yy = y * y, zz = z * z;
    bool one = SH_DEGREE >= 1;
    bool two = SH_DEGREE >= 2;
    bool three = SH_DEGREE >= 3;
    if (group == 0) {
        return vec4(SH_C0, one ? -SH_C1 * y : 0.0, one ? SH_C1 * z : 0.0, one ? -SH_C1 * x : 0.0);
    }
    if (group == 1) {
        return vec4(two ? SH_C2_XY * x * y : 0.0, two ? -SH_C2_XY * y * z : 0.0,
            two ? SH_C2_ZZ * (2.0 * zz - xx - yy) : 0.0, two ? -SH_C2_XY * x * z : 0.0);
    }
    if (group == 2) {
        return vec4(two ? SH_C2_XX * (xx - yy) : 0.0, three ? -SH_C3_Y3 * y * (3.0 * xx - yy) : 0.0,
            three ? SH_C3_XYZ * x * y * z : 0.0, three ? -SH_C3_YZZ * y * (4.0 * zz - xx - yy) : 0.0);
    }
    return vec4(three ? SH_C3_ZZZ * z * (2.0 * zz - 3.0 * xx - 3.0 * yy) : 0.0,
        three ? -SH_C3_YZZ * x * (4.0 * zz - xx - yy) : 0.0, three ? SH_C3_ZXX * z * (xx - yy) : 0.0,
        three ? -SH_C3_Y3 * x * (xx - 3.0 * yy) : 0.0);
}

// Derivatives of a group's basis functions with respect to the direction, as if its components were independent.
void sh_derivative_group(uint group, vec3 d, out vec3 derivative[4]) {
    float x = d.x, y = d.y, z = d.z;
    float xx = x * x, yy = y * y, zz = z * z;
    float one = SH_DEGREE >= 1 ? 1.0 : 0.0;
    float two = SH_DEGREE >= 2 ? 1.0 : 0.0;
    float three = SH_DEGREE >= 3 ? 1.0 : 0.0;
    if (group == 0) {
        derivative[0] = vec3(0.0);
        derivative[1] = one * vec3(0.0, -SH_C1, 0.0);
        derivative[2] = one * vec3(0.0, 0.0, SH_C1);
        derivative[3] = one * vec3(-SH_C1, 0.0, 0.0);
    } else if (group == 1) {
        derivative[0] = two * SH_C2_XY * vec3(y, x, 0.0);
        derivative[1] = two * -SH_C2_XY * vec3(0.0, z, y);
        derivative[2] = two * SH_C2_ZZ * vec3(-2.0 * x, -2.0 * y, 4.0 * z);
        derivative[3] = two * -SH_C2_XY * vec3(z, 0.0, x);
    } else if (group == 2) {
        derivative[0] = two * SH_C2_XX * vec3(2.0 * x, -2.0 * y, 0.0);
        derivative[1] = three * -SH_C3_Y3 * vec3(6.0 * x * y, 3.0 * xx - 3.0 * yy, 0.0);
        derivative[2] = three * SH_C3_XYZ * vec3(y * z, x * z, x * y);
        derivative[3] = three * -SH_C3_YZZ * vec3(-2.0 * x * y, 4.0 * zz - xx - 3.0 * yy, 8.0 * y * z);
    } else {
        derivative[0] = three * SH_C3_ZZZ * vec3(-6.0 * x * z, -6.0 * y * z, 6.0 * zz - 3.0 * xx - 3.0 * yy);
        derivative[1] = three * -SH_C3_YZZ * vec3(4.0 * zz - 3.0 * xx - yy, -2.0 * x * y, 8.0 * x * z);
        derivative[2] = three * SH_C3_ZXX * vec3(2.0 * x * z, -2.0 * y * z, xx - yy);
        derivative[3] = three * -SH_C3_Y3 * vec3(3.0 * xx - 3.0 * yy, -6.0 * x * y, 0.0);
    }
}

// DO(group) for the groups below N.
#define EACH_SH_GROUP(N, DO) \
    if (SH_LOOPS) { \
        [[dont_unroll]] for (uint group = 0; group < (N); ++group) { DO(group); } \
    } else { \
        [[unroll]] for (uint group = 0; group < (N); ++group) { DO(group); } \
    }
