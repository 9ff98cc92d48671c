//! Random scenes and numbers, identical in every run.

use crate::reference::types::{Extent, Gaussian, Gradient, Style, View};

/// SplitMix64.
pub struct Random(u64);

impl Random {
    pub fn new(seed: u64) -> Random {
        Random(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15).wrapping_add(1))
    }

    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut x = self.0;
        x = (x ^ (x >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        x = (x ^ (x >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        x ^ (x >> 31)
    }

    pub fn below(&mut self, limit: u32) -> u32 {
        (((self.bits() >> 32) * u64::from(limit)) >> 32) as u32
    }

    /// Random number in [0, 1), exact in float32.
    pub fn unit(&mut self) -> f64 {
        (self.bits() >> 40) as f64 / f64::from(1 << 24)
    }

    /// Random number in [-1, 1), exact in float32.
    pub fn signed(&mut self) -> f64 {
        2.0 * self.unit() - 1.0
    }

    /// Random number in [low, high), rounded to float32.
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        f64::from((low + (high - low) * self.unit()) as f32)
    }

    /// Standard normal (Box and Muller).
    pub fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.unit()).ln()).sqrt();
        f64::from((radius * (std::f64::consts::TAU * self.unit()).cos()) as f32)
    }
}

/// A view of [`small_scene`]: exact extent, SH degree 3.
pub fn small_view(size_px: [u32; 2]) -> View {
    let focal = f64::from(size_px[0]);
    View {
        camera_from_world: rotation_about_y(0.125),
        translation: [0.0625, -0.03125, 4.0],
        focal_px: [focal, focal * 1.0625],
        center_px: size_px.map(|n| f64::from(n) / 2.0),
        size_px,
        background: [0.25, 0.5, 0.125],
        sh_degree: 3,
        antialias: false,
        antialias_detached: false,
        filter_3d: 0.0,
        symmetric_limit: false,
        extent: Extent::Exact,
        drawn: Style::AS_THEY_ARE,
    }
}

/// Other shapes: smaller Gaussians; opaque ellipsoids without faint Gaussians; dots. Every number is exact in
/// float32.
pub fn drawn_shapes() -> [Style; 3] {
    let exp = |steepness: f32| f64::from(steepness.exp());
    [
        Style { scale_modifier: 0.375, ..Style::AS_THEY_ARE },
        Style { scale_modifier: 0.25, dilation_px2: 0.015_625, opacity: -exp(40.0), ..Style::AS_THEY_ARE },
        Style { scale_modifier: 0.0, dilation_px2: 0.25, opacity: exp(3.75), ..Style::AS_THEY_ARE },
    ]
}

/// Gaussians around the origin, a few units from the camera. Every parameter is exact in float32.
pub fn small_scene(random: &mut Random, count: usize, coefficients: usize) -> Vec<Gaussian> {
    (0..count).map(|_| gaussian(random, 1.5, [-2.3, -0.7], coefficients)).collect()
}

/// One random Gaussian within ±`reach`, with log-scales in a range.
pub fn gaussian(random: &mut Random, reach: f64, log_scale: [f64; 2], coefficients: usize) -> Gaussian {
    Gaussian {
        mean: [0; 3].map(|_| random.between(-reach, reach)),
        quat: [0; 4].map(|_| random.normal()),
        log_scale: [0; 3].map(|_| random.between(log_scale[0], log_scale[1])),
        opacity_logit: random.between(-3.0, 4.0),
        sh: (0..coefficients)
            .map(|k| {
                let size = if k == 0 { 1.0 } else { 0.25 };
                [0; 3].map(|_| random.between(-size, size))
            })
            .collect(),
    }
}

/// Rotation about the camera's y axis, rounded to float32.
pub fn rotation_about_y(angle: f64) -> [[f64; 3]; 3] {
    let (sine, cosine) = (f64::from(angle.sin() as f32), f64::from(angle.cos() as f32));
    [[cosine, 0.0, sine], [0.0, 1.0, 0.0], [-sine, 0.0, cosine]]
}

/// Gaussians inside and outside the view of [`small_view`], near and behind the camera, faint, tiny and huge.
pub fn mixed_scene(random: &mut Random, count: usize, coefficients: usize) -> Vec<Gaussian> {
    (0..count)
        .map(|i| {
            let (reach, log_scale) = match i % 4 {
                0 => (1.5, [-2.5, -1.0]),
                1 => (6.0, [-4.0, -1.0]),
                2 => (3.0, [-9.0, -5.0]),
                _ => (2.0, [-1.0, 0.5]),
            };
            let mut gaussian = gaussian(random, reach, log_scale, coefficients);
            gaussian.opacity_logit = random.between(-8.0, 6.0);
            gaussian
        })
        .collect()
}

pub fn scalars(gaussian: &mut Gaussian) -> Vec<&mut f64> {
    let mut all: Vec<&mut f64> = gaussian.mean.iter_mut().collect();
    all.extend(gaussian.quat.iter_mut());
    all.extend(gaussian.log_scale.iter_mut());
    all.push(&mut gaussian.opacity_logit);
    all.extend(gaussian.sh.iter_mut().flatten());
    all
}

/// Gradients of one Gaussian, in the order of [`scalars`].
pub fn gradient_scalars(gradient: &Gradient) -> Vec<f64> {
    scalars(&mut as_gaussian(gradient)).into_iter().map(|x| *x).collect()
}

/// Names of the parameters, with the device's and the twin's gradients of all Gaussians.
pub fn by_parameter(actual: &[Gaussian], expected: &[Gradient]) -> [(&'static str, Vec<f64>, Vec<f64>); 5] {
    let expected: Vec<Gaussian> = expected.iter().map(as_gaussian).collect();
    type Parameter = fn(&Gaussian) -> Vec<f64>;
    let parameters: [(&str, Parameter); 5] = [
        ("means", |g| g.mean.to_vec()),
        ("quaternions", |g| g.quat.to_vec()),
        ("log-scales", |g| g.log_scale.to_vec()),
        ("opacities", |g| vec![g.opacity_logit]),
        ("SH", |g| g.sh.concat()),
    ];
    let flat = |of, all: &[Gaussian]| all.iter().flat_map(of).collect();
    parameters.map(|(name, of)| (name, flat(of, actual), flat(of, &expected)))
}

fn as_gaussian(gradient: &Gradient) -> Gaussian {
    let Gradient { mean, quat, log_scale, opacity_logit, sh } = gradient.clone();
    Gaussian { mean, quat, log_scale, opacity_logit, sh }
}
