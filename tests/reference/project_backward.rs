//! The derivative of the projection (spec: "Backward"), the twin of `backward/project_backward`.

use super::filter_sizes::filtered_backward;
use super::linear::{Mat3, apply, cross, dot, multiply, rotation, rotation_backward, scale, transpose};
use super::project::{Intermediate, color, intermediate, view_direction};
use super::sh;
use super::types::{Gaussian, Gradient, SplatGradient, View};

/// Gradient of the raw parameters of one visible Gaussian.
pub fn project_backward(gaussian: &Gaussian, view: &View, d: &SplatGradient) -> Gradient {
    let on_the_way = intermediate(gaussian, view).expect("the backward pass is for visible Gaussians");
    let mut gradient = Gradient { sh: vec![[0.0; 3]; gaussian.sh.len()], ..Gradient::default() };
    color_backward(gaussian, view, d.color, &mut gradient);

    let (d_opacity, _) = opacity_backward(&on_the_way, d.opacity * view.drawn.opacity_factor());
    gradient.opacity_logit = d_opacity * on_the_way.opacity * (1.0 - on_the_way.opacity);
    let (d_p, d_cov3d) = geometry_backward(&on_the_way, view, d);
    let d_mean = apply(&transpose(&view.camera_from_world), d_p);
    for i in 0..3 {
        gradient.mean[i] += d_mean[i];
    }
    shape_backward(&on_the_way, &d_cov3d, &mut gradient);
    filtered_backward(gaussian, view.filter_3d, d_opacity, &mut gradient);
    gradient
}

/// dL/dδ of the pose exp(δ^) T at δ = 0 through one visible Gaussian, δ = (ν, ω) in the camera's frame (spec of training, §8):
/// ν: g_p + R h; ω: p × g_p + 2 axial(S G_S), with S = R Σ Rᵀ.
pub fn pose_gradient(gaussian: &Gaussian, view: &View, d: &SplatGradient) -> [f64; 6] {
    let on_the_way = intermediate(gaussian, view).expect("the backward pass is for visible Gaussians");
    let (d_p, d_cov3d) = geometry_backward(&on_the_way, view, d);
    let mut of_color = Gradient { sh: vec![[0.0; 3]; gaussian.sh.len()], ..Gradient::default() };
    color_backward(gaussian, view, d.color, &mut of_color);
    let r = &view.camera_from_world;
    let through_direction = apply(r, of_color.mean);
    let into_camera = |m: &Mat3| multiply(&multiply(r, m), &transpose(r));
    let b = multiply(&into_camera(&on_the_way.cov3d), &into_camera(&d_cov3d));
    let axial = [b[1][2] - b[2][1], b[2][0] - b[0][2], b[0][1] - b[1][0]];
    let turn = cross(on_the_way.p, d_p);
    let nu = |i: usize| d_p[i] + through_direction[i];
    let omega = |i: usize| turn[i] + 2.0 * axial[i];
    [nu(0), nu(1), nu(2), omega(0), omega(1), omega(2)]
}

/// dL/d(position in the camera's frame) and dL/dΣ.
fn geometry_backward(on_the_way: &Intermediate, view: &View, d: &SplatGradient) -> ([f64; 3], Mat3) {
    let (_, through_compensation) = opacity_backward(on_the_way, d.opacity * view.drawn.opacity_factor());
    let d_cov_compensation = if view.antialias_detached { [0.0; 3] } else { through_compensation };
    let mut d_cov2d = conic_backward(on_the_way, d.conic);
    for i in 0..3 {
        d_cov2d[i] += d_cov_compensation[i];
    }
    let (d_cov3d, d_jr) = covariance_backward(on_the_way, d_cov2d);
    let mut d_p = jacobian_backward(on_the_way, view, &d_jr);

    let [x, y, z] = on_the_way.p;
    let [fx, fy] = view.focal_px;
    d_p[0] += d.mean2d_px[0] * fx / z;
    d_p[1] += d.mean2d_px[1] * fy / z;
    d_p[2] -= (d.mean2d_px[0] * fx * x + d.mean2d_px[1] * fy * y) / (z * z);
    d_p[2] -= d.inverse_depth / (z * z);
    (d_p, d_cov3d)
}

/// The density statistic: norm of the 2-D mean's gradient in normalised device units.
pub fn mean2d_statistic(view: &View, d_mean2d_px: [f64; 2]) -> f64 {
    let ndc = [0, 1].map(|i| d_mean2d_px[i] * f64::from(view.size_px[i]) / 2.0);
    (ndc[0] * ndc[0] + ndc[1] * ndc[1]).sqrt()
}

/// Colour → SH, and through the view direction → mean.
fn color_backward(gaussian: &Gaussian, view: &View, d_color: [f64; 3], gradient: &mut Gradient) {
    let (_, raw) = color(gaussian, view);
    let d_raw = [0, 1, 2].map(|channel| if raw[channel] < 0.0 { 0.0 } else { d_color[channel] });
    let (direction, distance) = view_direction(gaussian, view);
    let (basis, slopes) = (sh::basis(direction), sh::basis_gradient(direction));
    let mut d_direction = [0.0; 3];
    for k in 0..sh::coefficients(view.sh_degree).min(gaussian.sh.len()) {
        gradient.sh[k] = d_raw.map(|x| x * basis[k]);
        let along = dot(gaussian.sh[k], d_raw);
        for i in 0..3 {
            d_direction[i] += slopes[k][i] * along;
        }
    }
    let radial = dot(direction, d_direction);
    for i in 0..3 {
        gradient.mean[i] += (d_direction[i] - direction[i] * radial) / distance;
    }
}

