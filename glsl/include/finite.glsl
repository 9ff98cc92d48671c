// True if all numbers are finite. Tests exponents, because a driver may assume that `isnan` and `isinf` are false.

bool finite(vec4 g) {
    uvec4 exponent = floatBitsToUint(g) & 0x7F800000u;
    return all(notEqual(exponent, uvec4(0x7F800000u)));
}
