//! `compose/compose_r11g11b10f` against the twin of `compose/compose_rgba32f`, rounded to the format.

use ashsplat::ash::vk::Format;

use crate::common::compose::{
    BEHIND, EXPOSURE, IMAGE, LINEAR, SIZE, check_each, composed, composed_of, is_opaque, pixels,
};
use crate::common::gpu::Gpu;
use crate::reference::compose_rgba32f::{compose, compose_linear};

const FORMAT: Format = Format::B10G11R11_UFLOAT_PACK32;
/// Mantissa bits of red, green and blue.
const MANTISSA_BITS: [i32; 3] = [6, 6, 5];

fn number(bits: u32, mantissa_bits: i32) -> f64 {
    let (exponent, mantissa) = ((bits >> mantissa_bits) as i32, f64::from(bits & ((1 << mantissa_bits) - 1)));
    let steps = 2f64.powi(mantissa_bits);
    match exponent {
        0 => mantissa / steps * 2f64.powi(-14),
        _ => (1.0 + mantissa / steps) * 2f64.powi(exponent - 15),
    }
}

fn wide(texels: &[u32]) -> Vec<[f64; 4]> {
    let texel = |&t: &u32| [number(t & 2047, 6), number(t >> 11 & 2047, 6), number(t >> 22, 5), 1.0];
    texels.iter().map(texel).collect()
}

/// Half of the distance between numbers. The format has no alpha.
fn tolerance(channel: usize, number: f64) -> f64 {
    let Some(bits) = MANTISSA_BITS.get(channel) else { return 1.0 };
    1e-6 + 1.001 * 2f64.powi(-bits - 1) * 2f64.powf(number.max(2f64.powi(-14)).log2().floor())
}

/// Texels from 1/64 to 2.
fn texels() -> Vec<u32> {
    let part = |i: u32, bits: u32| (9 << bits) + i % (7 << bits);
    (0..IMAGE[0] * IMAGE[1]).map(|i| part(i, 6) | part(5 * i, 6) << 11 | part(3 * i, 5) << 22).collect()
}

fn read(after: Vec<u8>) -> Vec<[f64; 4]> {
    wide(&bytemuck::pod_collect_to_vec::<_, u32>(&after))
}

#[test]
fn compose_r11g11b10f_equals_its_twin() {
    let gpu = Gpu::new();
    let texels = texels();
    let bytes = bytemuck::cast_slice(&texels);
    // The engine refuses premultiplied colours without alpha.
    for behind in [BEHIND[0], BEHIND[2]] {
        let after = read(composed(&gpu, FORMAT, bytes, behind));
        check_each(&wide(&texels), &after, behind, tolerance, compose);
        let after = read(composed_of(&gpu, &pixels(), FORMAT, bytes, (behind, LINEAR)));
        check_each(&wide(&texels), &after, behind, tolerance, |pixel, below| {
            compose_linear(pixel, below, is_opaque(behind), EXPOSURE.into())
        });
    }
}

/// Every finite number survives under uncovered pixels: around the smallest normal one, and up to the largest.
#[test]
fn compose_r11g11b10f_leaves_what_nothing_covers() {
    let gpu = Gpu::new();
    let count = SIZE[0] * SIZE[1];
    let nothing = vec![[0.0, 0.0, 0.0, 1.0]; count as usize];
    for round in 0..(31 * 64_u32).div_ceil(count) {
        let texel = |i: u32| {
            let code = (round * count + i) % (31 * 64);
            code | (31 * 64 - 1 - code) << 11 | (code % (31 * 32)) << 22
        };
        // Consecutive texels have all codes, so that the frame's position does not matter.
        let texels: Vec<u32> = (0..IMAGE[0] * IMAGE[1]).map(|i| texel(i % count)).collect();
        let bytes = bytemuck::cast_slice(&texels);
        assert_eq!(composed_of(&gpu, &nothing, FORMAT, bytes, (BEHIND[2], LINEAR)), bytes);
    }
}

/// Values above the format's largest number become that number, not infinity. Negative values become 0.
#[test]
fn compose_r11g11b10f_stays_finite() {
    let gpu = Gpu::new();
    let texels = vec![0_u32; (IMAGE[0] * IMAGE[1]) as usize];
    let bright = vec![[1e30, 66000.0, -1.0, 0.5]; (SIZE[0] * SIZE[1]) as usize];
    let behind = BEHIND[2];
    let onto = (behind, ashsplat::ColorEncoding::AsTrained);
    let after = composed_of(&gpu, &bright, FORMAT, bytemuck::cast_slice(&texels), onto);
    let changed: Vec<[f64; 4]> = read(after).into_iter().filter(|t| t[0] > 0.0).collect();
    assert_eq!(changed.len(), bright.len());
    assert!(changed.iter().all(|t| t[..3] == [65024.0, 65024.0, 0.0]), "{:?}", changed[0]);
}
