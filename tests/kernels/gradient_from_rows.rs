//! `pixels/gradient_from_rows` against its twin.

use ashsplat::kernels::pixels::gradient_from_rows::{Bind, Interface, Push, Spec};
use ashsplat::plan::Strips;

use super::picture_to_rows::SIZES;
use crate::common::compare::elementwise;
use crate::common::gpu::Gpu;
use crate::common::scenes::Random;
use crate::reference::gradient_from_rows::gradient_from_rows;

#[test]
fn gradient_from_rows_equals_its_twin() {
    let gpu = Gpu::new();
    for ([width, height], case) in SIZES.into_iter().flat_map(|size| (0..8).map(move |case| (size, case))) {
        let (strips, add, planes) = (case & 1 > 0, case & 2 > 0, if case & 4 > 0 { 4 } else { 3 });
        let mut random = Random::new(u64::from(width));
        let kernel = gpu.kernel::<Interface>(&Spec { workgroup_size: gpu.workgroup(64), strips, add });
        let pixels = (width * height) as usize;
        let rows: Vec<[f32; 4]> = (0..pixels).map(|_| [0; 4].map(|_| random.signed() as f32)).collect();
        let values = 4 * Strips { width, height }.values() as usize;
        let before: Vec<f32> = (0..values).map(|_| random.signed() as f32).collect();
        let (from, to) = (gpu.buffer("rows", &rows), gpu.buffer("image_gradient", &before));
        let push = Push { image_width: width, image_height: height, planes };
        let workgroups = pixels.div_ceil(gpu.workgroup(64) as usize) as u64;
        gpu.run(|r| r.dispatch(&kernel, &Bind { rows: &from, image_gradient: &to }, &push, workgroups));
        let wide = |values: &[f32]| values.iter().copied().map(f64::from).collect::<Vec<f64>>();
        let rows: Vec<[f64; 4]> = rows.into_iter().map(|row| row.map(f64::from)).collect();
        let size = [width as usize, height as usize];
        let mut expected = wide(&before);
        if !add {
            // Replaces the written values; the others stay.
            let mut written = vec![0.0; values];
            let ones = vec![[1.0; 4]; pixels];
            gradient_from_rows(&ones, size, planes as usize, strips, &mut written);
            expected.iter_mut().zip(written).filter(|(_, w)| *w > 0.0).for_each(|(value, _)| *value = 0.0);
        }
        gradient_from_rows(&rows, size, planes as usize, strips, &mut expected);
        let actual = wide(&gpu.read::<f32>(&to, values));
        elementwise("gradient", &actual, &expected, 1e-7, 1e-7).expect("the gradient");
    }
}
