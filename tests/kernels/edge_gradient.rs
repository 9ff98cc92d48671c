//! `densify/edge_gradient` against its twin.

use ashsplat::kernels::densify::edge_gradient::{Bind, Interface, Push, Spec};
use ashsplat::plan::Strips;

use super::picture_to_rows::SIZES;
use crate::common::compare::elementwise;
use crate::common::gpu::{Gpu, UNTOUCHED};
use crate::common::scenes::Random;
use crate::reference::edge_gradient::edges;

#[test]
fn edge_gradient_equals_its_twin() {
    let gpu = Gpu::new();
    for ([width, height], strips) in SIZES.into_iter().flat_map(|size| [(size, false), (size, true)]) {
        let kernel = gpu.kernel::<Interface>(&Spec { workgroup_size: gpu.workgroup(64), strips });
        let pixels = (width * height) as usize;
        let mut random = Random::new(u64::from(width));
        let any: Vec<i64> = (0..pixels).map(|_| 20 + i64::from(random.below(200))).collect();
        for responses in [any, vec![31; pixels]] {
            let (low, high) = (responses.iter().min().expect("some"), responses.iter().max().expect("some"));
            let words: Vec<u32> = responses.iter().map(|&response| response as u32).collect();
            let input = gpu.buffer("responses", &words);
            let ranges = gpu.buffer("ranges", &[!(*low as u32), *high as u32, 0, 0]);
            let planes = Strips { width, height };
            let out = gpu.untouched::<f32>("image_gradient", 4 * planes.values() as usize);
            let bind = Bind { responses: &input, ranges: &ranges, image_gradient: &out };
            let push = Push { image_width: width, image_height: height };
            let workgroups = pixels.div_ceil(gpu.workgroup(64) as usize) as u64;
            gpu.run(|r| r.dispatch(&kernel, &bind, &push, workgroups));
            let values = gpu.read::<f32>(&out, 4 * planes.values() as usize);
            let place = |i: u32, plane: u32| match strips {
                true => planes.index(plane, i % width, i / width),
                false => 4 * i as usize + plane as usize,
            };
            let actual: Vec<f64> = (0..pixels as u32).map(|i| values[place(i, 0)].into()).collect();
            elementwise("edges", &actual, &edges(&responses), 1e-7, 1e-7).expect("edges");
            for i in 0..pixels as u32 {
                let other = values[place(i, 1)];
                assert!(if strips { other.to_bits() == UNTOUCHED } else { other == 0.0 });
            }
        }
    }
}
