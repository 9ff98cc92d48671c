//! The kernels of `compose/`, which write a host's images, against their twins: `compose/compose_rgba8`,
//! `compose/compose_bgra8`, `compose/compose_rgb10a2`, `compose/compose_rgba16f`, `compose/compose_rgba32f`,
//! `compose/compose_r11g11b10f`, `compose/depth_limit`, `compose/expected_depth` and `compose/mean_motion`.

use crate::common::gpu::{Gpu, UNTOUCHED};
use crate::reference::compose as twin;
use ashsplat::ColorEncoding;
use ashsplat::ColorEncoding::AsTrained;
use ashsplat::ash::vk::Format;
use ashsplat::passes::compose::{Background, Compose, Region};
use ashsplat::scene::DepthMapping;
use ashsplat::vk::{Image, ImageUse};

/// Size of the frame, smaller than the image.
const SIZE: [u32; 2] = [21, 13];
/// Position of the frame in the image.
const OFFSET: [u32; 2] = [5, 2];
const IMAGE: [u32; 2] = [32, 17];

/// Composes pixels over an image of `texels`. Returns the image's bytes.
fn composed(
    gpu: &Gpu,
    pixels: &[[f32; 4]],
    format: Format,
    texels: &[u8],
    (behind, encoding): (Background, ColorEncoding),
) -> Vec<u8> {
    let compose = Compose::new(gpu.context).expect("kernels");
    let image = Image::new(gpu.context, "target", format, IMAGE, ImageUse::Target).expect("an image");
    let accumulated = gpu.buffer("accumulated", pixels);
    let (from, to) = (gpu.buffer("texels", texels), gpu.untouched::<u8>("texels", texels.len()));
    gpu.run(|r| {
        r.copy_to_image(&from.range(0, texels.len() as u64), &image);
        let region = Region { image: &image, offset: OFFSET, size: SIZE };
        compose.record_color(r, &accumulated, region, behind, encoding);
        r.copy_from_image(&image, &to.range(0, texels.len() as u64));
    });
    gpu.read(&to, texels.len())
}

const EXPOSURE: f32 = 0.8;
const LINEAR: ColorEncoding = ColorEncoding::LinearSrgb { exposure: EXPOSURE };

const BEHIND: [Background; 3] = [Background::Color([0.2, 0.4, 0.7]), Background::Nothing, Background::Image];

const TEXELS: u32 = IMAGE[0] * IMAGE[1];

/// Asserts that pixels which nothing covers leave the texels' bits.
fn keeps_what_nothing_covers(gpu: &Gpu, format: Format, texels: &[u8], encoding: ColorEncoding) {
    let nothing = vec![[0.0, 0.0, 0.0, 1.0]; (SIZE[0] * SIZE[1]) as usize];
    assert_eq!(composed(gpu, &nothing, format, texels, (Background::Image, encoding)), texels);
}

fn is_inside(at: [u32; 2]) -> bool {
    (0..2).all(|k| (OFFSET[k]..OFFSET[k] + SIZE[k]).contains(&at[k]))
}

fn position(index: usize) -> [u32; 2] {
    [index as u32 % IMAGE[0], index as u32 / IMAGE[0]]
}

/// Each of the 256 codes under uncovered pixels survives decoding and encoding.
#[test]
fn compose_rgba8_leaves_what_nothing_covers() {
    let mut texels = Vec::new();
    let mut code = 0_u32;
    for index in 0..TEXELS as usize {
        texels.extend([code as u8, 255 - code as u8, (code * 7) as u8, 255]);
        code = (code + u32::from(is_inside(position(index)))) % 256;
    }
    keeps_what_nothing_covers(&Gpu::new(), Format::R8G8B8A8_SRGB, &texels, LINEAR);
}

/// Uncovered texels keep their bits.
#[test]
fn compose_rgb10a2_leaves_what_nothing_covers() {
    let gpu = Gpu::new();
    for (round, encoding) in (0..8_u32).flat_map(|round| [(round, AsTrained), (round, LINEAR)]) {
        let random = (0..TEXELS).map(|i| i.wrapping_mul(0x9e37_79b9));
        let texels: Vec<u32> = random.map(|t| t.rotate_left(4 * round) ^ round).collect();
        let bytes = bytemuck::cast_slice(&texels);
        keeps_what_nothing_covers(&gpu, Format::A2B10G10R10_UNORM_PACK32, bytes, encoding);
    }
}

/// Colours above the format's largest number become that number, not infinity.
#[test]
fn compose_rgba16f_stays_finite() {
    let gpu = Gpu::new();
    let texels = vec![0x3800_u16; (TEXELS * 4) as usize];
    let bright = vec![[1e30, 65504.0, 66000.0, 0.5]; (SIZE[0] * SIZE[1]) as usize];
    for behind in BEHIND {
        let (format, bytes) = (Format::R16G16B16A16_SFLOAT, bytemuck::cast_slice(&texels));
        let after = composed(&gpu, &bright, format, bytes, (behind, AsTrained));
        let after: Vec<[u16; 4]> = bytemuck::pod_collect_to_vec(&after);
        let changed: Vec<_> = after.iter().filter(|t| t[0] != 0x3800).collect();
        assert_eq!(changed.len(), bright.len());
        assert!(changed.iter().all(|t| t[..3] == [0x7bff; 3]), "{behind:?}: {:x?}", changed[0]);
    }
}

