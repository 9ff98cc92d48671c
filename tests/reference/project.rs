//! Projection of one Gaussian (spec: "Forward" 1–6), the twin of `forward/project`.

use super::filter_sizes::filtered;
use super::linear::{Mat3, apply, multiply, normalize_quat, rotation, sigmoid, transpose};
use super::tiles;
use super::types::{ALPHA_MIN, Extent, FAINT_OPACITY, Gaussian, NEAR, Splat, View};
use super::{cull, sh};

/// Intermediate values of the projection that the backward pass needs.
#[derive(Clone, Debug)]
pub struct Intermediate {
    /// Position in the camera's frame.
    pub p: [f64; 3],
    /// x/z and y/z after the Jacobian limits.
    pub slope: [f64; 2],
    /// True if the limit acted, per axis.
    pub limited: [bool; 2],
    /// Unit quaternion and the norm it was divided by.
    pub unit_quat: ([f64; 4], f64),
    pub scale: [f64; 3],
    /// Σ.
    pub cov3d: Mat3,
    /// J R, the third row zero.
    pub jr: Mat3,
    /// 2-D covariance (xx, xy, yy) before the dilation.
    pub cov2d_undilated: [f64; 3],
    /// Opacity before the compensation.
    pub opacity: f64,
    /// Factor on the opacity; true if its floor acted.
    pub compensation: (f64, bool),
    /// Added to both variances on the screen, px².
    pub dilation_px2: f64,
}

/// Lower and upper limits of x/z and y/z in the Jacobian.
pub fn slope_limits(view: &View) -> [[f64; 2]; 2] {
    [0, 1].map(|axis| {
        let size = f64::from(view.size_px[axis]);
        let focal = view.focal_px[axis];
        let tan_half_fov = size / (2.0 * focal);
        if view.symmetric_limit {
            let limit = f64::from(1.3_f32) * tan_half_fov;
            [-limit, limit]
        } else {
            let margin = (f64::from(1.3_f32) - 1.0) * tan_half_fov;
            let center = view.center_px[axis];
            [-center / focal - margin, (size - center) / focal + margin]
        }
    })
}

/// The projection before any cull decision; `None` before the near plane.
pub fn intermediate(gaussian: &Gaussian, view: &View) -> Option<Intermediate> {
    let gaussian = &filtered(gaussian, view.filter_3d);
    let p = cull::camera_position(gaussian, view);
    if p[2] <= NEAR {
        return None;
    }
    let limits = slope_limits(view);
    // With parallel rays, x and y do not change with z.
    let (z, raw) = match view.drawn.orthographic {
        true => (1.0, [0.0; 2]),
        false => (p[2], [p[0] / p[2], p[1] / p[2]]),
    };
    let limit =
        |i: usize| if view.drawn.orthographic { 0.0 } else { raw[i].clamp(limits[i][0], limits[i][1]) };
    let slope = [0, 1].map(limit);
    let limited = [0, 1].map(|i| slope[i] != raw[i]);

    let unit_quat = normalize_quat(gaussian.quat);
    let r = rotation(unit_quat.0);
    let drawn = view.drawn;
    let scale = gaussian.log_scale.map(|log_scale| log_scale.exp() * drawn.scale_modifier);
    let m = r.map(|row| [row[0] * scale[0], row[1] * scale[1], row[2] * scale[2]]);
    let cov3d = multiply(&m, &transpose(&m));

    let [fx, fy] = view.focal_px;
    let j = [[fx / z, 0.0, -fx * slope[0] / z], [0.0, fy / z, -fy * slope[1] / z], [0.0; 3]];
    let jr = multiply(&j, &view.camera_from_world);
    let cov = multiply(&multiply(&jr, &cov3d), &transpose(&jr));
    let [a, b, c] = [cov[0][0], cov[0][1], cov[1][1]];

    let determinant_before = a * c - b * b;
    let determinant_after = (a + drawn.dilation_px2) * (c + drawn.dilation_px2) - b * b;
    let ratio = determinant_before / determinant_after;
    let floor = f64::from(2.5e-5_f32);
    let replaced = drawn.opacity != 0.0;
    let compensation =
        if view.antialias && !replaced { (ratio.max(floor).sqrt(), ratio <= floor) } else { (1.0, true) };
    Some(Intermediate {
        p,
        slope,
        limited,
        unit_quat,
        scale,
        cov3d,
        jr,
        cov2d_undilated: [a, b, c],
        opacity: match sigmoid(gaussian.opacity_logit) {
            own if !replaced => own,
            faint if drawn.opacity < 0.0 && faint < FAINT_OPACITY => 0.0,
            _ => drawn.opacity.abs(),
        },
        compensation,
        dilation_px2: drawn.dilation_px2,
    })
}

