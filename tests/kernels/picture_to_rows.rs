//! `pixels/picture_to_rows` against its twin.

use ashsplat::kernels::pixels::picture_to_rows::{Bind, Interface, Push, Spec};
use ashsplat::plan::Strips;

use crate::common::compare::elementwise;
use crate::common::gpu::Gpu;
use crate::common::scenes::Random;
use crate::reference::picture_to_rows::picture_to_rows;

/// Sizes at and around the borders of strips.
pub const SIZES: [[u32; 2]; 6] = [[1, 1], [2, 8], [3, 9], [66, 17], [130, 41], [257, 64]];

#[test]
fn picture_to_rows_equals_its_twin() {
    let gpu = Gpu::new();
    let background = [0.25, 0.5, 0.75_f32];
    for ([width, height], strips) in SIZES.into_iter().flat_map(|size| [(size, true), (size, false)]) {
        let mut random = Random::new(u64::from(width));
        let kernel = gpu.kernel::<Interface>(&Spec { workgroup_size: gpu.workgroup(64), strips });
        let values = 4 * Strips { width, height }.values() as usize;
        let rendered: Vec<f32> = (0..values).map(|_| random.unit() as f32).collect();
        let pixels = (width * height) as usize;
        let (from, rows) = (gpu.buffer("rendered", &rendered), gpu.untouched::<[f32; 4]>("rows", pixels));
        let push = Push { image_width: width, image_height: height, background };
        let workgroups = pixels.div_ceil(gpu.workgroup(64) as usize) as u64;
        gpu.run(|r| r.dispatch(&kernel, &Bind { rendered: &from, rows: &rows }, &push, workgroups));
        let rendered: Vec<f64> = rendered.into_iter().map(f64::from).collect();
        let size = [width as usize, height as usize];
        let expected = picture_to_rows(&rendered, size, strips, background.map(f64::from));
        let actual: Vec<f64> =
            gpu.read::<[f32; 4]>(&rows, pixels).as_flattened().iter().copied().map(f64::from).collect();
        elementwise("pixel", &actual, expected.as_flattened(), 1e-7, 1e-7).expect("the picture");
    }
}
