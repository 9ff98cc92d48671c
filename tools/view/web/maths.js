// Vectors are arrays of three numbers; rotations are arrays of three rows.

export const add = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
export const sub = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
export const times = (a, s) => [a[0] * s, a[1] * s, a[2] * s];
export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
export const length = (a) => Math.hypot(a[0], a[1], a[2]);
export const clamp = (x, low, high) => Math.min(high, Math.max(low, x));

export function normalize(a, fallback = [0, 0, 1]) {
    const n = length(a);
    return n > 1e-12 ? times(a, 1 / n) : fallback;
}

/** Some direction perpendicular to `a`. */
export function across(a) {
    return normalize(cross(a, Math.abs(a[0]) < 0.6 ? [1, 0, 0] : [0, 1, 0]));
}

/** `v` turned by `angle` (radians) about the unit vector `axis`. */
export function turn(v, axis, angle) {
    const c = Math.cos(angle), s = Math.sin(angle);
    return add(add(times(v, c), times(cross(axis, v), s)), times(axis, dot(axis, v) * (1 - c)));
}

/** The rows of a camera (right, down, forward) that looks along `forward`. */
export function looking(forward, up) {
    const z = normalize(forward);
    let x = cross(z, up);
    x = length(x) > 1e-6 ? normalize(x) : across(z);
    return [x, cross(z, x), z];
}

/** Makes rows orthonormal again, because repeated turns add up errors. */
export function orthonormal([, y, z]) {
    const forward = normalize(z);
    const right = normalize(cross(y, forward), across(forward));
    return [right, cross(forward, right), forward];
}

/** Quaternion (w, x, y, z) of rows. */
export function quaternion(m) {
    const [[a, b, c], [d, e, f], [g, h, i]] = m;
    const t = a + e + i;
    let q;
    if (t > 0) q = [1 + t, h - f, c - g, d - b];
    else if (a > e && a > i) q = [h - f, 1 + a - e - i, b + d, c + g];
    else if (e > i) q = [c - g, b + d, 1 - a + e - i, f + h];
    else q = [d - b, c + g, f + h, 1 - a - e + i];
    const n = Math.hypot(...q);
    return q.map((v) => v / n);
}

export function rows([w, x, y, z]) {
    return [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]
    ];
}

export function slerp(a, b, t) {
    let c = a.reduce((sum, v, i) => sum + v * b[i], 0);
    const sign = c < 0 ? -1 : 1;
    c *= sign;
    const angle = Math.acos(Math.min(1, c)), s = Math.sin(angle);
    const [u, v] = s < 1e-4 ? [1 - t, t] : [Math.sin((1 - t) * angle) / s, Math.sin(t * angle) / s];
    const q = a.map((x, i) => u * x + v * sign * b[i]);
    const n = Math.hypot(...q);
    return q.map((x) => x / n);
}
