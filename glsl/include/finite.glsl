// Whether numbers are finite, by their exponents: a driver may take it that `isnan` and `isinf` are false.

bool finite(vec4 g) {
    uvec4 exponent = floatBitsToUint(g) & 0x7F800000u;
    return all(notEqual(exponent, uvec4(0x7F800000u)));
}
