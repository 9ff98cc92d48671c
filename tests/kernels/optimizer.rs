//! The kernels of `optimizer/` against their twins: `optimizer/adam` and `optimizer/add_noise`.

use crate::common::adam::{AdamState, Rates, Step, VisibleGradient};
use crate::common::prelude::*;
use crate::reference::adam::{Parameter, adam, adam_sparse, is_skipped};
use crate::reference::add_noise::noise;
use crate::reference::gather::random_normal;
use crate::reference::sh::sh_gradient;
use ashsplat::kernels::constants::{GRADIENT_PLANES, STATE_OVERFLOW};
use ashsplat::kernels::optimizer::add_noise;

const RATES: Rates =
    Rates { mean: 1e-3, opacity: 0.025, quat: 2e-3, log_scale: 5e-3, sh_dc: 2.5e-3, sh_rest: 1.25e-4 };
pub const CAMERA: [f64; 3] = [0.5, -0.25, -5.0];

/// All parameters of a Gaussian that the optimiser updates, with their rates.
fn scalars(gaussian: &Gaussian) -> Vec<(f64, f64)> {
    let mut all: Vec<(f64, f64)> = gaussian.mean.iter().map(|&x| (x, RATES.mean)).collect();
    all.extend(gaussian.quat.iter().map(|&x| (x, RATES.quat)));
    all.extend(gaussian.log_scale.iter().map(|&x| (x, RATES.log_scale)));
    all.push((gaussian.opacity_logit, RATES.opacity));
    for (k, coefficient) in gaussian.sh.iter().enumerate() {
        let rate = if k == 0 { RATES.sh_dc } else { RATES.sh_rest };
        all.extend(coefficient.iter().map(|&x| (x, rate)));
    }
    all
}

fn direction(mean: [f64; 3]) -> [f64; 3] {
    let towards = [0, 1, 2].map(|i| mean[i] - CAMERA[i]);
    let distance = towards.iter().map(|x| x * x).sum::<f64>().sqrt();
    towards.map(|x| x / distance)
}

/// Gradients in the order of [`scalars`]; SH from the viewing direction.
fn gradient_scalars(g: &VisibleGradient, mean: [f64; 3], sh_degree: u32, stored: usize) -> Vec<f64> {
    let own = [&g.mean[..], &g.quat, &g.log_scale, &[g.opacity_logit]].concat();
    [own, sh_gradient(direction(mean), g.color, sh_degree, stored).concat()].concat()
}

fn twin_of(gaussian: &Gaussian) -> Vec<Parameter> {
    scalars(gaussian).into_iter().map(|(value, _)| Parameter { value, ..Parameter::default() }).collect()
}

/// Makes a step of a Gaussian's parameters: step `number`, or a sparse one.
fn advance(twin: &mut [Parameter], gaussian: &Gaussian, gradient: Vec<f64>, number: Option<u32>) {
    for ((parameter, gradient), (_, rate)) in twin.iter_mut().zip(gradient).zip(scalars(gaussian)) {
        match number {
            None => adam_sparse(parameter, gradient, rate),
            Some(number) => adam(parameter, gradient, rate, number),
        }
    }
}

/// A step of the rates above; `count` is 0 for sparse steps.
fn step(count: i32) -> Step {
    Step { rates: RATES, count, camera_position: CAMERA }
}

fn random_gradients(random: &mut Random, count: usize) -> Vec<Option<VisibleGradient>> {
    let mut three = |scale: f64| [0; 3].map(|_| f64::from((scale * random.signed()) as f32));
    let gradients: Vec<VisibleGradient> = (0..count)
        .map(|i| VisibleGradient {
            mean: three(1e-3),
            opacity_logit: three(1e-5)[0],
            quat: {
                let [a, b, c] = three(1e-6);
                [a, b, c, a]
            },
            log_scale: three(if i % 7 == 0 { 0.0 } else { 1.0 }),
            color: three(1e-2),
        })
        .collect();
    gradients.into_iter().enumerate().map(|(i, g)| (i % 4 != 1).then_some(g)).collect()
}

