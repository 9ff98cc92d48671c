//! The kernels of `exposure/` against their twins: `exposure/expose` and `exposure/expose_backward`, of exposures and of lens
//! effects, and `exposure/exposure_step`.

use super::pixels::{SIZES, layouts, sides};
use crate::common::prelude::*;
use crate::common::terms::{colors, place, values};
use crate::reference::exposure::{self as twin, Exposures, IDENTITY, Matrix, Rows};
use crate::reference::pixels::picture_to_rows;
use ashsplat::kernels::constants::{STATE_OVERFLOW, TERM_PARTIALS};
use ashsplat::kernels::exposure::{expose, expose_backward, exposure_step};

const BACKGROUND: [f32; 3] = [0.25, 0.5, 0.75];

/// Random values in a picture's native layout, and the colours that they encode.
fn picture(random: &mut Random, size: [usize; 2], strips: bool) -> (Vec<f32>, Vec<[f64; 3]>) {
    let native: Vec<f32> = (0..values(size)).map(|_| random.unit() as f32).collect();
    let wide: Vec<f64> = native.iter().copied().map(f64::from).collect();
    let rows = picture_to_rows(&wide, size, strips, BACKGROUND.map(f64::from));
    (native, rows.into_iter().map(|[r, g, b, _]| [r, g, b]).collect())
}

/// Different matrices near the identity.
fn matrices(random: &mut Random, count: usize) -> Vec<[[f32; 4]; 3]> {
    let near = |identity: f64, random: &mut Random| (identity + 0.3 * random.signed()) as f32;
    (0..count).map(|_| IDENTITY.map(|row| row.map(|x| near(x, random)))).collect()
}

fn wide(matrix: &[[f32; 4]; 3]) -> Matrix {
    matrix.map(|row| row.map(f64::from))
}

/// Principal point of all pictures, as a share of their size.
const CENTER: [f32; 2] = [0.4, 0.55];

/// Random parameters near zero.
fn lenses(random: &mut Random, count: usize) -> Vec<[[f32; 4]; 3]> {
    (0..count).map(|_| [[0.0; 4]; 3].map(|row| row.map(|_: f32| (0.4 * random.signed()) as f32))).collect()
}

/// Returns the principal point, one over the square of half the diagonal, and the squared radii.
fn plane([width, height]: [u32; 2]) -> ([f32; 2], f32, Vec<f64>) {
    let center = [CENTER[0] * width as f32, CENTER[1] * height as f32];
    let inverse_square = 4.0 / (width * width + height * height) as f32;
    let r2 = twin::squares_of_radii([width as usize, height as usize], center.map(f64::from));
    (center, inverse_square, r2)
}

/// Three rows of an exposure or a lens.
type Floats = [[f32; 4]; 3];

/// Number of values that a kernel writes in both layouts: whole strips.
fn padded(size: [u32; 2], strips: bool) -> usize {
    (size[0] * if strips { size[1].next_multiple_of(8) } else { size[1] }) as usize
}

/// Checks the colours of an output. The loss's window reads below the picture, and its kernels add the fourth value as
/// a transmittance: these are 0. No other word is written.
fn check_picture(actual: &[f32], size: [u32; 2], strips: bool, expected: &[[f64; 3]], [abs, rel]: [f64; 2]) {
    let sides = sides(size);
    let color = colors(actual, sides, strips);
    elementwise("color", color.as_flattened(), expected.as_flattened(), abs, rel).expect("the picture");
    let pixels = sides[0] * sides[1];
    assert!(strips || (0..pixels).all(|pixel| actual[4 * pixel + 3] == 0.0));
    let mut rest = actual.to_vec();
    for (pixel, channel) in (0..pixels).flat_map(|pixel| [(pixel, 0), (pixel, 1), (pixel, 2)]) {
        rest[place(sides, strips, pixel, channel)] = 0.0;
    }
    let kept = |value: &f32| *value == 0.0 || value.to_bits() == UNTOUCHED;
    assert!(rest.iter().all(kept), "written outside of the picture");
}

