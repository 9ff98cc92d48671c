//! `optimizer/adam` against its twin.

use crate::common::adam::{AdamState, Rates, Step, VisibleGradient};
use crate::common::compare::elementwise;
use crate::common::gpu::{Gpu, sizes};
use crate::common::scenes::{Random, mixed_scene};
use crate::reference::adam::{Parameter, adam, adam_sparse, is_skipped};
use crate::reference::expand_gradients::sh_gradient;
use crate::reference::types::Gaussian;

const RATES: Rates =
    Rates { mean: 1e-3, opacity: 0.025, quat: 2e-3, log_scale: 5e-3, sh_dc: 2.5e-3, sh_rest: 1.25e-4 };
const CAMERA: [f64; 3] = [0.5, -0.25, -5.0];

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

/// Gradients in the order of [`scalars`]; SH from the viewing direction.
fn gradient_scalars(g: &VisibleGradient, mean: [f64; 3], sh_degree: u32, stored: usize) -> Vec<f64> {
    let towards = [0, 1, 2].map(|i| mean[i] - CAMERA[i]);
    let distance = towards.iter().map(|x| x * x).sum::<f64>().sqrt();
    let mut all = g.mean.to_vec();
    all.extend(g.quat);
    all.extend(g.log_scale);
    all.push(g.opacity_logit);
    all.extend(sh_gradient(towards.map(|x| x / distance), g.color, sh_degree, stored).concat());
    all
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

/// Makes some steps on the device and with the twin.
fn check(gpu: &Gpu, size: usize, [sh_degree, stored]: [u32; 2], sparse: bool) {
    let mut random = Random::new(size as u64);
    let coefficients = ((stored + 1) * (stored + 1)) as usize;
    let gaussians = mixed_scene(&mut random, size, coefficients);
    let state = AdamState::new(gpu, &gaussians, sh_degree, sparse);
    let mut twins: Vec<Vec<Parameter>> = gaussians
        .iter()
        .map(|g| {
            scalars(g).into_iter().map(|(value, _)| Parameter { value, ..Parameter::default() }).collect()
        })
        .collect();
    for step in 1..=4 {
        let mut gradients = random_gradients(&mut random, size);
        if size > 12 && step == 2 {
            // Not finite: skipped and counted.
            gradients[4] = Some(VisibleGradient { mean: [f64::NAN, 0.0, 0.0], ..VisibleGradient::default() });
            gradients[8] =
                Some(VisibleGradient { quat: [0.0, 0.0, 0.0, f64::INFINITY], ..VisibleGradient::default() });
            gradients[12] =
                Some(VisibleGradient { color: [f64::NEG_INFINITY; 3], ..VisibleGradient::default() });
        }
        let [seen_from, ..] = state.download();
        let count = if sparse { 0 } else { step };
        let skipped = state.step(&gradients, &Step { rates: RATES, count, camera_position: CAMERA }, false);
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
            let rates = scalars(&gaussians[i]).into_iter().map(|(_, rate)| rate);
            for ((parameter, gradient), rate) in twin.iter_mut().zip(gradient).zip(rates) {
                match sparse {
                    true => adam_sparse(parameter, gradient, rate),
                    false => adam(parameter, gradient, rate, step as u32),
                }
            }
        }
        assert_eq!(skipped, expected_skipped, "step {step}");
        compare(&state, &twins);
    }
}

fn compare(state: &AdamState, twins: &[Vec<Parameter>]) {
    let [values, first, second] = state
        .download()
        .map(|g| g.iter().flat_map(|g| scalars(g).into_iter().map(|(x, _)| x)).collect::<Vec<f64>>());
    let column = |of: fn(&Parameter) -> f64| twins.iter().flatten().map(of).collect::<Vec<f64>>();
    elementwise("value", &values, &column(|p| p.value), 2e-6, 1e-6).expect("values");
    elementwise("first moment", &first, &column(|p| p.moment1), 1e-7, 2e-6).expect("first moments");
    elementwise("second moment", &second, &column(|p| p.moment2), 1e-12, 1e-5).expect("second moments");
}

#[test]
fn adam_equals_its_twin() {
    let gpu = Gpu::new();
    for size in sizes(gpu.workgroup(64) as usize).into_iter().filter(|&size| size > 0) {
        check(&gpu, size, [3, 3], false);
    }
}

#[test]
fn adam_of_every_degree_dense_and_sparse() {
    let gpu = Gpu::new();
    for degrees in [[0, 0], [0, 3], [1, 1], [1, 3], [2, 2], [2, 3], [3, 3]] {
        for sparse in [false, true] {
            check(&gpu, 100, degrees, sparse);
        }
    }
}

#[test]
fn adam_without_texels_equals_its_twin() {
    let gpu = Gpu::without_texels();
    for size in sizes(gpu.workgroup(64) as usize).into_iter().filter(|&size| size > 0) {
        check(&gpu, size, [3, 3], false);
    }
    for degrees in [[0, 0], [0, 3], [1, 3], [2, 2]] {
        for sparse in [false, true] {
            check(&gpu, 100, degrees, sparse);
        }
    }
}