fn check_adam(gpu: &Gpu, size: usize, [sh_degree, stored]: [u32; 2], sparse: bool) {
    let mut random = Random::new(size as u64);
    let coefficients = ((stored + 1) * (stored + 1)) as usize;
    let gaussians = mixed_scene(&mut random, size, coefficients);
    let state = AdamState::new(gpu, &gaussians, sh_degree, sparse);
    let mut twins: Vec<Vec<Parameter>> = gaussians.iter().map(twin_of).collect();
    for number in 1..=4 {
        let mut gradients = random_gradients(&mut random, size);
        if size > 12 && number == 2 {
            // Not finite: skipped and counted.
            let none = VisibleGradient::default();
            gradients[4] = Some(VisibleGradient { mean: [f64::NAN, 0.0, 0.0], ..none });
            gradients[8] = Some(VisibleGradient { quat: [0.0, 0.0, 0.0, f64::INFINITY], ..none });
            gradients[12] = Some(VisibleGradient { color: [f64::NEG_INFINITY; 3], ..none });
        }
        let [seen_from, ..] = state.download();
        let skipped = state.step(&gradients, &step(if sparse { 0 } else { number }), false);
        let mut expected_skipped = 0;
        for (i, twin) in twins.iter_mut().enumerate() {
            let gradient = match (&gradients[i], sparse) {
                (None, true) => continue,
                (None, false) => vec![0.0; twin.len()],
                (Some(g), _) => gradient_scalars(g, seen_from[i].mean, sh_degree, coefficients),
            };
            if is_skipped(&gradient) {
                expected_skipped += 1;
                continue;
            }
            advance(twin, &gaussians[i], gradient, (!sparse).then_some(number as u32));
        }
        assert_eq!(skipped, expected_skipped, "step {number}");
        compare_adam(&state, &twins);
    }
}

fn compare_adam(state: &AdamState, twins: &[Vec<Parameter>]) {
    let [values, first, second] = state
        .download()
        .map(|g| g.iter().flat_map(|g| scalars(g).into_iter().map(|(x, _)| x)).collect::<Vec<f64>>());
    let column = |of: fn(&Parameter) -> f64| twins.iter().flatten().map(of).collect::<Vec<f64>>();
    elementwise("value", &values, &column(|p| p.value), 2e-6, 1e-6).expect("values");
    elementwise("first moment", &first, &column(|p| p.moment1), 1e-7, 2e-6).expect("first moments");
    elementwise("second moment", &second, &column(|p| p.moment2), 1e-12, 1e-5).expect("second moments");
}

/// All sizes, and all degrees, dense and sparse.
#[test]
fn adam_equals_its_twin() {
    for gpu in [Gpu::new(), Gpu::without_texels()] {
        for size in sizes(gpu.workgroup(64) as usize).into_iter().filter(|&size| size > 0) {
            check_adam(&gpu, size, [3, 3], false);
        }
        for degrees in [[0, 0], [0, 3], [1, 1], [1, 3], [2, 2], [2, 3], [3, 3]] {
            check_adam(&gpu, 100, degrees, false);
            check_adam(&gpu, 100, degrees, true);
        }
    }
}

/// Packed moments and half floats are rounded at random: parameters differ little from exact steps, without a bias.
#[test]
fn adam_with_packed_moments_strays_little() {
    const STEPS: i32 = 300;
    for (gpu, sh_degree, sparse, halves) in [
        (Gpu::new(), 3, false, false),
        (Gpu::without_texels(), 3, true, true),
        (Gpu::new(), 1, false, false),
        (Gpu::new(), 3, false, true),
    ] {
        let mut random = Random::new(21);
        let gaussians = mixed_scene(&mut random, 150, 16);
        let mut state = AdamState::new(&gpu, &gaussians, sh_degree, sparse).packed();
        if halves {
            state = state.halves();
        }
        let gaussians = state.gaussians();
        let mut twins: Vec<Vec<Parameter>> = gaussians.iter().map(twin_of).collect();
        for number in 1..=STEPS {
            let gradients = random_gradients(&mut random, gaussians.len());
            let seen_from = state.gaussians();
            assert_eq!(state.step(&gradients, &step(if sparse { 0 } else { number }), number == 7), 0);
            for ((twin, gradient), seen) in twins.iter_mut().zip(&gradients).zip(&seen_from) {
                let Some(gradient) = gradient.filter(|_| number != 7) else { continue };
                let gradient = gradient_scalars(&gradient, seen.mean, sh_degree, 16);
                advance(twin, &gaussians[0], gradient, (!sparse).then_some(number as u32));
            }
        }
        let after = state.gaussians();
        let [mut way, mut off, mut sum] = [0.0; 3];
        for ((before, after), twin) in gaussians.iter().zip(&after).zip(&twins) {
            for (((before, rate), (after, _)), twin) in
                scalars(before).into_iter().zip(scalars(after)).zip(twin)
            {
                let moved = [twin.value - before, after - twin.value].map(|x| x / rate);
                way += moved[0] * moved[0];
                off += moved[1] * moved[1];
                sum += moved[1];
            }
        }
        let (share, side) = (f64::sqrt(off / way), sum / f64::sqrt(off));
        let max = if halves { 0.2 } else { 0.1 };
        assert!(share < max && side.abs() < 4.0, "degree {sh_degree}: strays by {share}, to one side {side}");
        let words: Vec<[u32; 4]> = gpu.read(&state.moments[0], 8);
        assert!(words[0] != [0; 4] && words[1] == [0; 4], "a Gaussian that no view sees has no moments");
    }
}

