//! PSNR and SSIM against direct loops.

use ashsplat_files::metrics::{cc_psnr, psnr, ssim};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

fn noise(pixels: usize, seed: u64) -> Vec<[f32; 3]> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    (0..pixels).map(|_| [(); 3].map(|()| random.random_range(-0.1..1.1f32))).collect()
}

/// SSIM by its definition: a loop over the whole window of each pixel.
fn ssim_direct(a: &[[f32; 3]], b: &[[f32; 3]], width: i64) -> f64 {
    let height = a.len() as i64 / width;
    let gauss = |d: i64| (-(d * d) as f64 / 4.5).exp();
    let norm: f64 = (-5..=5).map(gauss).sum();
    let mut total = 0.0;
    for (index, channel) in (0..a.len() as i64).flat_map(|i| (0..3).map(move |c| (i, c))) {
        let (x, y) = (index % width, index / width);
        let [mut ma, mut mb, mut aa, mut bb, mut ab] = [0.0; 5];
        for (dy, dx) in (-5..=5).flat_map(|dy| (-5..=5).map(move |dx| (dy, dx))) {
            if (0..width).contains(&(x + dx)) && (0..height).contains(&(y + dy)) {
                let at = ((y + dy) * width + x + dx) as usize;
                let weight = gauss(dx) * gauss(dy) / (norm * norm);
                let [p, q] = [a, b].map(|image| f64::from(image[at][channel]).clamp(0.0, 1.0));
                ma += weight * p;
                mb += weight * q;
                aa += weight * p * p;
                bb += weight * q * q;
                ab += weight * p * q;
            }
        }
        let (va, vb, cov) = (aa - ma * ma, bb - mb * mb, ab - ma * mb);
        total +=
            (2.0 * ma * mb + 1e-4) * (2.0 * cov + 9e-4) / ((ma * ma + mb * mb + 1e-4) * (va + vb + 9e-4));
    }
    total / (3 * a.len()) as f64
}

#[test]
fn ssim_equals_the_direct_loop() {
    for (width, height) in [(1, 1), (1, 30), (30, 1), (4, 3), (11, 11), (33, 17)] {
        let a = noise(width * height, 1);
        let b: Vec<_> = a
            .iter()
            .zip(noise(width * height, 2))
            .map(|(a, b)| [0, 1, 2].map(|c| 0.7 * a[c] + 0.3 * b[c]))
            .collect();
        let (fast, direct) = (ssim(&a, &b, None, width as u32).unwrap(), ssim_direct(&a, &b, width as i64));
        assert!((fast - direct).abs() < 1e-12, "{width}x{height}: {fast}, directly {direct}");
        assert!((ssim(&a, &a, None, width as u32).unwrap() - 1.0).abs() < 1e-12);
    }
}

#[test]
fn colour_correction_takes_out_gains_and_mixtures() {
    let image: Vec<_> = noise(400, 3).iter().map(|rgb| rgb.map(|value| 0.5 + 0.3 * (value - 0.5))).collect();
    let other = |[r, g, b]: [f32; 3]| [0.8 * r + 0.1 * g + 0.05, 0.9 * g, 0.1 * r + 0.7 * b + 0.1];
    let mut reference: Vec<_> = image.iter().copied().map(other).collect();
    assert!(psnr(&image, &reference, None).unwrap() < 30.0);
    assert!(cc_psnr(&image, &reference, None).unwrap() > 80.0);
    // A masked pixel does not affect the fit; an unmasked one does.
    reference[7] = [1.0, 0.0, 1.0];
    let mut mask = vec![1; 400];
    assert!(cc_psnr(&image, &reference, Some(&mask)).unwrap() < 40.0);
    mask[7] = 0;
    assert!(cc_psnr(&image, &reference, Some(&mask)).unwrap() > 80.0);
    // Colour correction would fit any picture to a photograph of one colour, so it is skipped.
    assert_eq!(
        cc_psnr(&image, &[[0.25; 3]; 400], None).unwrap(),
        psnr(&image, &[[0.25; 3]; 400], None).unwrap()
    );
    let flat = cc_psnr(&[[0.5; 3]; 400], &image, None).unwrap();
    assert!(flat.is_finite() && flat >= psnr(&[[0.5; 3]; 400], &image, None).unwrap(), "{flat}");
    assert!(cc_psnr(&image, &image[1..], None).is_err());
}

#[test]
fn psnr_of_a_known_error() {
    let (a, b) = (vec![[0.5; 3]; 7], vec![[0.6, 0.5, 0.4]; 7]);
    let expected = -10.0 * (0.02f64 / 3.0).log10();
    assert!((psnr(&a, &b, None).unwrap() - expected).abs() < 1e-5);
    assert_eq!(psnr(&a, &a, None).unwrap(), f64::INFINITY);
    // Clamped: 2 counts as 1.
    assert_eq!(psnr(&[[2.0; 3]], &[[1.0; 3]], None).unwrap(), f64::INFINITY);
    assert_eq!(psnr(&[[0.0; 3]], &[[1.0; 3]], None).unwrap(), 0.0);
}

#[test]
fn sizes_that_do_not_fit_are_refused() {
    let [a, b] = [vec![[0.0; 3]; 6], vec![[0.0; 3]; 5]];
    assert!(psnr(&a, &b, None).is_err() && psnr(&[], &[], None).is_err());
    assert!(
        ssim(&a, &b, None, 1).is_err() && ssim(&a, &a, None, 4).is_err() && ssim(&a, &a, None, 0).is_err()
    );
}

#[test]
fn masks_in_metrics() {
    let (a, b) = (noise(31 * 23, 3), noise(31 * 23, 4));
    let all = vec![255; a.len()];
    assert_eq!(psnr(&a, &b, Some(&all)).unwrap(), psnr(&a, &b, None).unwrap());
    assert_eq!(ssim(&a, &b, Some(&all), 31).unwrap(), ssim(&a, &b, None, 31).unwrap());
    // Masked pixels in the right third do not matter.
    let mask: Vec<u8> = (0..a.len()).map(|i| if i % 31 < 20 { 255 } else { 0 }).collect();
    let changed: Vec<[f32; 3]> =
        a.iter().zip(&mask).map(|(&rgb, &counts)| if counts == 0 { [0.77; 3] } else { rgb }).collect();
    assert_eq!(psnr(&a, &b, Some(&mask)).unwrap(), psnr(&changed, &b, Some(&mask)).unwrap());
    assert_eq!(ssim(&a, &b, Some(&mask), 31).unwrap(), ssim(&changed, &b, Some(&mask), 31).unwrap());
    // Same as the cut-out picture: masked pixels count as the border's zeros.
    let cut = |picture: &[[f32; 3]]| -> Vec<[f32; 3]> {
        picture.iter().enumerate().filter(|(i, _)| i % 31 < 20).map(|(_, &rgb)| rgb).collect()
    };
    let near = |x: f64, y: f64| assert!((x - y).abs() < 1e-12, "{x} {y}");
    near(psnr(&a, &b, Some(&mask)).unwrap(), psnr(&cut(&a), &cut(&b), None).unwrap());
    near(ssim(&a, &b, Some(&mask), 31).unwrap(), ssim(&cut(&a), &cut(&b), None, 20).unwrap());
    assert!(psnr(&a, &b, Some(&mask[1..])).is_err() && psnr(&a, &b, Some(&vec![0; a.len()])).is_err());
}
