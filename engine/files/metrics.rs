//! PSNR and SSIM of pictures with values in [0, 1].

use glam::{DMat4, DVec4};
use rayon::prelude::*;

use ashsplat::{Error, Result};

/// Radius of SSIM's window: 11×11 pixels.
const RADIUS: usize = 5;
const WINDOW: usize = 2 * RADIUS + 1;
/// Standard deviation of SSIM's Gaussian window, pixels.
const SIGMA: f64 = 1.5;
/// SSIM's constants for a range of 1: (0.01)² and (0.03)².
const C1: f64 = 1e-4;
const C2: f64 = 9e-4;

/// Peak signal-to-noise ratio in dB: −10 log₁₀ of the mean squared error over all pixels and channels.
///
/// Both pictures are rgb, row-major, and clamped to [0, 1] first. Equal pictures give infinity. A mask has a byte per
/// pixel; 0 hides it.
pub fn psnr(image: &[[f32; 3]], reference: &[[f32; 3]], mask: Option<&[u8]>) -> Result<f64> {
    check_sizes(image.len(), reference.len(), mask)?;
    let pixels = image.iter().zip(reference).enumerate();
    Ok(decibels(pixels.filter(|(pixel, _)| mask.is_none_or(|mask| mask[*pixel] != 0)).map(|(_, pair)| pair)))
}

/// Colour-corrected PSNR (CC-PSNR) in dB, over the pixels whose mask byte is not 0: after the affine map of the image's (r, g, b)
/// with the least squared error to the reference's, one for the whole picture.
///
/// The map removes the photograph's own exposure and white balance, which no scene can predict. It would turn any image into a
/// reference of a single colour, so for such a reference the result is [`psnr`].
pub fn cc_psnr(image: &[[f32; 3]], reference: &[[f32; 3]], mask: Option<&[u8]>) -> Result<f64> {
    /// Weight of the identity per pixel, for pictures that do not determine the map.
    const RIDGE: f64 = 1e-6;
    /// Least variance of a reference that is no single colour: two steps of 8 bits.
    const MIN_VARIANCE: f64 = (2.0 / 255.0) * (2.0 / 255.0);
    check_sizes(image.len(), reference.len(), mask)?;
    let counts = |pixel: &usize| mask.is_none_or(|mask| mask[*pixel] != 0);
    let pixels = || (0..image.len()).filter(counts).map(|pixel| (&image[pixel], &reference[pixel]));
    let color = |rgb: &[f32; 3]| {
        let [r, g, b] = rgb.map(clamped);
        DVec4::new(r, g, b, 1.0)
    };
    let outer = |a: DVec4, b: DVec4| DMat4::from_cols(a * b.x, a * b.y, a * b.z, a * b.w);
    let count = pixels().count() as f64;
    let (sum, squares) = pixels()
        .map(|(_, b)| color(b))
        .fold((DVec4::ZERO, DVec4::ZERO), |(sum, squares), b| (sum + b, squares + b * b));
    let variance = (squares / count - (sum / count) * (sum / count)).truncate().max_element();
    if variance < MIN_VARIANCE {
        return Ok(decibels(pixels()));
    }
    let ridge = DMat4::IDENTITY * (RIDGE * count);
    let (normal, product) = pixels().fold((ridge, ridge), |(normal, product), (a, b)| {
        let a = color(a);
        (normal + outer(a, a), product + outer(color(b), a))
    });
    let map = product * normal.inverse();
    let fitted: Vec<[f32; 3]> =
        image.iter().map(|rgb| (map * color(rgb)).truncate().as_vec3().to_array()).collect();
    Ok(decibels(fitted.iter().zip(reference).enumerate().filter(|(at, _)| counts(at)).map(|(_, pair)| pair)))
}

fn decibels<'a>(pixels: impl Iterator<Item = (&'a [f32; 3], &'a [f32; 3])>) -> f64 {
    let (mut squared, mut values) = (0.0, 0.0);
    for (a, b) in pixels {
        squared += a.iter().zip(b).map(|(&a, &b)| (clamped(a) - clamped(b)).powi(2)).sum::<f64>();
        values += 3.0;
    }
    -10.0 * (squared / values).log10()
}