/// Asserts that two states make the same steps from the same gradients, and none after an overflow. Returns the
/// number of Gaussians skipped.
fn assert_same_steps(random: &mut Random, states: [&AdamState; 2], size: usize) -> u32 {
    let mut all_skipped = 0;
    for (count, overflow) in (1..=3).flat_map(|count| [(count, false), (count, true)]) {
        let gradients = random_gradients(random, size);
        let before = states[0].download();
        let [(skipped, after), other] = states.map(|state| {
            let skipped = state.step(&gradients, &step(count), overflow);
            (skipped, state.download())
        });
        assert!(after == other.1 && skipped == other.0, "step {count}");
        assert_eq!(after == before, overflow, "step {count}");
        all_skipped += skipped;
    }
    all_skipped
}

#[test]
fn adam_without_texels_is_the_same_to_the_bit() {
    let gpus = [Gpu::new(), Gpu::without_texels()];
    let mut random = Random::new(8);
    let gaussians = mixed_scene(&mut random, 500, 16);
    let [texels, stored] = gpus.each_ref().map(|gpu| AdamState::new(gpu, &gaussians, 3, false));
    assert_same_steps(&mut random, [&texels, &stored], 500);
}

/// If the device has moved the camera, only the camera block's position counts.
#[test]
fn adam_of_a_moved_camera_is_the_same_to_the_bit() {
    for (gpu, sparse) in [(Gpu::new(), false), (Gpu::new(), true), (Gpu::without_texels(), false)] {
        let mut random = Random::new(9);
        let gaussians = mixed_scene(&mut random, 200, 16);
        let given = AdamState::new(&gpu, &gaussians, 3, sparse);
        let moved = AdamState::new(&gpu, &gaussians, 3, sparse).with_moved_camera();
        assert_eq!(assert_same_steps(&mut random, [&given, &moved], 200), 0);
    }
}

/// Gradients of the parameters themselves add to those of the frame, also outside the view. Sparse steps skip
/// Gaussians outside the view.
#[test]
fn adam_adds_gradients_of_the_parameters() {
    for (gpu, sparse) in [(Gpu::new(), false), (Gpu::new(), true), (Gpu::without_texels(), false)] {
        let mut random = Random::new(12);
        let gaussians = mixed_scene(&mut random, 150, 16);
        let direct: Vec<Gaussian> = mixed_scene(&mut random, 150, 16)
            .into_iter()
            .map(|g| Gaussian { opacity_logit: 1e-5 * g.opacity_logit, ..g })
            .collect();
        let state = AdamState::new(&gpu, &gaussians, 3, sparse).with_parameter_gradients(&direct);
        let gradients = random_gradients(&mut random, 150);
        assert_eq!(state.step(&gradients, &step(i32::from(!sparse)), false), 0);
        let twins: Vec<Vec<Parameter>> = (gaussians.iter().zip(&gradients).zip(&direct))
            .map(|((gaussian, gradient), direct)| {
                let seen = gradient.unwrap_or_default();
                let mut sum = gradient_scalars(&seen, gaussian.mean, 3, 16);
                let own = scalars(&Gaussian { sh: vec![[0.0; 3]; 16], ..direct.clone() });
                sum.iter_mut().zip(own).for_each(|(sum, (own, _))| *sum += own);
                let mut twin = twin_of(gaussian);
                if !sparse || gradient.is_some() {
                    advance(&mut twin, gaussian, sum, (!sparse).then_some(1));
                }
                twin
            })
            .collect();
        compare_adam(&state, &twins);
    }
}

/// A Gaussian at the camera has no direction, but it is never visible and needs none.
#[test]
fn adam_leaves_a_gaussian_at_the_camera_finite() {
    let gpu = Gpu::new();
    let mut random = Random::new(4);
    for sh_degree in 0..=3 {
        let mut gaussians = mixed_scene(&mut random, 3, 16);
        gaussians[1].mean = CAMERA;
        let state = AdamState::new(&gpu, &gaussians, sh_degree, false);
        let before = state.download();
        let mut gradients = random_gradients(&mut random, 3);
        gradients[1] = None;
        assert_eq!(state.step(&gradients, &step(1), false), 0);
        let after = state.download();
        assert!(after.iter().zip(&before).all(|(after, before)| after[1] == before[1]), "degree {sh_degree}");
        assert!(after[0][0] != before[0][0], "the others take their step");
    }
}

