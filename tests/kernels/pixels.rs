//! `pixels/gradient_from_rows` and `pixels/photo_reduced` against their twins. Tests of a host's loss term cover
//! `pixels/picture_to_rows` and `pixels/photo_to_rows`.

use crate::common::prelude::*;
use crate::reference::pixels as twin;
use ashsplat::frame::Strips;
use ashsplat::kernels::pixels::{gradient_from_rows, photo_reduced};
use ashsplat::passes::loss::{NativeLayout, photo_bytes, photo_on_device};

/// Sizes at and around the borders of strips.
pub const SIZES: [[u32; 2]; 6] = [[1, 1], [2, 8], [3, 9], [66, 17], [130, 41], [257, 64]];

pub fn layouts(sizes: impl IntoIterator<Item = [u32; 2]>) -> impl Iterator<Item = ([u32; 2], bool)> {
    sizes.into_iter().flat_map(|size| [(size, true), (size, false)])
}

pub fn sides(size: [u32; 2]) -> [usize; 2] {
    size.map(|side| side as usize)
}

#[test]
fn gradient_from_rows_equals_its_twin() {
    let gpu = Gpu::new();
    for (size, case) in SIZES.into_iter().flat_map(|size| (0..8).map(move |case| (size, case))) {
        let ([width, height], sides) = (size, sides(size));
        let (strips, add, planes) = (case & 1 > 0, case & 2 > 0, if case & 4 > 0 { 4 } else { 3 });
        let mut random = Random::new(u64::from(width));
        let pixels = (width * height) as usize;
        let rows: Vec<[f32; 4]> = (0..pixels).map(|_| [0; 4].map(|_| random.signed() as f32)).collect();
        let values = 4 * Strips { width, height }.values() as usize;
        let before: Vec<f32> = (0..values).map(|_| random.signed() as f32).collect();
        let to = gpu.buffer("image_gradient", &before);
        let bind = gradient_from_rows::Bind { rows: &gpu.buffer("rows", &rows), image_gradient: &to };
        let push = gradient_from_rows::Push { image_width: width, image_height: height, planes };
        let spec = gradient_from_rows::Spec { workgroup_size: gpu.workgroup(64), strips, add };
        gpu.dispatch_over::<gradient_from_rows::Interface>(&spec, &bind, &push, pixels);
        let rows: Vec<[f64; 4]> = rows.into_iter().map(|row| row.map(f64::from)).collect();
        let mut expected: Vec<f64> = before.into_iter().map(f64::from).collect();
        if !add {
            // Replaces the written values; the others stay.
            let mut written = vec![0.0; values];
            let ones = vec![[1.0; 4]; pixels];
            twin::gradient_from_rows(&ones, sides, planes as usize, strips, &mut written);
            expected.iter_mut().zip(written).filter(|(_, w)| *w > 0.0).for_each(|(value, _)| *value = 0.0);
        }
        twin::gradient_from_rows(&rows, sides, planes as usize, strips, &mut expected);
        elementwise("gradient", &gpu.read_f64::<f32>(&to, values), &expected, 1e-7, 1e-7)
            .expect("the gradient");
    }
}

#[test]
fn photo_reduced_equals_its_twin() {
    let gpu = Gpu::new();
    // With and without pixels beyond the last whole square.
    let sizes = [[4, 4], [9, 21], [66, 34], [131, 45], [257, 64]];
    let kinds = [(false, None), (true, None), (true, Some([0.7, -0.4, 0.1]))];
    for ((size, strips), (masked, change)) in
        kinds.into_iter().flat_map(|kind| layouts(sizes).map(move |layout| (layout, kind)))
    {
        let [width, height] = size;
        let mut random = Random::new(u64::from(width));
        let spec = photo_reduced::Spec {
            workgroup_size: gpu.workgroup(64),
            strips,
            masked,
            transparent: change.is_some(),
        };
        let layout = if strips { NativeLayout::Strips } else { NativeLayout::Rows };
        // `masked` hides one pixel of sixteen. The other pixels of transparent photographs have any opacity.
        let mut mask = || match (masked && random.unit() < 1.0 / 16.0, change) {
            (true, _) => 0,
            (false, None) => 255,
            (false, Some(_)) => 1 + (random.unit() * 255.0) as u8,
        };
        let masks: Vec<u8> = (0..width * height).map(|_| mask()).collect();
        let mut pixel = |mask| match mask {
            0 => [0; 4],
            _ => {
                let [r, g, b] = [0; 3].map(|_| (random.unit() * 256.0) as u8);
                [r, g, b, mask]
            }
        };
        let rows: Vec<[u8; 4]> = masks.into_iter().map(&mut pixel).collect();
        let photo = photo_on_device(layout, width, height, masked, rows.as_flattened().to_vec());
        let from = gpu.buffer("photo", &photo);
        for factor in [1, 2, 4] {
            let (reduced_width, reduced_height) = (width / factor, height / factor);
            let bytes = photo_bytes(layout, reduced_width, reduced_height, masked) as usize;
            let reduced = gpu.zeros::<u8>("reduced", bytes);
            let background_change = change.unwrap_or_default();
            let push =
                photo_reduced::Push { image_width: width, image_height: height, factor, background_change };
            let bind = photo_reduced::Bind { photo: &from, reduced: &reduced };
            gpu.dispatch_over::<photo_reduced::Interface>(&spec, &bind, &push, bytes / 4);
            let expected = twin::photo_reduced(&rows, sides(size), factor as usize, masked, change);
            let expected = expected.as_flattened().to_vec();
            let expected = photo_on_device(layout, reduced_width, reduced_height, masked, expected);
            let case = format!("{width}x{height} / {factor}, strips {strips}, masked {masked}");
            // Single and double precision may round halves differently.
            let tolerance = u8::from(change.is_some());
            let actual = gpu.read::<u8>(&reduced, bytes);
            assert!(actual.iter().zip(&expected).all(|(a, b)| a.abs_diff(*b) <= tolerance), "{case}");
        }
    }
}
