//! `pixels/photo_to_rows` against its twin.

use ashsplat::kernels::pixels::photo_to_rows::{Bind, Interface, Push, Spec};
use ashsplat::loss::{Windowing, photo_on_device};

use super::picture_to_rows::SIZES;
use crate::common::gpu::Gpu;
use crate::common::scenes::Random;
use crate::reference::photo_to_rows::photo_to_rows;

#[test]
fn photo_to_rows_equals_its_twin_and_is_the_inverse_of_the_upload() {
    let gpu = Gpu::new();
    for ([width, height], masked) in SIZES.into_iter().flat_map(|size| [(size, false), (size, true)]) {
        let mut random = Random::new(u64::from(height));
        let kernel = gpu.kernel::<Interface>(&Spec { workgroup_size: gpu.workgroup(64), masked });
        let pixels = (width * height) as usize;
        let rgbm: Vec<[u8; 4]> = (0..pixels)
            .map(|_| [0; 4].map(|_| (random.unit() * 256.0) as u8))
            // Where the mask is 0 the other planes are 0 as well.
            .map(
                |[r, g, b, mask]| {
                    if masked && mask == 0 { [0; 4] } else { [r, g, b, if masked { mask } else { 255 }] }
                },
            )
            .collect();
        let planes = photo_on_device(Windowing::Sweeps, width, height, masked, rgbm.as_flattened().to_vec());
        let (from, rows) = (gpu.buffer("photo", &planes), gpu.untouched::<[u8; 4]>("rows", pixels));
        let push = Push { image_width: width, image_height: height };
        let workgroups = pixels.div_ceil(gpu.workgroup(64) as usize) as u64;
        gpu.run(|r| r.dispatch(&kernel, &Bind { photo: &from, rows: &rows }, &push, workgroups));
        let actual = gpu.read::<[u8; 4]>(&rows, pixels);
        assert_eq!(actual, photo_to_rows(&planes, [width as usize, height as usize], masked));
        assert_eq!(actual, rgbm);
    }
}