/// Gradients of a view's visible Gaussians, as the projection's backward pass leaves them.
pub struct GradientRows {
    /// Visible index of each Gaussian.
    pub visible: Vec<u32>,
    pub rows: Vec<[f32; 4]>,
    pub stride: usize,
}

impl GradientRows {
    pub fn random(random: &mut Random, size: usize) -> GradientRows {
        let mut count = 0;
        let mut place = |is_seen: bool| {
            count += u32::from(is_seen);
            if is_seen { count - 1 } else { u32::MAX }
        };
        let visible = (0..size).map(|_| place(random.below(3) > 0)).collect();
        let stride = count as usize + 2;
        let rows = (0..GRADIENT_PLANES as usize * stride).map(|_| [0; 4].map(|_| random.signed() as f32));
        GradientRows { visible, rows: rows.collect(), stride }
    }

    /// Row of a Gaussian in a plane; 0 out of view.
    pub fn row(&self, gaussian: usize, plane: usize) -> [f32; 4] {
        match self.visible[gaussian] {
            u32::MAX => [0.0; 4],
            visible => self.rows[plane * self.stride + visible as usize],
        }
    }

    /// The gradient of a Gaussian with this mean.
    pub fn gradient(&self, gaussian: usize, mean: [f64; 3], degree: u32, stored: usize) -> Gaussian {
        let [[x, y, z, opacity_logit], quat, [a, b, c, _], [red, green, blue, _]] =
            [0, 1, 2, 3].map(|plane| self.row(gaussian, plane).map(f64::from));
        let sh = sh_gradient(direction(mean), [red, green, blue], degree, stored);
        Gaussian { mean: [x, y, z], quat, log_scale: [a, b, c], opacity_logit, sh }
    }
}

const FIRST: u32 = 9;
const STREAM: u32 = 4;

fn moved(gpu: &Gpu, gaussians: &[Gaussian], overflow: u32) -> Vec<Gaussian> {
    let spec = add_noise::Spec { workgroup_size: gpu.workgroup(64), explicit_noise: false };
    let count = gaussians.len();
    let parameters = gpu.gaussians("parameters", gaussians);
    let bind = add_noise::Bind {
        parameters: &parameters,
        state: &gpu.frame_state(&[(STATE_OVERFLOW, overflow)]),
        noise: &gpu.buffer("noise", &[[0.0_f32; 3]; 2]),
    };
    let push = add_noise::Push { first: FIRST, count: count as u32, seed: 7, iteration: 11, rate: 3.0 };
    gpu.dispatch_over::<add_noise::Interface>(&spec, &bind, &push, count);
    gpu.read_gaussians(&parameters, count, 4)
}

/// Some opacities let the noise through, others block it.
fn scene(size: usize) -> Vec<Gaussian> {
    let mut gaussians = mixed_scene(&mut Random::new(size as u64), size, 4);
    for (i, gaussian) in gaussians.iter_mut().enumerate() {
        gaussian.opacity_logit = [-12.0, -5.25, -4.0, -3.0, 0.0, 80.0][i % 6];
    }
    gaussians
}

fn compare_moved(before: &[Gaussian], after: &[Gaussian]) {
    for (i, (before, after)) in before.iter().zip(after).enumerate() {
        let delta = noise(before, random_normal([7, 11, FIRST + i as u32, STREAM]), 3.0);
        let expected = [0, 1, 2].map(|axis| before.mean[axis] + delta[axis]);
        let largest = delta.iter().fold(0.0, |max: f64, x| max.max(x.abs()));
        // Bounds the error of the normal numbers too.
        let bound = 1.001e-2 * largest + 1e-6 * (1.0 + before.mean.iter().map(|x| x.abs()).sum::<f64>());
        elementwise("mean", &after.mean, &expected, bound, 1e-6).unwrap_or_else(|e| panic!("{i}: {e}"));
        let rest = |g: &Gaussian| Gaussian { mean: [0.0; 3], ..g.clone() };
        assert_eq!(rest(after), rest(before), "{i}");
    }
}

#[test]
fn add_noise_equals_its_twin() {
    let gpu = Gpu::new();
    for size in sizes(gpu.workgroup(64) as usize) {
        let gaussians = scene(size);
        compare_moved(&gaussians, &moved(&gpu, &gaussians, 0));
    }
}

#[test]
fn add_noise_leaves_overflowed_frames_alone() {
    let gpu = Gpu::new();
    let gaussians = scene(300);
    assert_eq!(moved(&gpu, &gaussians, 1), gaussians);
}
