//! `exposure/exposure_step` against its twin.

use ashsplat::kernels::constants::{STATE_OVERFLOW, STATE_WORDS, TERM_PARTIALS};
use ashsplat::kernels::exposure::exposure_step::{Bind, Interface, Push, Spec};

use crate::common::compare::elementwise;
use crate::common::exposures::wide;
use crate::common::gpu::Gpu;
use crate::common::scenes::Random;
use crate::reference::expose::Matrix;
use crate::reference::exposure_step::Exposures;

type Rows = [[f32; 4]; 3];

/// A view, the parts of its gradient, and true if its frame overflowed.
type Seen = (u32, Vec<Rows>, bool);

/// Decay of all lens parameters, and of all exposure values but the diagonal.
const DECAY: f32 = 0.125;

/// Large enough that some matrices return to the identity, small enough that others do not.
const SPARSITY: f32 = 0.5;

/// Form of the kernel: exposures or lenses; steps after several views or one; second moments of all photographs or
/// of each; with or without a pull to the identity.
#[derive(Clone, Copy, Debug)]
struct Form {
    center: bool,
    sums: bool,
    shares: bool,
    sparse: bool,
}

const USUAL: Form = Form { center: true, sums: false, shares: false, sparse: false };

/// Runs steps of one view each on the device.
fn run(gpu: &Gpu, photographs: usize, form: Form, steps: &[Seen]) -> [Vec<Rows>; 3] {
    let views: Vec<_> = steps.iter().cloned().map(|step| (step, [true, true])).collect();
    run_views(gpu, photographs, form, &views)
}

/// Runs views on the device. Flags: the first view of a step, and the view that the step follows.
fn run_views(
    gpu: &Gpu,
    photographs: usize,
    Form { center, sums, shares, sparse }: Form,
    views: &[(Seen, [bool; 2])],
) -> [Vec<Rows>; 3] {
    let (workgroup_size, subgroup_size) = (gpu.workgroup(64), gpu.subgroup());
    let spec = Spec { workgroup_size, subgroup_size, center, sums, shares, sparse };
    let kernel = gpu.kernel::<Interface>(&spec);
    let start: Vec<Rows> =
        Exposures::new(photographs).values.iter().map(|m| m.map(|row| row.map(|x| x as f32))).collect();
    let values = gpu.buffer("exposures", &start);
    let moments = ["moments_1", "moments_2"].map(|name| gpu.zeros::<Rows>(name, photographs));
    let gradient_sums = gpu.untouched::<Rows>("sums", photographs);
    let mut count = 0;
    for ((view, parts, overflow), [starts, makes_step]) in views {
        let mut state = vec![0_u32; STATE_WORDS as usize];
        state[STATE_OVERFLOW as usize] = u32::from(*overflow);
        let state = gpu.buffer("state", &state);
        let partials = gpu.buffer("partials", parts);
        let bind = Bind {
            partials: &partials,
            state: &state,
            exposures: &values,
            moments_1: &moments[0],
            moments_2: &moments[1],
            sums: &gradient_sums,
        };
        // All views of a step have its count.
        count += i32::from(*starts);
        let push = Push {
            photographs: photographs as u32,
            view: *view,
            beta_1: 0.9,
            beta_2: 0.999,
            one_minus_beta_1: 0.1,
            one_minus_beta_2: 0.001,
            epsilon: 1e-8,
            rate: (0.01 / (1.0 - 0.9f64.powi(count))) as f32,
            inverse_bias_2: (1.0 - 0.999f64.powi(count)).sqrt().recip() as f32,
            makes_step: (*makes_step).into(),
            starts: (*starts).into(),
            decay: DECAY,
            sparsity: SPARSITY,
        };
        gpu.run(|r| r.dispatch(&kernel, &bind, &push, 1));
    }
    [&values, &moments[0], &moments[1]].map(|buffer| gpu.read::<Rows>(buffer, photographs))
}

fn parts(random: &mut Random) -> Vec<Rows> {
    (0..TERM_PARTIALS).map(|_| [[0.0; 4]; 3].map(|row| row.map(|_: f32| random.signed() as f32))).collect()
}

fn flat(all: &[Matrix]) -> Vec<f64> {
    all.iter().flat_map(|matrix| matrix.as_flattened().to_vec()).collect()
}