const R11G11B10F: Format = Format::B10G11R11_UFLOAT_PACK32;

fn read_r11g11b10f(texels: &[u8]) -> Vec<[f64; 4]> {
    let number = |bits: u32, mantissa_bits: i32| {
        let (exponent, mantissa) =
            ((bits >> mantissa_bits) as i32, f64::from(bits & ((1 << mantissa_bits) - 1)));
        let share = mantissa / 2f64.powi(mantissa_bits);
        match exponent {
            0 => share * 2f64.powi(-14),
            _ => (1.0 + share) * 2f64.powi(exponent - 15),
        }
    };
    let texel = |t: u32| [number(t & 2047, 6), number(t >> 11 & 2047, 6), number(t >> 22, 5), 1.0];
    bytemuck::pod_collect_to_vec::<_, u32>(texels).into_iter().map(texel).collect()
}

/// Every finite number survives under uncovered pixels: around the smallest normal one, and up to the largest.
#[test]
fn compose_r11g11b10f_leaves_what_nothing_covers() {
    let gpu = Gpu::new();
    let count = SIZE[0] * SIZE[1];
    for round in 0..(31 * 64_u32).div_ceil(count) {
        let texel = |i: u32| {
            let code = (round * count + i) % (31 * 64);
            code | (31 * 64 - 1 - code) << 11 | (code % (31 * 32)) << 22
        };
        // Consecutive texels have all codes, so that the frame's position does not matter.
        let texels: Vec<u32> = (0..TEXELS).map(|i| texel(i % count)).collect();
        keeps_what_nothing_covers(&gpu, R11G11B10F, bytemuck::cast_slice(&texels), LINEAR);
    }
}

/// Values above the format's largest number become that number, not infinity. Negative values become 0.
#[test]
fn compose_r11g11b10f_stays_finite() {
    let bright = vec![[1e30, 66000.0, -1.0, 0.5]; (SIZE[0] * SIZE[1]) as usize];
    let (texels, onto) = (vec![0; 4 * TEXELS as usize], (Background::Image, AsTrained));
    let after = read_r11g11b10f(&composed(&Gpu::new(), &bright, R11G11B10F, &texels, onto));
    let changed: Vec<[f64; 4]> = after.into_iter().filter(|t| t[0] > 0.0).collect();
    assert_eq!(changed.len(), bright.len());
    assert!(changed.iter().all(|t| t[..3] == [65024.0, 65024.0, 0.0]), "{:?}", changed[0]);
}

#[test]
fn depth_limit_equals_its_twin() {
    let gpu = Gpu::new();
    let compose = Compose::new(gpu.context).expect("kernels");
    let texels: Vec<f32> =
        (0..TEXELS).map(|i| if i % 7 == 0 { (i % 2) as f32 } else { (i % 89) as f32 / 90.0 }).collect();
    // Standard, reversed with a far plane, reversed without one.
    let perspectives = [(-9.98, 10.0, 1.0), (9.98, 0.02, 0.0), (10.0, 0.0, 0.0)].map(|m| (m, false));
    // Standard and reversed depth of parallel rays, and a near plane behind the camera.
    let parallel = [(99.5, 0.5, 1.0), (-99.5, 100.0, 0.0), (-20.0, 15.0, 0.0)].map(|m| (m, true));
    let mut formats = vec![Format::R32_SFLOAT];
    // Only a graphics queue may copy depth. The hosts' tests use depth that was drawn.
    match gpu.context.draws() {
        true => formats.push(Format::D32_SFLOAT),
        false => eprintln!("skipped: depth formats: the queue does not draw"),
    }
    for format in formats {
        let image = Image::new(gpu.context, "depth", format, IMAGE, ImageUse::Occluder).expect("an image");
        let from = gpu.buffer("texels", &texels);
        for ((scale, offset, clear_value), linear) in perspectives.into_iter().chain(parallel) {
            let mapping = DepthMapping { scale, offset, clear_value, linear };
            let count = (SIZE[0] * SIZE[1]) as usize;
            let limits = gpu.untouched::<f32>("depth_limits", count + 4);
            gpu.run(|r| {
                r.copy_to_image(&from.range(0, from.bytes()), &image);
                let region = Region { image: &image, offset: OFFSET, size: SIZE };
                compose.record_depth_limits(r, region, mapping, &limits);
            });
            let words = gpu.read::<f32>(&limits, count + 4);
            for (index, actual) in words[..count].iter().enumerate() {
                let (x, y) = (index as u32 % SIZE[0] + OFFSET[0], index as u32 / SIZE[0] + OFFSET[1]);
                let depth = texels[(y * IMAGE[0] + x) as usize];
                let expected = twin::depth_limit(depth, (scale.into(), offset.into()), linear, clear_value);
                // Cancellation near the camera.
                let bound = if linear { 2e-6 * expected.max(expected * expected * 100.0) } else { 2e-6 };
                let both_hide = expected > 1e30 && *actual > 1e30;
                let close = (f64::from(*actual) - expected).abs() <= bound || both_hide;
                assert!(close, "{format:?} ({x}, {y}) of depth {depth}: {actual}, expected {expected}");
            }
            assert!(words[count..].iter().all(|word| word.to_bits() == UNTOUCHED));
        }
    }
}
