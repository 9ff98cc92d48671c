//! The kernels that write a host's images, over random pixels.

use ashsplat::ColorEncoding;
use ashsplat::ash::vk;
use ashsplat::compose::{Background, Compose, Region};
use ashsplat::vk::{Image, ImageUse};

use super::gpu::Gpu;
use super::scenes::Random;

/// Size of the frame, smaller than the image.
pub const SIZE: [u32; 2] = [21, 13];
/// Position of the frame in the image.
pub const OFFSET: [u32; 2] = [5, 2];
/// Size of the image.
pub const IMAGE: [u32; 2] = [32, 17];

/// Pixels as blending leaves them: premultiplied colour, transmittance.
pub fn pixels() -> Vec<[f32; 4]> {
    let mut random = Random::new(5);
    (0..SIZE[0] * SIZE[1])
        .map(|i| {
            let transmittance = match i % 5 {
                0 => 1.0,
                1 => 1e-4,
                _ => random.unit() as f32,
            };
            let covered = f64::from(1.0 - transmittance);
            let [r, g, b] = [0; 3].map(|_| (covered * random.unit()) as f32);
            [r, g, b, transmittance]
        })
        .collect()
}

/// Composes [`pixels`] as trained over an image of `texels`. Returns the image's bytes.
pub fn composed(gpu: &Gpu, format: vk::Format, texels: &[u8], behind: Background) -> Vec<u8> {
    composed_of(gpu, &pixels(), format, texels, (behind, ColorEncoding::AsTrained))
}

/// Same as [`composed`], but with given pixels and encoding.
pub fn composed_of(
    gpu: &Gpu,
    pixels: &[[f32; 4]],
    format: vk::Format,
    texels: &[u8],
    onto: (Background, ColorEncoding),
) -> Vec<u8> {
    let compose = Compose::new(gpu.context).expect("kernels");
    let image = Image::new(gpu.context, "target", format, IMAGE, ImageUse::Target).expect("an image");
    Compose::check_frame(&image, onto.0, onto.1).expect("a possible format");
    let accumulated = gpu.buffer("accumulated", pixels);
    let (from, to) = (gpu.buffer("texels", texels), gpu.untouched::<u8>("texels", texels.len()));
    gpu.run(|r| {
        r.copy_to_image(&from.range(0, texels.len() as u64), &image);
        compose.record_color(r, &accumulated, SIZE, Region { image: &image, offset: OFFSET }, onto);
        r.copy_from_image(&image, &to.range(0, texels.len() as u64));
    });
    gpu.read(&to, texels.len())
}

/// Checks every texel: `expected` inside the frame, unchanged outside.
pub fn check(
    before: &[[f64; 4]],
    after: &[[f64; 4]],
    behind: Background,
    tolerance: f64,
    twin: impl Fn([f32; 4], [f64; 4]) -> [f64; 4],
) {
    check_each(before, after, behind, |_, _| tolerance, twin);
}

/// Same as [`check`], but with a tolerance per channel and expected value.
pub fn check_each(
    before: &[[f64; 4]],
    after: &[[f64; 4]],
    behind: Background,
    tolerance: impl Fn(usize, f64) -> f64,
    twin: impl Fn([f32; 4], [f64; 4]) -> [f64; 4],
) {
    let pixels = pixels();
    for y in 0..IMAGE[1] {
        for x in 0..IMAGE[0] {
            let texel = (y * IMAGE[0] + x) as usize;
            let inside = |at: u32, k: usize| (OFFSET[k]..OFFSET[k] + SIZE[k]).contains(&at);
            if !(inside(x, 0) && inside(y, 1)) {
                assert_eq!(after[texel], before[texel], "texel ({x}, {y}) lies outside");
                continue;
            }
            let pixel = pixels[((y - OFFSET[1]) * SIZE[0] + x - OFFSET[0]) as usize];
            let below = match behind {
                Background::Color([r, g, b]) => [r, g, b, 1.0].map(f64::from),
                Background::Nothing => [0.0; 4],
                Background::Image => before[texel],
            };
            let expected = twin(pixel, below);
            for (channel, (actual, number)) in after[texel].iter().zip(expected).enumerate() {
                let close = (actual - number).abs() <= tolerance(channel, number);
                assert!(close, "({x}, {y}) {behind:?}: {:?}, expected {expected:?}", after[texel]);
            }
        }
    }
}

/// Exposure of the linear output.
pub const EXPOSURE: f32 = 0.8;
pub const LINEAR: ColorEncoding = ColorEncoding::LinearSrgb { exposure: EXPOSURE };

/// True if the result is opaque.
pub fn is_opaque(behind: Background) -> bool {
    matches!(behind, Background::Color(_))
}

/// All kinds of background.
pub const BEHIND: [Background; 3] =
    [Background::Color([0.2, 0.4, 0.7]), Background::Nothing, Background::Image];