#[test]
fn exposure_step_equals_its_twin() {
    let gpu = Gpu::new();
    let workgroup = gpu.workgroup(64) as usize;
    let sparse = Form { shares: true, sparse: true, ..USUAL };
    let forms = [USUAL, Form { center: false, ..USUAL }, Form { shares: true, ..USUAL }, sparse];
    for (photographs, form) in [1, 3, workgroup - 1, workgroup, 3 * workgroup + 5]
        .into_iter()
        .flat_map(|n| forms.map(|form| (n, form)))
    {
        let mut random = Random::new(photographs as u64);
        let steps: Vec<_> =
            (0..7).map(|step| ((5 * step % photographs) as u32, parts(&mut random), false)).collect();
        let actual = run(&gpu, photographs, form, &steps);
        let twin = Exposures::new(photographs);
        let sparsity = if form.sparse { SPARSITY.into() } else { 0.0 };
        let mut twin = Exposures { decay: DECAY.into(), shares: form.shares, sparsity, ..twin };
        for (step, (view, parts, _)) in steps.iter().enumerate() {
            let mut gradient = [[0.0; 4]; 3];
            for part in parts {
                for (sum, x) in gradient.as_flattened_mut().iter_mut().zip(wide(part).as_flattened()) {
                    *sum += x;
                }
            }
            twin.step(*view as usize, &gradient, 0.01, step as i32 + 1, form.center);
        }
        let expected = [&twin.values, &twin.first, &twin.second];
        for ((name, tolerance), (actual, expected)) in
            [("values", 2e-6), ("first moments", 1e-5), ("second moments", 1e-4)]
                .into_iter()
                .zip(actual.iter().zip(expected))
        {
            let actual: Vec<Matrix> = actual.iter().map(wide).collect();
            elementwise(name, &flat(&actual), &flat(expected), tolerance, tolerance)
                .unwrap_or_else(|e| panic!("{photographs}, {form:?}: {e}"));
        }
    }
}

/// Steps after several views: one step has some photographs twice, others never. A view that overflowed adds
/// nothing.
#[test]
fn exposure_step_adds_up_views() {
    let gpu = Gpu::new();
    let many = gpu.workgroup(64) as usize + 3;
    for (photographs, shares, sparse) in
        [(2, false, false), (many, false, false), (2, true, false), (many, true, false), (many, true, true)]
    {
        let mut random = Random::new(photographs as u64);
        let groups: [&[usize]; 4] = [&[0, 1, 0], &[1], &[photographs - 1, 0], &[0, 0]];
        let mut views = vec![];
        let sparsity = if sparse { SPARSITY.into() } else { 0.0 };
        let mut twin = Exposures { decay: DECAY.into(), shares, sparsity, ..Exposures::new(photographs) };
        for (number, group) in groups.into_iter().enumerate() {
            for (place, &view) in group.iter().enumerate() {
                let mut gradient = [[0.0; 4]; 3];
                let parts = parts(&mut random);
                for part in &parts {
                    let sums = gradient.as_flattened_mut().iter_mut();
                    sums.zip(wide(part).as_flattened()).for_each(|(sum, x)| *sum += x);
                }
                twin.add(view, &gradient, place == 0);
                let at = [place == 0, place + 1 == group.len()];
                views.push(((view as u32, parts, false), at));
                if number == 0 && place == 0 {
                    views.push(((view as u32, self::parts(&mut random), true), [false, false]));
                }
            }
            twin.step_of_sums(0.01, number as i32 + 1, true);
        }
        let actual = run_views(&gpu, photographs, Form { sums: true, shares, sparse, ..USUAL }, &views);
        let actual: Vec<Matrix> = actual[0].iter().map(wide).collect();
        // A thousandth of a step. Where the steps of two photographs cancel in the mean, only rounding remains. Its
        // decay is the whole gradient of photographs without a view.
        elementwise("values", &flat(&actual), &flat(&twin.values), 1e-5, 1e-5)
            .unwrap_or_else(|e| panic!("{photographs}, {shares}: {e}"));
    }
}

/// A frame that overflowed changes nothing. A gradient that is not finite counts as zero, but moments still decay.
#[test]
fn exposure_step_survives_overflow_and_infinity() {
    let gpu = Gpu::new();
    let mut random = Random::new(3);
    let first = (1, parts(&mut random), false);
    let once = run(&gpu, 4, USUAL, std::slice::from_ref(&first));
    let again = run(&gpu, 4, USUAL, &[first.clone(), (2, parts(&mut random), true)]);
    assert_eq!(once, again);
    let mut infinite = parts(&mut random);
    infinite[7][1][2] = f32::INFINITY;
    let none = vec![[[0.0; 4]; 3]; TERM_PARTIALS as usize];
    let infinite = run(&gpu, 4, USUAL, &[first.clone(), (2, infinite, false)]);
    assert_eq!(infinite, run(&gpu, 4, USUAL, &[first, (2, none, false)]));
    assert_ne!(infinite, once);
}