#[test]
fn expose_equals_its_twin() {
    let gpu = Gpu::new();
    for (size, strips) in layouts(SIZES) {
        let ([image_width, image_height], sides) = (size, sides(size));
        let mut random = Random::new(u64::from(image_width));
        let (native, colors_before) = picture(&mut random, sides, strips);
        let exposures = matrices(&mut random, 4);
        let to = gpu.untouched::<f32>("exposed", values(sides));
        let push = expose::Push {
            image_width,
            image_height,
            background: BACKGROUND,
            matrix: 2,
            ..Default::default()
        };
        let bind = expose::Bind {
            rendered: &gpu.buffer("rendered", &native),
            matrices: &gpu.buffer("exposures", &exposures),
            exposed: &to,
        };
        let spec = expose::Spec { workgroup_size: gpu.workgroup(64), strips, lens: false };
        gpu.dispatch_over::<expose::Interface>(&spec, &bind, &push, padded(size, strips));
        let actual = gpu.read::<f32>(&to, values(sides));
        check_picture(&actual, size, strips, &twin::expose(&colors_before, &wide(&exposures[2])), [1e-6; 2]);
        let below_picture =
            (sides[1]..sides[1].next_multiple_of(8)).flat_map(|y| (0..sides[0]).map(move |x| (x, y)));
        // The index of later planes differs in a higher picture.
        let below = |(x, y): (usize, usize)| place([sides[0], y + 1], strips, y * sides[0] + x, 0);
        assert!(!strips || below_picture.map(below).all(|at| actual[at] == 0.0), "below the picture");
    }
}

/// Runs the kernel of lens effects over a random picture. Returns output and input.
fn with_effects(
    gpu: &Gpu,
    (size, strips): ([u32; 2], bool),
    rows: &[Floats],
    matrix: u32,
) -> (Vec<f32>, Vec<[f64; 3]>) {
    let ([image_width, image_height], sides) = (size, sides(size));
    let (native, before) = picture(&mut Random::new(u64::from(image_width)), sides, strips);
    let to = gpu.untouched::<f32>("shaded", values(sides));
    let (center_px, inverse_square, _) = plane(size);
    let background = BACKGROUND;
    let push = expose::Push { image_width, image_height, background, matrix, center_px, inverse_square };
    let bind = expose::Bind {
        rendered: &gpu.buffer("rendered", &native),
        matrices: &gpu.buffer("lenses", rows),
        exposed: &to,
    };
    let spec = expose::Spec { workgroup_size: gpu.workgroup(64), strips, lens: true };
    gpu.dispatch_over::<expose::Interface>(&spec, &bind, &push, padded(size, strips));
    (gpu.read::<f32>(&to, values(sides)), before)
}

#[test]
fn lens_effects_equals_its_twin() {
    let gpu = Gpu::new();
    for (size, strips) in layouts(SIZES) {
        let all = lenses(&mut Random::new(u64::from(size[1])), 4);
        let (actual, before) = with_effects(&gpu, (size, strips), &all, 2);
        let (.., r2) = plane(size);
        let expected = twin::lens_effects(&before, &wide(&all[2]), &r2);
        check_picture(&actual, size, strips, &expected, [4e-6, 8e-6]);
    }
}

/// Neutral effects leave the picture's bits, so that a run starts as it would without effects.
#[test]
fn lens_effects_of_none_is_the_picture() {
    let gpu = Gpu::new();
    for strips in [false, true] {
        let (actual, before) = with_effects(&gpu, ([37, 20], strips), &[[[0.0; 4]; 3]], 0);
        let color = colors(&actual, [37, 20], strips);
        if strips {
            assert_eq!(color, before);
        } else {
            // The kernel adds the background.
            elementwise("color", color.as_flattened(), before.as_flattened(), 1e-7, 1e-7).expect("none");
        }
    }
}

