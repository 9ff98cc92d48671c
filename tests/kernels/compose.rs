//! The kernels of `compose/`, which write a host's images, against their twins: `compose/compose_rgba8`,
//! `compose/compose_bgra8`, `compose/compose_rgb10a2`, `compose/compose_rgba16f`, `compose/compose_rgba32f`,
//! `compose/compose_r11g11b10f`, `compose/depth_limit`, `compose/expected_depth`, `compose/mean_motion` and
//! `compose/picks`.

use crate::common::gpu::{Gpu, UNTOUCHED};
use crate::common::scenes::Random;
use crate::reference::compose as twin;
use ashsplat::ColorEncoding;
use ashsplat::ColorEncoding::AsTrained;
use ashsplat::ash::vk::Format;
use ashsplat::frame::Outputs;
use ashsplat::kernels::compose::picks;
use ashsplat::kernels::constants::NOT_PICKED;
use ashsplat::passes::compose::{Background, Compose, Region};
use ashsplat::scene::DepthMapping;
use ashsplat::vk::{Image, ImageUse, Recorder};
use bytemuck::Pod;

/// Size of the frame, smaller than the image.
const SIZE: [u32; 2] = [21, 13];
/// Position of the frame in the image.
const OFFSET: [u32; 2] = [5, 2];
const IMAGE: [u32; 2] = [32, 17];

