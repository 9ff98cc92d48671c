//! Sharpness of a picture: the variance of its Laplacian, which motion and defocus lower.

use ashsplat_files::Photo;

/// Approximate width to which pictures are reduced, pixels. Reducing removes noise and compression artefacts but keeps
/// relevant blur.
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