/// Inputs and outputs of a kernel that propagates a picture's gradient.
struct Backward<'a> {
    gpu: &'a Gpu,
    size: [u32; 2],
    strips: bool,
    rendered: Buffer,
    before: Vec<f32>,
    gradient: Buffer,
    partials: Buffer,
}

impl<'a> Backward<'a> {
    /// Layouts of all sizes, of which the last has more pixels than invocations.
    fn layouts(gpu: &Gpu) -> impl Iterator<Item = ([u32; 2], bool)> + use<> {
        layouts(SIZES.into_iter().chain([[300, 2 * gpu.workgroup(64).div_ceil(2) + 40]]))
    }

    fn new(gpu: &'a Gpu, (size, strips): ([u32; 2], bool), native: &[f32], before: Vec<f32>) -> Backward<'a> {
        Backward {
            gpu,
            size,
            strips,
            rendered: gpu.buffer("rendered", native),
            gradient: gpu.buffer("image_gradient", &before),
            before,
            partials: gpu.untouched::<Floats>("partials", TERM_PARTIALS as usize),
        }
    }

    /// Runs the kernel with the second of the matrices. `push` has the lens' plane.
    fn run(&self, lens: bool, matrices: &Buffer, push: expose_backward::Push) {
        let gpu = self.gpu;
        let (workgroup_size, subgroup_size, strips) = (gpu.workgroup(64), gpu.subgroup(), self.strips);
        let spec = expose_backward::Spec { workgroup_size, subgroup_size, strips, lens };
        let ([image_width, image_height], background) = (self.size, BACKGROUND);
        let push = expose_backward::Push { image_width, image_height, background, matrix: 1, ..push };
        let bind = expose_backward::Bind {
            rendered: &self.rendered,
            matrices,
            image_gradient: &self.gradient,
            partials: &self.partials,
        };
        gpu.dispatch::<expose_backward::Interface>(&spec, &bind, &push, TERM_PARTIALS.into());
    }

    /// Compares the gradients of the picture and of the rows with the twin's.
    fn check(&self, (of_picture, of_rows): (Vec<[f64; 3]>, Matrix), absolute: f64, relative: [f64; 2]) {
        let (gpu, sides, strips) = (self.gpu, sides(self.size), self.strips);
        let after = gpu.read::<f32>(&self.gradient, values(sides));
        let actual = colors(&after, sides, strips);
        let (actual, expected) = (actual.as_flattened(), of_picture.as_flattened());
        elementwise("d_picture", actual, expected, absolute, relative[0]).expect("the picture's gradient");
        let mut rest = self.before.clone();
        for pixel in 0..sides[0] * sides[1] {
            for at in [0, 1, 2].map(|channel| place(sides, strips, pixel, channel)) {
                rest[at] = after[at];
            }
        }
        assert_eq!(rest, after, "changed outside of the picture");
        let sums = sum(&gpu.read::<Floats>(&self.partials, TERM_PARTIALS as usize));
        let bound = absolute * (1.0 + (sides[0] * sides[1]) as f64).sqrt();
        elementwise("d_rows", sums.as_flattened(), of_rows.as_flattened(), bound, relative[1])
            .expect("the gradient of the rows");
    }
}

fn sum(parts: &[Floats]) -> Matrix {
    let mut sums = [[0.0; 4]; 3];
    for part in parts {
        for (sum, x) in sums.as_flattened_mut().iter_mut().zip(part.as_flattened()) {
            *sum += f64::from(*x);
        }
    }
    sums
}

#[test]
fn expose_backward_equals_its_twin() {
    let gpu = Gpu::new();
    for (size, strips) in Backward::layouts(&gpu) {
        let sides = sides(size);
        let mut random = Random::new(u64::from(size[0]));
        let (native, picture) = picture(&mut random, sides, strips);
        let exposures = matrices(&mut random, 3);
        let before: Vec<f32> = (0..values(sides)).map(|_| random.signed() as f32).collect();
        let g = colors(&before, sides, strips);
        let backward = Backward::new(&gpu, (size, strips), &native, before);
        backward.run(false, &gpu.buffer("exposures", &exposures), Default::default());
        backward.check(twin::expose_backward(&picture, &wide(&exposures[1]), &g), 1e-6, [1e-6, 1e-5]);
    }
}

#[test]
fn lens_backward_equals_its_twin() {
    let gpu = Gpu::new();
    for (size, strips) in Backward::layouts(&gpu) {
        let sides = sides(size);
        let mut random = Random::new(u64::from(size[0]));
        let (native, picture) = picture(&mut random, sides, strips);
        let all = lenses(&mut random, 3);
        let rows = wide(&all[1]);
        let (center_px, inverse_square, r2) = plane(size);
        let mut before: Vec<f32> = (0..values(sides)).map(|_| random.signed() as f32).collect();
        for (pixel, color) in picture.iter().enumerate() {
            if twin::has_corner(color, &rows, r2[pixel]) {
                (0..3).for_each(|k| before[place(sides, strips, pixel, k)] = 0.0);
            }
        }
        let h = colors(&before, sides, strips);
        let backward = Backward::new(&gpu, (size, strips), &native, before);
        let push = expose_backward::Push { center_px, inverse_square, ..Default::default() };
        backward.run(true, &gpu.buffer("lenses", &all), push);
        backward.check(twin::lens_backward(&picture, &rows, &r2, &h), 1e-5, [2e-5, 2e-5]);
    }
}

/// The twin's gradients match finite differences of L = Σ h y.
#[test]
fn lens_backward_is_the_derivative() {
    let mut random = Random::new(4);
    let (_, mut picture) = picture(&mut random, [13, 9], false);
    // Also values on the straight line, and below 0.
    picture[3] = [1e-4, -0.2, 5e-4];
    let rows = wide(&lenses(&mut random, 1)[0]);
    let (.., r2) = plane([13, 9]);
    let h: Vec<[f64; 3]> = picture.iter().map(|_| [0; 3].map(|_| random.signed())).collect();
    let loss = |picture: &[[f64; 3]], rows: &Rows| -> f64 {
        let behind = twin::lens_effects(picture, rows, &r2);
        behind.as_flattened().iter().zip(h.as_flattened()).map(|(y, h)| y * h).sum()
    };
    let (of_picture, of_rows) = twin::lens_backward(&picture, &rows, &r2, &h);
    let check = |what: [usize; 2], loss: &dyn Fn(f64) -> f64, gradient: f64, tolerance: f64| {
        let step = 1e-6;
        let difference = (loss(step) - loss(-step)) / (2.0 * step);
        let close = (difference - gradient).abs() < tolerance * (1.0 + gradient.abs());
        assert!(close, "{what:?}: {difference} {gradient}");
    };
    for (c, k) in (0..3).flat_map(|c| (0..4).map(move |k| (c, k))) {
        let moved = |by: f64| {
            let mut moved = rows;
            moved[c][k] += by;
            loss(&picture, &moved)
        };
        check([c, k], &moved, of_rows[c][k], 1e-7);
    }
    for (pixel, c) in [0, 3, 60, 116].into_iter().flat_map(|pixel| (0..3).map(move |c| (pixel, c))) {
        let moved = |by: f64| {
            let mut moved = picture.clone();
            moved[pixel][c] += by;
            loss(&moved, &rows)
        };
        check([pixel, c], &moved, of_picture[pixel][c], 1e-6);
    }
}

/// A view of a photograph, the parts of its gradient, and true if its frame overflowed.
type Seen = (u32, Vec<Floats>, bool);

/// Decay of all lens parameters, and of all exposure values but the diagonal.
const DECAY: f32 = 0.125;

/// Large enough that some matrices return to the identity, small enough that others do not.
const SPARSITY: f32 = 0.5;

/// Form of the step: exposures or lenses; second moments of all photographs or of each; with or without a pull to
/// the identity.
#[derive(Clone, Copy, Debug)]
struct Form {
    center: bool,
    shares: bool,
    sparse: bool,
}

const USUAL: Form = Form { center: true, shares: false, sparse: false };

impl Form {
    fn twin(self, photographs: usize) -> Exposures {
        let sparsity = if self.sparse { SPARSITY.into() } else { 0.0 };
        Exposures { decay: DECAY.into(), shares: self.shares, sparsity, ..Exposures::new(photographs) }
    }

