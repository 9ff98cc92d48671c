//! `exposure/lens_effects` against its twin.

use ashsplat::kernels::exposure::lens_effects::{Bind, Interface, Push, Spec};

use super::picture_to_rows::SIZES;
use crate::common::compare::elementwise;
use crate::common::exposures::{BACKGROUND, colors, picture, place, values};
use crate::common::gpu::{Gpu, UNTOUCHED};
use crate::common::lens_rows::{lenses, plane, wide};
use crate::common::scenes::Random;
use crate::reference::lens_effects::lens_effects;

/// Runs the kernel over a random picture. Returns output and input.
fn run(
    gpu: &Gpu,
    size: [u32; 2],
    strips: bool,
    rows: &[[[f32; 4]; 3]],
    lens: u32,
) -> (Vec<f32>, Vec<[f64; 3]>) {
    let [width, height] = size;
    let sides = [width as usize, height as usize];
    let (native, before) = picture(&mut Random::new(u64::from(width)), sides, strips);
    let kernel = gpu.kernel::<Interface>(&Spec { workgroup_size: gpu.workgroup(64), strips });
    let to = gpu.untouched::<f32>("shaded", values(sides));
    let (center_px, inverse_square, _) = plane(size);
    let push = Push {
        image_width: width,
        image_height: height,
        background: BACKGROUND,
        lens,
        center_px,
        inverse_square,
    };
    let padded = if strips { height.next_multiple_of(8) } else { height };
    let workgroups = u64::from(width * padded).div_ceil(gpu.workgroup(64).into());
    let (from, rows) = (gpu.buffer("rendered", &native), gpu.buffer("lenses", rows));
    let bind = Bind { rendered: &from, lenses: &rows, shaded: &to };
    gpu.run(|r| r.dispatch(&kernel, &bind, &push, workgroups));
    (gpu.read::<f32>(&to, values(sides)), before)
}

#[test]
fn lens_effects_equals_its_twin() {
    let gpu = Gpu::new();
    for (size, strips) in SIZES.into_iter().flat_map(|size| [(size, true), (size, false)]) {
        let sides = [size[0] as usize, size[1] as usize];
        let all = lenses(&mut Random::new(u64::from(size[1])), 4);
        let (actual, before) = run(&gpu, size, strips, &all, 2);
        let (.., r2) = plane(size);
        let expected = lens_effects(&before, &wide(&all[2]), &r2);
        let color = colors(&actual, sides, strips);
        elementwise("color", color.as_flattened(), expected.as_flattened(), 4e-6, 8e-6).expect("the picture");
        // As with exposures: 0 where the loss's window reads, and no other word is written.
        let pixels = sides[0] * sides[1];
        assert!(strips || (0..pixels).all(|pixel| actual[4 * pixel + 3] == 0.0));
        let mut rest = actual.clone();
        for pixel in 0..pixels {
            (0..3).for_each(|channel| rest[place(sides, strips, pixel, channel)] = 0.0);
        }
        let kept = |value: &f32| *value == 0.0 || value.to_bits() == UNTOUCHED;
        assert!(rest.iter().all(kept), "written outside of the picture");
    }
}

/// Neutral effects leave the picture's bits, so that a run starts as it would without effects.
#[test]
fn lens_effects_of_none_is_the_picture() {
    let gpu = Gpu::new();
    for strips in [false, true] {
        let (actual, before) = run(&gpu, [37, 20], strips, &[[[0.0; 4]; 3]], 0);
        let color = colors(&actual, [37, 20], strips);
        if strips {
            assert_eq!(color, before);
        } else {
            // The kernel adds the background.
            elementwise("color", color.as_flattened(), before.as_flattened(), 1e-7, 1e-7).expect("none");
        }
    }
}
