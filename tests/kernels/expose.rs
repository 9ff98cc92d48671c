//! `exposure/expose` against its twin.

use ashsplat::kernels::exposure::expose::{Bind, Interface, Push, Spec};

use super::picture_to_rows::SIZES;
use crate::common::compare::elementwise;
use crate::common::exposures::{BACKGROUND, colors, matrices, picture, place, values, wide};
use crate::common::gpu::{Gpu, UNTOUCHED};
use crate::common::scenes::Random;
use crate::reference::expose::expose;

#[test]
fn expose_equals_its_twin() {
    let gpu = Gpu::new();
    for ([width, height], strips) in SIZES.into_iter().flat_map(|size| [(size, true), (size, false)]) {
        let size = [width as usize, height as usize];
        let mut random = Random::new(u64::from(width));
        let (native, colors_before) = picture(&mut random, size, strips);
        let exposures = matrices(&mut random, 4);
        let kernel = gpu.kernel::<Interface>(&Spec { workgroup_size: gpu.workgroup(64), strips });
        let (from, e) = (gpu.buffer("rendered", &native), gpu.buffer("exposures", &exposures));
        let to = gpu.untouched::<f32>("exposed", values(size));
        let push = Push { image_width: width, image_height: height, background: BACKGROUND, view: 2 };
        let rows = if strips { height.next_multiple_of(8) } else { height };
        let workgroups = u64::from(width * rows).div_ceil(gpu.workgroup(64).into());
        let bind = Bind { rendered: &from, exposures: &e, exposed: &to };
        gpu.run(|r| r.dispatch(&kernel, &bind, &push, workgroups));
        let actual = gpu.read::<f32>(&to, values(size));
        let expected = expose(&colors_before, &wide(&exposures[2]));
        let color = colors(&actual, size, strips);
        elementwise("color", color.as_flattened(), expected.as_flattened(), 1e-6, 1e-6).expect("the picture");
        // The loss's window reads below the picture, and its kernels add the fourth value as a transmittance.
        let pixels = size[0] * size[1];
        let fourth = |pixel: usize| actual[4 * pixel + 3];
        assert!(strips || (0..pixels).all(|pixel| fourth(pixel) == 0.0));
        let mut rest: Vec<f32> = actual.clone();
        for pixel in 0..pixels {
            (0..3).for_each(|channel| rest[place(size, strips, pixel, channel)] = 0.0);
        }
        let kept = |value: &f32| *value == 0.0 || value.to_bits() == UNTOUCHED;
        assert!(rest.iter().all(kept), "written outside of the picture");
        let padding = (size[1]..size[1].next_multiple_of(8)).flat_map(|y| (0..size[0]).map(move |x| (x, y)));
        let below = |(x, y): (usize, usize)| place([size[0], y + 1], strips, y * size[0] + x, 0);
        // The index of later planes differs in a higher picture.
        assert!(!strips || padding.map(below).all(|at| actual[at] == 0.0), "below the picture");
    }
}