/// Compensated opacity → opacity, and the 2-D covariance through the compensation sqrt(det/det').
fn opacity_backward(on_the_way: &Intermediate, d_opacity: f64) -> (f64, [f64; 3]) {
    let (factor, floor_or_off) = on_the_way.compensation;
    let d_direct = d_opacity * factor;
    if floor_or_off {
        return (d_direct, [0.0; 3]);
    }
    let [a, b, c] = on_the_way.cov2d_undilated;
    let before = a * c - b * b;
    let (dilated_a, dilated_c) = (a + on_the_way.dilation_px2, c + on_the_way.dilation_px2);
    let after = dilated_a * dilated_c - b * b;
    let d_ratio = d_opacity * on_the_way.opacity / (2.0 * factor);
    let (d_before, d_after) = (d_ratio / after, -d_ratio * before / (after * after));
    let d_cov = [
        d_before * c + d_after * dilated_c,
        -2.0 * b * (d_before + d_after),
        d_before * a + d_after * dilated_a,
    ];
    (d_direct, d_cov)
}

/// (A, B, C) = (c, −b, a)/det → dL/d(a, b, c).
fn conic_backward(on_the_way: &Intermediate, [d_a, d_b, d_c]: [f64; 3]) -> [f64; 3] {
    let [a, b, c] = on_the_way.cov2d_undilated;
    let (a, c) = (a + on_the_way.dilation_px2, c + on_the_way.dilation_px2);
    let determinant = a * c - b * b;
    let inverse_square = 1.0 / (determinant * determinant);
    [
        inverse_square * (-c * c * d_a + b * c * d_b - b * b * d_c),
        inverse_square * (2.0 * b * c * d_a - (determinant + 2.0 * b * b) * d_b + 2.0 * a * b * d_c),
        inverse_square * (-b * b * d_a + a * b * d_b - a * a * d_c),
    ]
}

/// cov2d = (JR) Σ (JR)ᵀ → dL/dΣ and dL/d(JR).
fn covariance_backward(on_the_way: &Intermediate, d: [f64; 3]) -> (Mat3, Mat3) {
    // The off-diagonal element occurs twice in the matrix, each time with half of its gradient.
    let d_cov = [[d[0], d[1] / 2.0, 0.0], [d[1] / 2.0, d[2], 0.0], [0.0; 3]];
    let jr = &on_the_way.jr;
    let d_cov3d = multiply(&multiply(&transpose(jr), &d_cov), jr);
    let d_jr = scale(&multiply(&multiply(&d_cov, jr), &on_the_way.cov3d), 2.0);
    (d_cov3d, d_jr)
}

/// J → position in the camera's frame. A limited slope is constant, so t̂ = z·limit depends on z alone.
fn jacobian_backward(on_the_way: &Intermediate, view: &View, d_jr: &Mat3) -> [f64; 3] {
    let d_j = multiply(d_jr, &transpose(&view.camera_from_world));
    let z = on_the_way.p[2];
    let mut d_p = [0.0; 3];
    for axis in 0..2 {
        let focal = view.focal_px[axis];
        d_p[2] -= d_j[axis][axis] * focal / (z * z);
        // J[axis][2] = −f·slope/z
        d_p[2] += d_j[axis][2] * focal * on_the_way.slope[axis] / (z * z);
        if !on_the_way.limited[axis] {
            let d_slope = -d_j[axis][2] * focal / z;
            d_p[axis] += d_slope / z;
            d_p[2] -= d_slope * on_the_way.slope[axis] / z;
        }
    }
    d_p
}

/// Σ = M Mᵀ, M = R(q/|q|) diag(exp(log-scale)) → log-scale and quaternion.
fn shape_backward(on_the_way: &Intermediate, d_cov3d: &Mat3, gradient: &mut Gradient) {
    let (unit, norm) = on_the_way.unit_quat;
    let r = rotation(unit);
    let s = on_the_way.scale;
    let m = r.map(|row| [row[0] * s[0], row[1] * s[1], row[2] * s[2]]);
    let d_m = scale(&multiply(d_cov3d, &m), 2.0);
    for axis in 0..3 {
        let along: f64 = (0..3).map(|row| r[row][axis] * d_m[row][axis]).sum();
        gradient.log_scale[axis] = along * s[axis];
    }
    let d_r = d_m.map(|row| [row[0] * s[0], row[1] * s[1], row[2] * s[2]]);
    let d_unit = rotation_backward(unit, &d_r);
    let radial: f64 = unit.iter().zip(d_unit).map(|(q, d)| q * d).sum();
    gradient.quat = [0, 1, 2, 3].map(|i| (d_unit[i] - unit[i] * radial) / norm);
}
