//! Real spherical harmonics up to degree 3, with the reference implementation's signs; and the twin of
//! `backward/expand_gradients`.

const C0: f64 = 0.282_094_791_773_878_14;
const C1: f64 = 0.488_602_511_902_919_9;
const C2: [f64; 5] = [
    1.092_548_430_592_079_2,
    -1.092_548_430_592_079_2,
    0.315_391_565_252_520_05,
    -1.092_548_430_592_079_2,
    0.546_274_215_296_039_6,
];
const C3: [f64; 7] = [
    -0.590_043_589_926_643_5,
    2.890_611_442_640_554,
    -0.457_045_799_464_465_8,
    0.373_176_332_590_115_4,
    -0.457_045_799_464_465_8,
    1.445_305_721_320_277,
    -0.590_043_589_926_643_5,
];

/// The 16 basis functions in the direction (x, y, z), a unit vector.
pub fn basis(direction: [f64; 3]) -> [f64; 16] {
    let [x, y, z] = direction;
    let (xx, yy, zz) = (x * x, y * y, z * z);
    [
        C0,
        -C1 * y,
        C1 * z,
        -C1 * x,
        C2[0] * x * y,
        C2[1] * y * z,
        C2[2] * (2.0 * zz - xx - yy),
        C2[3] * x * z,
        C2[4] * (xx - yy),
        C3[0] * y * (3.0 * xx - yy),
        C3[1] * x * y * z,
        C3[2] * y * (4.0 * zz - xx - yy),
        C3[3] * z * (2.0 * zz - 3.0 * xx - 3.0 * yy),
        C3[4] * x * (4.0 * zz - xx - yy),
        C3[5] * z * (xx - yy),
        C3[6] * x * (xx - 3.0 * yy),
    ]
}

/// The gradients of [`basis`] with respect to (x, y, z).
pub fn basis_gradient(direction: [f64; 3]) -> [[f64; 3]; 16] {
    let [x, y, z] = direction;
    let (xx, yy, zz) = (x * x, y * y, z * z);
    let times = |c: f64, v: [f64; 3]| v.map(|a| a * c);
    [
        [0.0; 3],
        [0.0, -C1, 0.0],
        [0.0, 0.0, C1],
        [-C1, 0.0, 0.0],
        times(C2[0], [y, x, 0.0]),
        times(C2[1], [0.0, z, y]),
        times(C2[2], [-2.0 * x, -2.0 * y, 4.0 * z]),
        times(C2[3], [z, 0.0, x]),
        times(C2[4], [2.0 * x, -2.0 * y, 0.0]),
        times(C3[0], [6.0 * x * y, 3.0 * xx - 3.0 * yy, 0.0]),
        times(C3[1], [y * z, x * z, x * y]),
        times(C3[2], [-2.0 * x * y, 4.0 * zz - xx - 3.0 * yy, 8.0 * y * z]),
        times(C3[3], [-6.0 * x * z, -6.0 * y * z, 6.0 * zz - 3.0 * xx - 3.0 * yy]),
        times(C3[4], [4.0 * zz - 3.0 * xx - yy, -2.0 * x * y, 8.0 * x * z]),
        times(C3[5], [2.0 * x * z, -2.0 * y * z, xx - yy]),
        times(C3[6], [3.0 * xx - 3.0 * yy, -6.0 * x * y, 0.0]),
    ]
}

pub fn coefficients(degree: u32) -> usize {
    ((degree + 1) * (degree + 1)) as usize
}

/// dL/dSH from dL/dcolour before its clamp: Y_k(direction)·d for the active degree, zero above.
pub fn sh_gradient(direction: [f64; 3], d_color: [f64; 3], degree: u32, stored: usize) -> Vec<[f64; 3]> {
    let basis = basis(direction);
    let active = coefficients(degree);
    (0..stored).map(|k| if k < active { d_color.map(|d| d * basis[k]) } else { [0.0; 3] }).collect()
}