pub fn project(gaussian: &Gaussian, view: &View) -> Option<Splat> {
    let on_the_way = intermediate(gaussian, view)?;
    let [a, b, c] = on_the_way.cov2d_undilated;
    let (a, c) = (a + view.drawn.dilation_px2, c + view.drawn.dilation_px2);
    let determinant = a * c - b * b;
    if determinant == 0.0 || !determinant.is_finite() {
        return None;
    }
    let p = on_the_way.p;
    let distance = if view.drawn.orthographic { 1.0 } else { p[2] };
    let splat = Splat {
        depth: p[2],
        mean2d_px: [0, 1].map(|i| view.focal_px[i] * p[i] / distance + view.center_px[i] - 0.5),
        cov2d: [a, b, c],
        conic: [c / determinant, -b / determinant, a / determinant],
        opacity: on_the_way.opacity
            * on_the_way.compensation.0
            * view.drawn.fading()
            * view.drawn.opacity_factor(),
        color: view.drawn.tinted(color(gaussian, view).0),
        radius_px: match view.extent {
            Extent::Exact => 0,
            Extent::Reference => radius_px([a, b, c]),
        },
    };
    let seen = match view.extent {
        Extent::Exact => splat.opacity >= ALPHA_MIN && !tiles::is_empty(tiles::exact_box(&splat, view)),
        Extent::Reference => !tiles::is_empty(tiles::reference_square(&splat, view)),
    };
    seen.then_some(splat)
}

/// ceil(3 sqrt(λ)), with the reference implementation's floor of 0.1 under the root.
pub fn radius_px([a, b, c]: [f64; 3]) -> i32 {
    let determinant = a * c - b * b;
    let middle = 0.5 * (a + c);
    let largest = middle + (middle * middle - determinant).max(f64::from(0.1_f32)).sqrt();
    (3.0 * largest.sqrt()).ceil() as i32
}

pub fn camera_position(view: &View) -> [f64; 3] {
    apply(&transpose(&view.camera_from_world), view.translation).map(|x| -x)
}

/// Colour from SH, clamped at 0, and the raw value.
pub fn color(gaussian: &Gaussian, view: &View) -> ([f64; 3], [f64; 3]) {
    let (direction, _) = view_direction(gaussian, view);
    let basis = sh::basis(direction);
    let active = sh::coefficients(view.sh_degree).min(gaussian.sh.len());
    let mut raw = [0.5; 3];
    for (y, coefficient) in basis.iter().zip(&gaussian.sh).take(active) {
        for channel in 0..3 {
            raw[channel] += y * coefficient[channel];
        }
    }
    (raw.map(|x| x.max(0.0)), raw)
}

/// Unit vector from the camera to the Gaussian, and the distance. With parallel rays, the ray direction and 1.
pub fn view_direction(gaussian: &Gaussian, view: &View) -> ([f64; 3], f64) {
    let eye = camera_position(view);
    if view.drawn.orthographic {
        return (view.camera_from_world[2], 1.0);
    }
    let v = [0, 1, 2].map(|i| gaussian.mean[i] - eye[i]);
    let distance = v.iter().map(|x| x * x).sum::<f64>().sqrt();
    (v.map(|x| x / distance), distance)
}
