//! `exposure/lens_backward` against its twin, and the twin against finite differences of the forward twin.

use ashsplat::kernels::constants::TERM_PARTIALS;
use ashsplat::kernels::exposure::lens_backward::{Bind, Interface, Push, Spec};

use super::picture_to_rows::SIZES;
use crate::common::compare::elementwise;
use crate::common::exposures::{BACKGROUND, colors, picture, place, values};
use crate::common::gpu::Gpu;
use crate::common::lens_rows::{lenses, plane, wide};
use crate::common::scenes::Random;
use crate::reference::lens_backward::lens_backward;
use crate::reference::lens_effects::{Rows, has_corner, lens_effects};

#[test]
fn lens_backward_equals_its_twin() {
    let gpu = Gpu::new();
    let workgroup_size = gpu.workgroup(64);
    // The last has more pixels than invocations.
    let large = [300, 2 * workgroup_size.div_ceil(2) + 40];
    for (size, strips) in SIZES.into_iter().chain([large]).flat_map(|size| [(size, true), (size, false)]) {
        let sides = [size[0] as usize, size[1] as usize];
        let mut random = Random::new(u64::from(size[0]));
        let (native, picture) = picture(&mut random, sides, strips);
        let all = lenses(&mut random, 3);
        let rows = wide(&all[1]);
        let (center_px, inverse_square, r2) = plane(size);
        let mut before: Vec<f32> = (0..values(sides)).map(|_| random.signed() as f32).collect();
        for (pixel, color) in picture.iter().enumerate() {
            if has_corner(color, &rows, r2[pixel]) {
                (0..3).for_each(|k| before[place(sides, strips, pixel, k)] = 0.0);
            }
        }
        let spec = Spec { workgroup_size, subgroup_size: gpu.subgroup(), strips };
        let kernel = gpu.kernel::<Interface>(&spec);
        let (from, lenses) = (gpu.buffer("rendered", &native), gpu.buffer("lenses", &all));
        let gradient = gpu.buffer("image_gradient", &before);
        let partials = gpu.untouched::<[[f32; 4]; 3]>("partials", TERM_PARTIALS as usize);
        let push = Push {
            image_width: size[0],
            image_height: size[1],
            background: BACKGROUND,
            lens: 1,
            center_px,
            inverse_square,
        };
        let bind = Bind { rendered: &from, lenses: &lenses, image_gradient: &gradient, partials: &partials };
        gpu.run(|r| r.dispatch(&kernel, &bind, &push, TERM_PARTIALS.into()));
        let h = colors(&before, sides, strips);
        let (of_picture, of_rows) = lens_backward(&picture, &rows, &r2, &h);
        let after = gpu.read::<f32>(&gradient, values(sides));
        let actual = colors(&after, sides, strips);
        elementwise("d_picture", actual.as_flattened(), of_picture.as_flattened(), 1e-5, 2e-5)
            .expect("the picture's gradient");
        let mut rest = before.clone();
        for pixel in 0..sides[0] * sides[1] {
            (0..3).for_each(|k| {
                let at = place(sides, strips, pixel, k);
                rest[at] = after[at];
            });
        }
        assert_eq!(rest, after, "changed outside of the picture");
        let mut sums = [[0.0; 4]; 3];
        for part in gpu.read::<[[f32; 4]; 3]>(&partials, TERM_PARTIALS as usize) {
            for (sum, x) in sums.as_flattened_mut().iter_mut().zip(part.as_flattened()) {
                *sum += f64::from(*x);
            }
        }
        let bound = 1e-5 * (1.0 + (sides[0] * sides[1]) as f64).sqrt();
        elementwise("d_lens", sums.as_flattened(), of_rows.as_flattened(), bound, 2e-5)
            .expect("the gradient of the lens");
    }
}

/// The twin's gradients match finite differences of L = Σ h y.
#[test]
fn lens_backward_is_the_derivative() {
    let size = [13, 9];
    let mut random = Random::new(4);
    let (_, mut picture) = picture(&mut random, [13, 9], false);
    // Also values on the straight line, and below 0.
    picture[3] = [1e-4, -0.2, 5e-4];
    let rows = wide(&lenses(&mut random, 1)[0]);
    let (.., r2) = plane(size);
    let h: Vec<[f64; 3]> = picture.iter().map(|_| [0; 3].map(|_| random.signed())).collect();
    let loss = |picture: &[[f64; 3]], rows: &Rows| -> f64 {
        let behind = lens_effects(picture, rows, &r2);
        behind.as_flattened().iter().zip(h.as_flattened()).map(|(y, h)| y * h).sum()
    };
    let (of_picture, of_rows) = lens_backward(&picture, &rows, &r2, &h);
    let step = 1e-6;
    for (c, k) in (0..3).flat_map(|c| (0..4).map(move |k| (c, k))) {
        let at = |by: f64| {
            let mut moved = rows;
            moved[c][k] += by;
            loss(&picture, &moved)
        };
        let difference = (at(step) - at(-step)) / (2.0 * step);
        let gradient = of_rows[c][k];
        assert!(
            (difference - gradient).abs() < 1e-7 * (1.0 + gradient.abs()),
            "{c}, {k}: {difference} {gradient}"
        );
    }
    for pixel in [0, 3, 60, 116] {
        for c in 0..3 {
            let at = |by: f64| {
                let mut moved = picture.clone();
                moved[pixel][c] += by;
                loss(&moved, &rows)
            };
            let difference = (at(step) - at(-step)) / (2.0 * step);
            let gradient = of_picture[pixel][c];
            assert!(
                (difference - gradient).abs() < 1e-6 * (1.0 + gradient.abs()),
                "{pixel}, {c}: {difference} {gradient}"
            );
        }
    }
}