/// Structural similarity (Wang et al. 2004): mean over all pixels and channels.
///
/// 11×11 Gaussian window with σ = 1.5, zero padding, C1 = 1e-4, C2 = 9e-4, as in the reference implementation.
/// Both pictures are rgb, row-major, `width` pixels wide, and clamped to [0, 1] first. With a mask (a byte per pixel; 0
/// hides it), both are multiplied by it, and the mean is over the visible pixels.
pub fn ssim(image: &[[f32; 3]], reference: &[[f32; 3]], mask: Option<&[u8]>, width: u32) -> Result<f64> {
    check_sizes(image.len(), reference.len(), mask)?;
    let Some(mask) = mask else {
        let map = ssim_rows(image, reference, width, &|_| true)?;
        return Ok(map / (3 * image.len()) as f64);
    };
    let times_mask = |picture: &[[f32; 3]]| -> Vec<[f32; 3]> {
        picture.iter().zip(mask).map(|(&rgb, &counts)| if counts == 0 { [0.0; 3] } else { rgb }).collect()
    };
    let counting = mask.iter().filter(|&&counts| counts != 0).count();
    let map = ssim_rows(&times_mask(image), &times_mask(reference), width, &|pixel| mask[pixel] != 0)?;
    Ok(map / (3 * counting) as f64)
}

/// Sum of the SSIM map over the visible pixels and all channels.
fn ssim_rows(
    image: &[[f32; 3]],
    reference: &[[f32; 3]],
    width: u32,
    counts: &(dyn Fn(usize) -> bool + Sync),
) -> Result<f64> {
    let width = width as usize;
    if width == 0 || !image.len().is_multiple_of(width) {
        let problem = format!("{} pixels are no multiple of the width {width}", image.len());
        return Err(Error::argument("image", problem));
    }
    let rows: Vec<f64> = (0..image.len() / width)
        .into_par_iter()
        .map_init(Vec::new, |moments, y| {
            column_sums(image, reference, width, y, moments);
            let weights = window();
            let columns = (0..width).filter(|x| counts(y * width + x));
            columns
                .flat_map(|x| (0..3).map(move |c| (x, c)))
                .map(|(x, c)| ssim_at(moments, &weights, x, c))
                .sum()
        })
        .collect();
    Ok(rows.iter().sum())
}

/// The window's column sums of a, b, a², b², ab for each pixel and channel of a row.
fn column_sums(a: &[[f32; 3]], b: &[[f32; 3]], width: usize, y: usize, moments: &mut Vec<[f64; 5]>) {
    let weights = window();
    let height = a.len() / width;
    moments.clear();
    moments.resize(3 * width, [0.0; 5]);
    for row in y.saturating_sub(RADIUS)..(y + RADIUS + 1).min(height) {
        let weight = weights[row + RADIUS - y];
        let pixels = row * width..(row + 1) * width;
        let pairs = a[pixels.clone()].as_flattened().iter().zip(b[pixels].as_flattened());
        for (sums, (&a, &b)) in moments.iter_mut().zip(pairs) {
            let (a, b) = (clamped(a), clamped(b));
            for (sum, value) in sums.iter_mut().zip([a, b, a * a, b * b, a * b]) {
                *sum += weight * value;
            }
        }
    }
}

/// SSIM at a pixel and channel from the nearby column sums.
fn ssim_at(moments: &[[f64; 5]], weights: &[f64; WINDOW], x: usize, channel: usize) -> f64 {
    let width = moments.len() / 3;
    let mut sums = [0.0; 5];
    for column in x.saturating_sub(RADIUS)..(x + RADIUS + 1).min(width) {
        let weight = weights[column + RADIUS - x];
        for (sum, value) in sums.iter_mut().zip(moments[3 * column + channel]) {
            *sum += weight * value;
        }
    }
    let [mean_a, mean_b, aa, bb, ab] = sums;
    let (var_a, var_b, cov) = (aa - mean_a * mean_a, bb - mean_b * mean_b, ab - mean_a * mean_b);
    ((2.0 * mean_a * mean_b + C1) * (2.0 * cov + C2))
        / ((mean_a * mean_a + mean_b * mean_b + C1) * (var_a + var_b + C2))
}

/// The one-dimensional window, whose sum is 1.
fn window() -> [f64; WINDOW] {
    let weights: [f64; WINDOW] =
        std::array::from_fn(|i| (-(i as f64 - RADIUS as f64).powi(2) / (2.0 * SIGMA * SIGMA)).exp());
    let sum: f64 = weights.iter().sum();
    weights.map(|w| w / sum)
}

fn clamped(value: f32) -> f64 {
    f64::from(value).clamp(0.0, 1.0)
}

fn check_sizes(pixels: usize, reference: usize, mask: Option<&[u8]>) -> Result<()> {
    if pixels != reference || pixels == 0 {
        return Err(Error::argument(
            "image",
            format!("{pixels} pixels against {reference} in the reference"),
        ));
    }
    let Some(mask) = mask else { return Ok(()) };
    if mask.len() != pixels {
        return Err(Error::argument("mask", format!("{} pixels, the image has {pixels}", mask.len())));
    }
    if mask.iter().all(|&counts| counts == 0) {
        return Err(Error::argument("mask", "hides the whole photo: there is nothing to compare"));
    }
    Ok(())
}