#[test]
fn adam_without_texels_is_the_same_to_the_bit() {
    let gpus = [Gpu::new(), Gpu::without_texels()];
    let mut random = Random::new(8);
    let gaussians = mixed_scene(&mut random, 500, 16);
    let states = [0, 1].map(|k| AdamState::new(&gpus[k], &gaussians, 3, false));
    for count in 1..=3 {
        let gradients = random_gradients(&mut random, 500);
        for overflow in [false, true] {
            let step = Step { rates: RATES, count, camera_position: CAMERA };
            let [texels, stored] = [0, 1].map(|k| {
                let skipped = states[k].step(&gradients, &step, overflow);
                (skipped, states[k].download())
            });
            assert!(stored == texels, "step {count}");
        }
    }
}

/// If the device has moved the camera, only the camera block's position counts.
#[test]
fn adam_of_a_moved_camera_is_the_same_to_the_bit() {
    let gpu = Gpu::new();
    for (gpu, sparse) in [(&gpu, false), (&gpu, true), (&Gpu::without_texels(), false)] {
        let mut random = Random::new(9);
        let gaussians = mixed_scene(&mut random, 200, 16);
        let given = AdamState::new(gpu, &gaussians, 3, sparse);
        let moved = AdamState::new(gpu, &gaussians, 3, sparse).with_moved_camera(3, sparse);
        for count in 1..=2 {
            let gradients = random_gradients(&mut random, 200);
            let step = Step { rates: RATES, count, camera_position: CAMERA };
            let [given, moved] = [&given, &moved].map(|state| {
                let skipped = state.step(&gradients, &step, false);
                (skipped, state.download())
            });
            assert!(given == moved && given.0 == 0, "step {count}");
        }
    }
}

#[test]
fn adam_changes_nothing_after_an_overflow() {
    let gpu = Gpu::new();
    let mut random = Random::new(3);
    let gaussians = mixed_scene(&mut random, 50, 16);
    let state = AdamState::new(&gpu, &gaussians, 3, false);
    let before = state.download();
    let gradients = random_gradients(&mut random, 50);
    let skipped = state.step(&gradients, &Step { rates: RATES, count: 1, camera_position: CAMERA }, true);
    assert_eq!(skipped, 0);
    assert!(state.download() == before);
}

/// Gradients of the parameters themselves add to those of the frame, also outside the view. Sparse steps skip
/// Gaussians outside the view.
#[test]
fn adam_adds_gradients_of_the_parameters() {
    let gpu = Gpu::new();
    for (gpu, sparse) in [(&gpu, false), (&gpu, true), (&Gpu::without_texels(), false)] {
        let mut random = Random::new(12);
        let gaussians = mixed_scene(&mut random, 150, 16);
        let direct: Vec<Gaussian> = mixed_scene(&mut random, 150, 16)
            .into_iter()
            .map(|g| Gaussian { opacity_logit: 1e-5 * g.opacity_logit, ..g })
            .collect();
        let state = AdamState::new(gpu, &gaussians, 3, sparse).with_parameter_gradients(3, sparse, &direct);
        let gradients = random_gradients(&mut random, 150);
        let count = i32::from(!sparse);
        let skipped = state.step(&gradients, &Step { rates: RATES, count, camera_position: CAMERA }, false);
        assert_eq!(skipped, 0);
        let twins: Vec<Vec<Parameter>> = (gaussians.iter().zip(&gradients).zip(&direct))
            .map(|((gaussian, gradient), direct)| {
                let seen = gradient.unwrap_or_default();
                let mut sum = gradient_scalars(&seen, gaussian.mean, 3, 16);
                let own = scalars(&Gaussian { sh: vec![[0.0; 3]; 16], ..direct.clone() });
                sum.iter_mut().zip(own).for_each(|(sum, (own, _))| *sum += own);
                let step = |((value, rate), gradient): ((f64, f64), f64)| {
                    let mut parameter = Parameter { value, ..Parameter::default() };
                    match (sparse, gradient_is_seen(&seen)) {
                        (true, true) => adam_sparse(&mut parameter, gradient, rate),
                        (true, false) => {}
                        (false, _) => adam(&mut parameter, gradient, rate, 1),
                    }
                    parameter
                };
                scalars(gaussian).into_iter().zip(sum).map(step).collect()
            })
            .collect();
        compare(&state, &twins);
    }
}

fn gradient_is_seen(gradient: &VisibleGradient) -> bool {
    gradient.mean != [0.0; 3]
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
        let skipped =
            state.step(&gradients, &Step { rates: RATES, count: 1, camera_position: CAMERA }, false);
        assert_eq!(skipped, 0);
        let after = state.download();
        assert!(after.iter().zip(&before).all(|(after, before)| after[1] == before[1]), "degree {sh_degree}");
        assert!(after[0][0] != before[0][0], "the others take their step");
    }
}
