//! `loss/ssim_planes` against its twin.

use crate::common::gpu::Gpu;
use crate::common::loss::{BACKGROUND, Pictures, PlaneLayout, SIZES, planes};
use crate::reference::ssim_planes::{photo_plane, rendered_plane};

fn check(gpu: &Gpu, pictures: &Pictures, strip: u32) {
    let layout = PlaneLayout::new(pictures.size, strip);
    let [rendered, photo] = planes(gpu, pictures, strip);
    let rendered = gpu.read::<[f32; 4]>(&rendered, 3 * layout.texels());
    let photo = gpu.read::<u32>(&photo, 3 * layout.texels());
    let width = pictures.size[0] as usize;
    for channel in 0..3 {
        let mask = |i: usize| pictures.counts(i);
        let x = rendered_plane(&pictures.accumulated, channel, BACKGROUND, mask);
        let y = photo_plane(&pictures.photo, channel, mask);
        for place in 0..layout.columns * 4 * layout.height {
            let (column, row) = (place % (layout.columns * 4), place / (layout.columns * 4));
            let texel = layout.texel(channel, column / 4, row);
            // Columns begin at the sixth place.
            let inside = (5..5 + width).contains(&column);
            let (x, y) =
                if inside { (x[row * width + column - 5], y[row * width + column - 5]) } else { (0.0, 0) };
            let (actual_x, actual_y) =
                (rendered[texel][column % 4], photo[texel] >> (8 * (column % 4)) & 0xFF);
            assert!((f64::from(actual_x) - x).abs() <= 1e-6, "{actual_x} for {x} at {column}, {row}");
            assert!(actual_x == 0.0 || inside);
            assert_eq!(actual_y, y, "at {column}, {row}");
        }
    }
}

#[test]
fn ssim_planes_equal_their_twin() {
    let gpu = Gpu::new();
    for size in SIZES {
        for strip in [4, 8] {
            check(&gpu, &Pictures::random(size), strip);
            check(&gpu, &Pictures::masked(size), strip);
        }
    }
}
