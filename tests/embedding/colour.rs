//! Contents of a host's images: their formats, and linear light. The expected values are the twin of `compose` over
//! the frame's own pixels.

use crate::stage::*;
use ashsplat::ash::vk::Format;
use ashsplat_reference::compose::{compose, compose_linear, decode, encode};

const SIZE: [u32; 2] = [64, 48];
const PIXELS: usize = (SIZE[0] * SIZE[1]) as usize;
const EXPOSED: ColorEncoding = ColorEncoding::LinearSrgb { exposure: 0.7 };

/// Previous contents of the host's image; exact in formats of floats.
const BELOW: [f32; 4] = [0.25, 0.5, 0.75, 1.0];
/// The same for formats of codes. Neither the values nor their linear light lie midway between two codes, where
/// devices may round either way.
const BELOW_CODES: [f32; 4] = [79.0 / 255.0, 85.0 / 255.0, 177.0 / 255.0, 1.0];

fn is_srgb(format: Format) -> bool {
    matches!(format, Format::R8G8B8A8_SRGB | Format::B8G8R8A8_SRGB)
}

/// Largest rounding error of a format: half the distance between its values. The device's conversion to 16-bit
/// floats may also truncate.
fn rounding(format: Format, channel: usize, value: f64) -> f64 {
    let float =
        |mantissa: i32| 2f64.powi(-mantissa - 1) * 2f64.powf(value.max(2f64.powi(-14)).log2().floor());
    match format {
        Format::R32G32B32A32_SFLOAT => 0.0,
        Format::R16G16B16A16_SFLOAT => 2.0 * float(10),
        Format::B10G11R11_UFLOAT_PACK32 => float(if channel == 2 { 5 } else { 6 }),
        Format::A2B10G10R10_UNORM_PACK32 if channel == 3 => 0.5 / 3.0,
        Format::A2B10G10R10_UNORM_PACK32 => 0.5 / 1023.0,
        _ => 0.5 / 255.0,
    }
}

/// Number of steps between 0 and 1 of a normalised format.
fn unorm_steps(format: Format) -> Option<f64> {
    match format {
        Format::B10G11R11_UFLOAT_PACK32 | Format::R16G16B16A16_SFLOAT | Format::R32G32B32A32_SFLOAT => None,
        Format::A2B10G10R10_UNORM_PACK32 => Some(1023.0),
        _ => Some(255.0),
    }
}

fn cleared(format: Format) -> [f32; 4] {
    if unorm_steps(format).is_some() { BELOW_CODES } else { BELOW }
}

/// A guest with a scene, and its blended pixels: premultiplied colours and transmittance.
struct Scene {
    context: Context,
    renderer: Renderer,
    scene: DeviceScene,
    camera: Camera,
    blended: Vec<[f32; 4]>,
}

impl Scene {
    fn new(host: &Host, gaussians: &Gaussians) -> Self {
        let context = guest(host);
        let scene = uploaded(&context, gaussians);
        let mut renderer = reserved(&context, &Reservation::new(scene.count(), 1, SIZE[0], SIZE[1]));
        let camera = camera(0.3, SIZE[0], SIZE[1]);
        let (settings, scenes) = (RenderSettings::default(), [(&scene).into()]);
        let blended = rendered(host, &mut renderer, &RecordedFrame::new(&scenes, &camera, &settings));
        Self { context, renderer, scene, camera, blended }
    }

    /// Composes the frame over the colour of [`cleared`] in an image of this format, and reads its texels.
    fn composed(
        &mut self,
        host: &Host,
        format: Format,
        behind: Background,
        encoding: ColorEncoding,
    ) -> Vec<[f64; 4]> {
        let target = Picture::new(host, &self.context, ("target", ImageUse::Target), format, SIZE);
        let (staging, commands) = (target.texture.staging(), Commands::new(host));
        let adopted = commands.begun(&self.context);
        target.texture.clear(commands.commands, ImageState::UNDEFINED, cleared(format));
        let to = host_image(&target.image, COPIED);
        let scenes = [(&self.scene).into()];
        let frame = RecordedFrame {
            target: Target::Image { to, behind, encoding },
            ..frame_of(&scenes, &self.camera)
        };
        let release = self.renderer.record(adopted, 0, &frame).expect("a recording");
        let left = used(release.color.expect("a target"));
        target.texture.record_read(host, commands.commands, left, &staging);
        commands.finish();
        self.renderer.release_slot(0).expect("finished");
        let bytes = texel_bytes(format) as usize;
        staging.read::<u8>().chunks_exact(bytes).map(|texel| texel_of(format, texel)).collect()
    }