    fn run(self, gpu: &Gpu, photographs: usize, steps: &[Seen]) -> [Vec<Floats>; 3] {
        let Form { center, shares, sparse } = self;
        let (workgroup_size, subgroup_size) = (gpu.workgroup(64), gpu.subgroup());
        let spec = exposure_step::Spec { workgroup_size, subgroup_size, center, shares, sparse };
        let start: Vec<Floats> =
            Exposures::new(photographs).values.iter().map(|m| m.map(|row| row.map(|x| x as f32))).collect();
        let exposures = gpu.buffer("exposures", &start);
        let [moments_1, moments_2] =
            ["moments_1", "moments_2"].map(|name| gpu.zeros::<Floats>(name, photographs));
        for ((view, parts, overflow), count) in steps.iter().zip(1..) {
            let bind = exposure_step::Bind {
                partials: &gpu.buffer("partials", parts),
                state: &gpu.frame_state(&[(STATE_OVERFLOW, (*overflow).into())]),
                exposures: &exposures,
                moments_1: &moments_1,
                moments_2: &moments_2,
            };
            let push = exposure_step::Push {
                photographs: photographs as u32,
                view: *view,
                rate: (0.01 / (1.0 - 0.9f64.powi(count))) as f32,
                inverse_bias_2: (1.0 - 0.999f64.powi(count)).sqrt().recip() as f32,
                decay: DECAY,
                sparsity: SPARSITY,
            };
            gpu.dispatch::<exposure_step::Interface>(&spec, &bind, &push, 1);
        }
        [exposures, moments_1, moments_2].map(|buffer| gpu.read::<Floats>(&buffer, photographs))
    }
}

fn parts(random: &mut Random) -> Vec<Floats> {
    (0..TERM_PARTIALS).map(|_| [[0.0; 4]; 3].map(|row| row.map(|_: f32| random.signed() as f32))).collect()
}

fn compare(what: &str, actual: &[Floats], expected: &[Matrix], tolerance: f64) {
    let actual: Vec<f64> = actual.as_flattened().as_flattened().iter().copied().map(f64::from).collect();
    let expected = expected.as_flattened().as_flattened();
    elementwise(what, &actual, expected, tolerance, tolerance).expect("exposures");
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
        let [values, first, second] = form.run(&gpu, photographs, &steps);
        let mut expected = form.twin(photographs);
        for (step, (view, parts, _)) in steps.iter().enumerate() {
            expected.step(*view as usize, &sum(parts), 0.01, step as i32 + 1, form.center);
        }
        let case = format!("{photographs}, {form:?}");
        compare(&format!("{case}: values"), &values, &expected.values, 2e-6);
        compare(&format!("{case}: first moments"), &first, &expected.first, 1e-5);
        compare(&format!("{case}: second moments"), &second, &expected.second, 1e-4);
    }
}

/// A frame that overflowed changes nothing. A gradient that is not finite counts as zero, but moments still decay.
#[test]
fn exposure_step_survives_overflow_and_infinity() {
    let gpu = Gpu::new();
    let mut random = Random::new(3);
    let first = (1, parts(&mut random), false);
    let run = |steps: &[Seen]| USUAL.run(&gpu, 4, steps);
    let once = run(std::slice::from_ref(&first));
    assert_eq!(once, run(&[first.clone(), (2, parts(&mut random), true)]));
    let mut infinite = parts(&mut random);
    infinite[7][1][2] = f32::INFINITY;
    let none = vec![[[0.0; 4]; 3]; TERM_PARTIALS as usize];
    let infinite = run(&[first.clone(), (2, infinite, false)]);
    assert_eq!(infinite, run(&[first, (2, none, false)]));
    assert_ne!(infinite, once);
}