/// Pixels as blending leaves them: premultiplied colour, transmittance.
fn pixels() -> Vec<[f32; 4]> {
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

fn texels_of_rgb10a2() -> Vec<u32> {
    (0..TEXELS).map(|i| i.wrapping_mul(0x9e37_79b9)).collect()
}

/// Uncovered texels keep their bits.
#[test]
fn compose_rgb10a2_leaves_what_nothing_covers() {
    let gpu = Gpu::new();
    for (round, encoding) in (0..8_u32).flat_map(|round| [(round, AsTrained), (round, LINEAR)]) {
        let texels: Vec<u32> = texels_of_rgb10a2().iter().map(|t| t.rotate_left(4 * round) ^ round).collect();
        let bytes = bytemuck::cast_slice(&texels);
        keeps_what_nothing_covers(&gpu, Format::A2B10G10R10_UNORM_PACK32, bytes, encoding);
    }
}

/// Value of a half float that is finite.
pub fn from_half(bits: u16) -> f64 {
    let (exponent, mantissa) = (i32::from(bits >> 10 & 31), f64::from(bits & 1023));
    let size = match exponent {
        0 => mantissa * 2f64.powi(-24),
        _ => (1024.0 + mantissa) * 2f64.powi(exponent - 25),
    };
    if bits >> 15 == 1 { -size } else { size }
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

/// Records into a region of an image whose texels are all `before`. Returns the region's texels; the others must stay.
fn over_image<T: Pod + PartialEq + std::fmt::Debug>(
    gpu: &Gpu,
    (format, usage): (Format, ImageUse),
    before: T,
    record: impl FnOnce(&mut Recorder, Region<'_>),
) -> Vec<T> {
    let image = Image::new(gpu.context, "target", format, IMAGE, usage).expect("an image");
    let texels = vec![before; TEXELS as usize];
    let (from, to) = (gpu.buffer("texels", &texels), gpu.untouched::<T>("texels", texels.len()));
    gpu.run(|r| {
        r.copy_to_image(&from.range(0, from.bytes()), &image);
        record(r, Region { image: &image, offset: OFFSET, size: SIZE });
        r.copy_from_image(&image, &to.range(0, to.bytes()));
    });
    let after = gpu.read::<T>(&to, texels.len()).into_iter().enumerate();
    let (inside, outside): (Vec<_>, Vec<_>) = after.partition(|(index, _)| is_inside(position(*index)));
    for (index, texel) in outside {
        assert_eq!(texel, before, "{:?} lies outside", position(index));
    }
    inside.into_iter().map(|(_, texel)| texel).collect()
}

#[test]
fn expected_depth_equals_its_twin() {
    let gpu = Gpu::new();
    let compose = Compose::new(gpu.context).expect("kernels");
    let pixels = pixels();
    let sums: Vec<f32> = pixels.iter().enumerate().map(|(i, p)| (1.0 - p[3]) * (i + 1) as f32).collect();
    let (accumulated, depth_sums) = (gpu.buffer("accumulated", &pixels), gpu.buffer("depth_sums", &sums));
    for (min_weight, empty) in [(0.0, -1.0), (0.5, f32::INFINITY)] {
        let after = over_image(&gpu, (ashsplat::vk::DEPTH_FORMAT, ImageUse::Depth), -7.0_f32, |r, region| {
            compose.record_expected_depth(r, &accumulated, &depth_sums, region, min_weight, empty);
        });
        for (pixel, actual) in after.into_iter().map(f64::from).enumerate() {
            let expected =
                twin::expected_depth(pixels[pixel][3], sums[pixel], min_weight.into(), empty.into());
            let close = actual == expected || (actual - expected).abs() < 1e-3 * expected.abs();
            assert!(close, "{pixel}: {actual}, expected {expected}");
        }
    }
}

#[test]
fn mean_motion_equals_its_twin() {
    let gpu = Gpu::new();
    let mut compose = Compose::new(gpu.context).expect("kernels");
    compose.prepare(gpu.context, Outputs { motion: true, ..Outputs::default() }).expect("a kernel");
    let pixels = pixels();
    let sum = |i: usize, p: &[f32; 4]| {
        let large = if i.is_multiple_of(11) { 1e6 } else { 1.0 };
        [(1.0 - p[3]) * (i as f32 - 40.0) * large, (p[3] - 1.0) * 0.125]
    };
    let sums: Vec<[f32; 2]> = pixels.iter().enumerate().map(|(i, p)| sum(i, p)).collect();
    let (accumulated, motion_sums) = (gpu.buffer("accumulated", &pixels), gpu.buffer("motion_sums", &sums));
    // 1 and -2.
    let before = [0x3C00u16, 0xC000];
    let mut kinds = [0; 2];
    for (min_weight, empty) in [(0.0, Some([0.5, -8.0])), (0.5, Some([0.0; 2])), (0.5, None)] {
        let after = over_image(&gpu, (ashsplat::vk::MOTION_FORMAT, ImageUse::Motion), before, |r, region| {
            compose.record_motion(r, &accumulated, &motion_sums, region, min_weight, empty);
        });
        for (pixel, actual) in after.into_iter().enumerate() {
            let mean = twin::mean_motion(pixels[pixel][3], sums[pixel], min_weight.into());
            kinds[usize::from(mean.is_some())] += 1;
            let empty = empty.map_or(before.map(from_half), |empty| empty.map(f64::from));
            for (actual, expected) in actual.map(from_half).into_iter().zip(mean.unwrap_or(empty)) {
                let close = (actual - expected).abs() <= 1e-3 * expected.abs() + 1e-6;
                assert!(close, "{pixel}: {actual}, expected {expected}");
            }
        }
    }
    assert!(kinds.iter().all(|&count| count > 5), "{kinds:?}");
}

/// Scenes without Gaussians at the front, in the middle and at the end, and a scene of one Gaussian.
#[test]
fn picks_equal_their_twin() {
    let gpu = Gpu::new();
    for counts in [vec![64], vec![0, 0, 10, 0, 1, 0, 0, 53, 0], vec![1; 64]] {
        let firsts: Vec<u32> = (0..counts.len()).map(|scene| counts[..scene].iter().sum()).collect();
        let (columns, rows) = (SIZE[0].div_ceil(16), SIZE[1].div_ceil(16));
        let tiles = columns * rows;
        // Each tile lists the visible Gaussians in another order; every second Gaussian is visible.
        let (visible, entries) = (32, 32);
        let list: Vec<u32> = (0..visible).map(|i| 2 * i).collect();
        let ranges: Vec<[u32; 2]> = (0..tiles).map(|tile| [tile * entries, (tile + 1) * entries]).collect();
        let sorted: Vec<u32> =
            (0..tiles).flat_map(|tile| (0..entries).map(move |i| (i * 5 + tile) % visible)).collect();
        let depth = |visible: u32| 0.5 + visible as f32;
        let shades: Vec<[f32; 4]> = (0..visible).map(|i| [0.0, 0.0, 0.0, 1.0 / depth(i)]).collect();
        let pixels = SIZE[0] * SIZE[1];
        let picked: Vec<[u32; 2]> = (0..pixels)
            .map(|i| if i % 7 == 0 { [0, 0] } else { [1 + i % entries, (i as f32).to_bits()] })
            .collect();
        let spec = picks::Spec { workgroup_size: gpu.workgroup(64) };
        let kernel = gpu.kernel::<picks::Interface>(&spec);
        let push = picks::Push {
            image_width: SIZE[0],
            image_height: SIZE[1],
            offset_x: OFFSET[0],
            offset_y: OFFSET[1],
            tiles_per_row: columns,
            splat_stride: 1,
            scenes: counts.len() as u32,
        };
        let [visible_list, scene_firsts] =
            [("visible_list", &list), ("scene_firsts", &firsts)].map(|(name, words)| gpu.buffer(name, words));
        let (picks, tile_ranges) = (gpu.buffer("picks", &picked), gpu.buffer("tile_ranges", &ranges));
        let sorted_visible = gpu.buffer("sorted_visible", &sorted);
        let color_inverse_depth = gpu.buffer("color_inverse_depth", &shades);
        let after = over_image(&gpu, (ashsplat::vk::PICK_FORMAT, ImageUse::Pick), [7_u32; 4], |r, region| {
            let bind = picks::Bind {
                picks: &picks,
                tile_ranges: &tile_ranges,
                sorted_visible: &sorted_visible,
                visible_list: &visible_list,
                color_inverse_depth: &color_inverse_depth,
                scene_firsts: &scene_firsts,
                target: region.image,
            };
            r.dispatch(&kernel, &bind, &push, u64::from(pixels).div_ceil(u64::from(spec.workgroup_size)));
        });
        for (pixel, actual) in after.into_iter().enumerate() {
            let [place, weight] = picked[pixel];
            let expected = match place {
                0 => [NOT_PICKED, NOT_PICKED, 0, 0],
                _ => {
                    let [x, y] = [pixel as u32 % SIZE[0], pixel as u32 / SIZE[0]];
                    let tile = y / 16 * columns + x / 16;
                    let visible = ((place - 1) * 5 + tile) % visible;
                    let [gaussian, scene] = twin::scene_of(2 * visible, &counts);
                    let z = f32::from_bits(actual[2]);
                    assert!((z - depth(visible)).abs() < 1e-5 * z, "{z}");
                    [gaussian, scene, actual[2], weight]
                }
            };
            assert_eq!(actual, expected, "{pixel}");
        }
    }
}