    /// Composes the frame's pixels over `below` with the twin.
    fn expected(&self, (behind, encoding): (Background, ColorEncoding), below: [f64; 4]) -> Vec<[f64; 4]> {
        let (behind, opaque) = match behind {
            Background::Color([r, g, b]) => ([r, g, b, 1.0].map(f64::from), true),
            Background::Nothing => ([0.0; 4], false),
            Background::Image => (below, false),
        };
        let pixel = |&pixel: &[f32; 4]| match encoding {
            ColorEncoding::AsTrained => compose(pixel, behind),
            ColorEncoding::LinearSrgb { exposure } => compose_linear(pixel, behind, opaque, exposure.into()),
        };
        self.blended.iter().map(pixel).collect()
    }
}

/// Value of a small float without a sign.
fn small_float(bits: u32, mantissa_bits: i32) -> f64 {
    let (exponent, mantissa) = ((bits >> mantissa_bits) as i32, f64::from(bits & ((1 << mantissa_bits) - 1)));
    let steps = 2f64.powi(mantissa_bits);
    match exponent {
        0 => mantissa / steps * 2f64.powi(-14),
        _ => (1.0 + mantissa / steps) * 2f64.powi(exponent - 15),
    }
}

/// Values of a texel; those of an sRGB format are its codes.
fn texel_of(format: Format, bytes: &[u8]) -> [f64; 4] {
    let word = |at: usize| u32::from_le_bytes([0, 1, 2, 3].map(|k| bytes[at + k]));
    let [r, g, b, a] = [0, 1, 2, 3].map(|k| f64::from(bytes[k]) / 255.0);
    let all = word(0);
    match format {
        Format::B8G8R8A8_UNORM | Format::B8G8R8A8_SRGB => [b, g, r, a],
        Format::A2B10G10R10_UNORM_PACK32 => {
            let [r, g, b] = [0, 10, 20].map(|first| f64::from(all >> first & 1023) / 1023.0);
            [r, g, b, f64::from(all >> 30) / 3.0]
        }
        Format::B10G11R11_UFLOAT_PACK32 => {
            [small_float(all & 2047, 6), small_float(all >> 11 & 2047, 6), small_float(all >> 22, 5), 1.0]
        }
        Format::R16G16B16A16_SFLOAT => {
            [0, 2, 4, 6].map(|at| small_float(u32::from_le_bytes([bytes[at], bytes[at + 1], 0, 0]), 10))
        }
        Format::R32G32B32A32_SFLOAT => [0, 4, 8, 12].map(|at| f64::from(f32::from_bits(word(at)))),
        _ => [r, g, b, a],
    }
}

fn assert_close(format: Format, what: &str, actual: &[[f64; 4]], expected: &[[f64; 4]]) {
    assert_eq!(actual.len(), expected.len());
    for (pixel, (actual, expected)) in actual.iter().zip(expected).enumerate() {
        for channel in 0..4 {
            if channel == 3 && format == Format::B10G11R11_UFLOAT_PACK32 {
                continue;
            }
            let tolerance = 2e-5 + 1.01 * rounding(format, channel, expected[channel]);
            let close = (actual[channel] - expected[channel]).abs() <= tolerance;
            assert!(close, "{format:?}, {what}, pixel {pixel}: {actual:?}, expected {expected:?}");
        }
    }
}

fn encoded([r, g, b, a]: [f64; 4]) -> [f64; 4] {
    [encode(r), encode(g), encode(b), a]
}

/// The colour of [`cleared`] after the clear, as the guest reads it: an sRGB format holds codes.
fn below(format: Format, encoding: ColorEncoding) -> [f64; 4] {
    let below = cleared(format).map(f64::from);
    let held = |x: f64| unorm_steps(format).map_or(x, |steps| (x * steps).round() / steps);
    match (is_srgb(format), encoding) {
        (false, _) => below.map(held),
        (true, ColorEncoding::AsTrained) => encoded(below).map(held),
        (true, ColorEncoding::LinearSrgb { .. }) => encoded(below).map(held).map(decode),
    }
}

