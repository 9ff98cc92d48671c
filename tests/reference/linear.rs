//! The linear algebra that the twins need, written out.

/// A row-major 3×3 matrix.
pub type Mat3 = [[f64; 3]; 3];

pub fn wide(values: &[f32]) -> Vec<f64> {
    values.iter().copied().map(f64::from).collect()
}

pub fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

pub fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

pub fn apply(a: &Mat3, v: [f64; 3]) -> [f64; 3] {
    [dot(a[0], v), dot(a[1], v), dot(a[2], v)]
}

pub fn transpose(a: &Mat3) -> Mat3 {
    [0, 1, 2].map(|column| a.map(|row| row[column]))
}

pub fn multiply(a: &Mat3, b: &Mat3) -> Mat3 {
    let columns = transpose(b);
    a.map(|row| columns.map(|column| dot(row, column)))
}

pub fn scale(a: &Mat3, factor: f64) -> Mat3 {
    a.map(|row| row.map(|x| x * factor))
}

/// The rotation of a unit quaternion (w, x, y, z).
pub fn rotation(q: [f64; 4]) -> Mat3 {
    let [w, x, y, z] = q;
    [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ]
}

/// dL/dq from dL/dR of [`rotation`].
pub fn rotation_backward(q: [f64; 4], d: &Mat3) -> [f64; 4] {
    let [w, x, y, z] = q;
    [
        2.0 * (x * (d[2][1] - d[1][2]) + y * (d[0][2] - d[2][0]) + z * (d[1][0] - d[0][1])),
        2.0 * (-2.0 * x * (d[1][1] + d[2][2])
            + y * (d[0][1] + d[1][0])
            + z * (d[0][2] + d[2][0])
            + w * (d[2][1] - d[1][2])),
        2.0 * (-2.0 * y * (d[0][0] + d[2][2])
            + x * (d[0][1] + d[1][0])
            + z * (d[1][2] + d[2][1])
            + w * (d[0][2] - d[2][0])),
        2.0 * (-2.0 * z * (d[0][0] + d[1][1])
            + x * (d[0][2] + d[2][0])
            + y * (d[1][2] + d[2][1])
            + w * (d[1][0] - d[0][1])),
    ]
}

/// q / max(|q|, 1e-12); a zero quaternion stays zero, whose rotation is the identity.
pub fn normalize_quat(q: [f64; 4]) -> ([f64; 4], f64) {
    let norm = q.iter().map(|x| x * x).sum::<f64>().sqrt().max(1e-12);
    (q.map(|x| x / norm), norm)
}

pub fn sigmoid(x: f64) -> f64 {
    1.0 / (1.0 + (-x).exp())
}
