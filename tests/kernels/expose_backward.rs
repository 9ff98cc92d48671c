//! `exposure/expose_backward` against its twin.

use ashsplat::kernels::constants::TERM_PARTIALS;
use ashsplat::kernels::exposure::expose_backward::{Bind, Interface, Push, Spec};

use super::picture_to_rows::SIZES;
use crate::common::compare::elementwise;
use crate::common::exposures::{BACKGROUND, colors, matrices, picture, place, values, wide};
use crate::common::gpu::Gpu;
use crate::common::scenes::Random;
use crate::reference::expose_backward::expose_backward;

#[test]
fn expose_backward_equals_its_twin() {
    let gpu = Gpu::new();
    let workgroup_size = gpu.workgroup(64);
    // The last has more pixels than invocations.
    let large = [300, 2 * workgroup_size.div_ceil(2) + 40];
    for ([width, height], strips) in
        SIZES.into_iter().chain([large]).flat_map(|size| [(size, true), (size, false)])
    {
        let size = [width as usize, height as usize];
        let mut random = Random::new(u64::from(width));
        let (native, picture) = picture(&mut random, size, strips);
        let exposures = matrices(&mut random, 3);
        let before: Vec<f32> = (0..values(size)).map(|_| random.signed() as f32).collect();
        let spec = Spec { workgroup_size, subgroup_size: gpu.subgroup(), strips };
        let kernel = gpu.kernel::<Interface>(&spec);
        let (from, e) = (gpu.buffer("rendered", &native), gpu.buffer("exposures", &exposures));
        let gradient = gpu.buffer("image_gradient", &before);
        let partials = gpu.untouched::<[[f32; 4]; 3]>("partials", TERM_PARTIALS as usize);
        let push = Push { image_width: width, image_height: height, background: BACKGROUND, view: 1 };
        let bind = Bind { rendered: &from, exposures: &e, image_gradient: &gradient, partials: &partials };
        gpu.run(|r| r.dispatch(&kernel, &bind, &push, TERM_PARTIALS.into()));
        let g = colors(&before, size, strips);
        let (of_picture, of_matrix) = expose_backward(&picture, &wide(&exposures[1]), &g);
        let after = gpu.read::<f32>(&gradient, values(size));
        let actual = colors(&after, size, strips);
        elementwise("d_picture", actual.as_flattened(), of_picture.as_flattened(), 1e-6, 1e-6)
            .expect("the picture's gradient");
        let mut rest = before.clone();
        for pixel in 0..size[0] * size[1] {
            (0..3).for_each(|k| {
                let at = place(size, strips, pixel, k);
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
        let bound = 1e-6 * (1.0 + (size[0] * size[1]) as f64).sqrt();
        elementwise("d_matrix", sums.as_flattened(), of_matrix.as_flattened(), bound, 1e-5)
            .expect("the matrix's gradient");
    }
}
