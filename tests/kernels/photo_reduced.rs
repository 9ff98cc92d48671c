//! `pixels/photo_reduced` against its twin.

use ashsplat::kernels::pixels::photo_reduced::{Bind, Interface, Push, Spec};
use ashsplat::loss::{Windowing, photo_bytes, photo_on_device};

use crate::common::gpu::Gpu;
use crate::common::scenes::Random;
use crate::reference::photo_reduced::photo_reduced;

/// Sizes with and without pixels beyond the last whole square.
const SIZES: [[u32; 2]; 5] = [[4, 4], [9, 21], [66, 34], [131, 45], [257, 64]];

#[test]
fn photo_reduced_equals_its_twin() {
    let gpu = Gpu::new();
    let kinds = [(false, None), (true, None), (true, Some([0.7, -0.4, 0.1]))];
    let flags = [false, true].into_iter().flat_map(|strips| kinds.map(|kind| (strips, kind)));
    for ([width, height], (strips, (masked, change))) in
        flags.flat_map(|flags| SIZES.map(|size| (size, flags)))
    {
        let mut random = Random::new(u64::from(width));
        let kernel = gpu.kernel::<Interface>(&Spec {
            workgroup_size: gpu.workgroup(64),
            strips,
            masked,
            transparent: change.is_some(),
        });
        let windowing = if strips { Windowing::Sweeps } else { Windowing::Blocks };
        // One of sixteen pixels does not count. Without a mask, transparent photographs have any opacity in the
        // others.
        let mut mask = || match (masked && random.unit() < 1.0 / 16.0, change) {
            (true, _) => 0,
            (false, None) => 255,
            (false, Some(_)) => 1 + (random.unit() * 255.0) as u8,
        };
        let masks: Vec<u8> = (0..width * height).map(|_| mask()).collect();
        let rows: Vec<[u8; 4]> = (masks.into_iter())
            .map(|mask| match mask {
                0 => [0; 4],
                _ => {
                    let [r, g, b] = [0; 3].map(|_| (random.unit() * 256.0) as u8);
                    [r, g, b, mask]
                }
            })
            .collect();
        let photo = photo_on_device(windowing, width, height, masked, rows.as_flattened().to_vec());
        let from = gpu.buffer("photo", &photo);
        for factor in [1, 2, 4] {
            let (reduced_width, reduced_height) = (width / factor, height / factor);
            let bytes = photo_bytes(windowing, reduced_width, reduced_height, masked) as usize;
            let reduced = gpu.zeros::<u8>("reduced", bytes);
            let background_change = change.unwrap_or_default();
            let push = Push { image_width: width, image_height: height, factor, background_change };
            let workgroups = (bytes / 4).div_ceil(gpu.workgroup(64) as usize) as u64;
            gpu.run(|r| r.dispatch(&kernel, &Bind { photo: &from, reduced: &reduced }, &push, workgroups));
            let expected =
                photo_reduced(&rows, [width as usize, height as usize], factor as usize, masked, change);
            let expected = expected.as_flattened().to_vec();
            let expected = photo_on_device(windowing, reduced_width, reduced_height, masked, expected);
            let case = format!("{width}x{height} / {factor}, strips {strips}, masked {masked}");
            // Single and double precision may round halves differently.
            let tolerance = u8::from(change.is_some());
            let actual = gpu.read::<u8>(&reduced, bytes);
            assert!(actual.iter().zip(&expected).all(|(a, b)| a.abs_diff(*b) <= tolerance), "{case}");
        }
    }
}
