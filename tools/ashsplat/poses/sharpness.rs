//! Sharpness of a picture: the variance of its Laplacian, which motion and defocus lower.

use ashsplat_files::Photo;

/// Width to which pictures are reduced, pixels, about. That removes noise and compression artefacts but keeps relevant
/// blur.
const WIDTH: u32 = 640;

/// Variance of the Laplacian of the reduced grey picture, in squares of 8-bit levels. Comparable between pictures of
/// one scene and one size; 0 for pictures without inner pixels.
pub fn sharpness(photo: &Photo) -> f64 {
    let (grey, width) = reduced(photo, (photo.width / WIDTH).max(1) as usize);
    let (mut sum, mut squares, mut count) = (0.0, 0.0, 0.0);
    let rows: Vec<&[f32]> = grey.chunks_exact(width.max(1)).collect();
    for rows in rows.windows(3) {
        for x in 1..width.saturating_sub(1) {
            let neighbours = rows[0][x] + rows[2][x] + rows[1][x - 1] + rows[1][x + 1];
            let laplacian = f64::from(neighbours - 4.0 * rows[1][x]);
            sum += laplacian;
            squares += laplacian * laplacian;
            count += 1.0;
        }
    }
    if count > 0.0 { squares / count - (sum / count) * (sum / count) } else { 0.0 }
}

/// Mean grey levels of squares of `factor` pixels, and the number of squares per row.
fn reduced(photo: &Photo, factor: usize) -> (Vec<f32>, usize) {
    let (width, height) = (photo.width as usize / factor, photo.height as usize / factor);
    let scale = 1.0 / (1000 * factor * factor) as f32;
    let mut grey = Vec::with_capacity(width * height);
    let mut sums = vec![0u32; width];
    for band in photo.rgb.chunks_exact((3 * photo.width as usize * factor).max(1)).take(height) {
        sums.fill(0);
        for row in band.chunks_exact(3 * photo.width as usize) {
            for (sum, pixels) in sums.iter_mut().zip(row.chunks_exact(3 * factor)) {
                let level =
                    |&[r, g, b]: &[u8; 3]| 299 * u32::from(r) + 587 * u32::from(g) + 114 * u32::from(b);
                *sum += pixels.as_chunks::<3>().0.iter().map(level).sum::<u32>();
            }
        }
        grey.extend(sums.iter().map(|&sum| sum as f32 * scale));
    }
    (grey, width)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Bars and a disk, blurred along x over `smeared` pixels.
    fn picture(width: u32, smeared: u32) -> Photo {
        let height = width / 2;
        let level = |x: f32, y: f32| {
            let bars = if (10.0 * x) as i32 % 2 == 0 { 60.0 } else { 150.0 };
            let disk = (x - 0.5).hypot(y - 0.25) < 0.1;
            if disk { 230.0 } else { bars }
        };
        let pixel = |x: u32, y: u32| {
            let at = |step: u32| level((x + step) as f32 / width as f32, y as f32 / width as f32);
            ((0..smeared).map(at).sum::<f32>() / smeared as f32) as u8
        };
        let places = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        Photo { width, height, rgb: places.flat_map(|(x, y)| [pixel(x, y); 3]).collect() }
    }

    #[test]
    fn blur_lowers_it_at_all_sizes() {
        for width in [64, 640, 1920] {
            let smears =
                [1, 3, 6, 12].map(|smeared| sharpness(&picture(width, smeared * width.div_ceil(640))));
            assert!(smears.is_sorted_by(|a, b| a > b), "{width}: {smears:?}");
        }
        let even = Photo { width: 40, height: 30, rgb: vec![99; 3600] };
        assert!(sharpness(&even) < 1e-6);
        for [width, height] in [[1, 1], [2, 9], [9, 2]] {
            let small = Photo { width, height, rgb: vec![5; (3 * width * height) as usize] };
            assert_eq!(sharpness(&small), 0.0);
        }
    }
}