const GREY: Background = Background::Color([0.2, 0.6, 0.4]);

/// Every format over every background in both encodings holds the picture of 32-bit floats, within the format's
/// precision.
#[test]
fn every_format_holds_the_picture() {
    with_host(&options(), |host| {
        let mut scene = Scene::new(host, &cloud(700, 3));
        let partly = scene.blended.iter().filter(|pixel| (0.1..0.9).contains(&pixel[3])).count();
        assert!(partly > PIXELS / 8, "{partly} pixels are partly covered");
        for format in ashsplat::vk::COLOR_FORMATS {
            for behind in [GREY, Background::Nothing, Background::Image] {
                if behind == Background::Nothing && format == Format::B10G11R11_UFLOAT_PACK32 {
                    continue;
                }
                for encoding in [ColorEncoding::AsTrained, ColorEncoding::LINEAR, EXPOSED] {
                    let actual = scene.composed(host, format, behind, encoding);
                    let below = below(format, encoding);
                    let mut expected = scene.expected((behind, encoding), below);
                    if is_srgb(format) && encoding != ColorEncoding::AsTrained {
                        expected.iter_mut().for_each(|pixel| *pixel = encoded(*pixel));
                    }
                    if unorm_steps(format).is_some() {
                        expected.iter_mut().flatten().for_each(|x| *x = x.min(1.0));
                    }
                    assert_close(format, &format!("{behind:?} {encoding:?}"), &actual, &expected);
                }
            }
        }
    });
}

fn panels(pictures: [image::RgbImage; 2]) -> image::RgbImage {
    let (width, height) = pictures[0].dimensions();
    let mut both = image::RgbImage::from_pixel(2 * width + 8, height, image::Rgb([255; 3]));
    for (at, picture) in [0, width + 8].into_iter().zip(&pictures) {
        image::imageops::replace(&mut both, picture, at.into(), 0);
    }
    both
}

/// Run with `ASHSPLAT_PICTURES=engine/guide/pictures cargo test --release --test embedding -- --ignored
/// pictures_of_the_guide`.
#[test]
#[ignore = "writes files of the guide"]
fn pictures_of_the_guide() {
    let folder = std::path::PathBuf::from(std::env::var_os("ASHSPLAT_PICTURES").expect("a folder"));
    let drawn = tempfile::tempdir().expect("a folder");
    crate::guest::pictures(drawn.path(), &options()).expect("pictures");
    let part = |name: &str| {
        let picture = image::open(drawn.path().join(format!("embed_{name}.png"))).expect("a picture");
        picture.crop_imm(60, 20, 360, 320).into_rgb8()
    };
    panels([part("washed_out"), part("turned")]).save(folder.join("colour_target.png")).expect("written");

    // Over white in linear light: premultiplied colours decoded directly, and colours decoded before the product
    // with alpha.
    let camera = camera(0.6, 120, 106);
    let frame = owned(&crate::guest::ring(), &camera, &RenderSettings::default());
    let over_white = |light: &dyn Fn(f64, f64) -> f64| {
        let mut picture = image::RgbImage::new(camera.width, camera.height);
        for (pixel, (color, transmittance)) in
            picture.pixels_mut().zip(frame.color.iter().zip(&frame.transmittance))
        {
            let transmittance = f64::from(*transmittance);
            let mixed = color.map(|c| encode(light(c.into(), 1.0 - transmittance) + transmittance));
            pixel.0 = mixed.map(|x| (255.0 * x.clamp(0.0, 1.0)).round() as u8);
        }
        let part = image::imageops::crop_imm(&picture, 52, 46, 60, 40).to_image();
        image::imageops::resize(&part, 360, 240, image::imageops::FilterType::Nearest)
    };
    let naive = over_white(&|color, _| decode(color));
    let right = over_white(&|color, alpha| if alpha > 0.0 { alpha * decode(color / alpha) } else { 0.0 });
    panels([naive, right]).save(folder.join("colour_alpha.png")).expect("written");
}
