//! Packs and unpacks the attributes of SPZ, one plane of bytes each.
//!
//! Format: Niantic's description (github.com/nianticlabs/spz). Axes are right, up, back: y and z are opposite
//! to those of this crate.

use crate::cost;
use ashsplat::scene::Gaussians;
use ashsplat::scene::gaussians::sh_coefficients;

/// Factor of the constant SH term in a colour byte.
const COLOR_SCALE: f32 = 0.15;

/// Bits of SH values that the reference keeps, for degree 1 and for higher degrees.
const SH_BITS: [u32; 2] = [5, 4];

/// Axes that are opposite in this crate and in SPZ.
pub(super) const MIRRORED: [bool; 3] = [false, true, true];

/// Number of attributes.
pub(super) const PLANES: usize = 6;

/// Packing of a file's attributes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Packing {
    /// 2, 3 or 4.
    pub(super) version: u32,
    /// Stored degree, 0 to 4.
    pub(super) sh_degree: u32,
    /// Fractional bits of a coordinate.
    pub(super) fractional_bits: u32,
}

impl Packing {
    /// Bytes of one Gaussian in each plane: means, opacities, colours, scales, rotations, higher SH.
    pub(super) fn row_bytes(&self) -> [usize; PLANES] {
        let rotation = if self.version == 2 { 3 } else { 4 };
        [9, 1, 3, 3, rotation, 3 * (sh_coefficients(self.sh_degree) - 1)]
    }

    /// Unpacks the Gaussians from `start` to `end` at an SH degree of at most 3.
    pub(super) fn unpack(&self, planes: &[Vec<u8>; PLANES], rows: std::ops::Range<usize>) -> Gaussians {
        let bytes = self.row_bytes();
        let row =
            |plane: usize, index: usize| &planes[plane][index * bytes[plane]..(index + 1) * bytes[plane]];
        let sh_degree = self.sh_degree.min(3);
        let unit = (-(self.fractional_bits as f32)).exp2();
        let mut block = Gaussians::with_capacity(sh_degree, rows.len());
        for index in rows {
            cost::step();
            let mean = row(0, index);
            block.means.push(std::array::from_fn(|axis| fixed_24(&mean[3 * axis..]) as f32 * unit));
            let opacity = (f32::from(row(1, index)[0]) / 255.0).clamp(1.0 / 255.0, 254.0 / 255.0);
            block.opacity_logits.push((opacity / (1.0 - opacity)).ln());
            let color = row(2, index);
            block.sh.push(std::array::from_fn(|c| (f32::from(color[c]) / 255.0 - 0.5) / COLOR_SCALE));
            let scale = row(3, index);
            block.log_scales.push(std::array::from_fn(|axis| f32::from(scale[axis]) / 16.0 - 10.0));
            block.quats.push(match *row(4, index) {
                [x, y, z] => first_three([x, y, z]),
                [a, b, c, d] => smallest_three(u32::from_le_bytes([a, b, c, d])),
                _ => [1.0, 0.0, 0.0, 0.0],
            });
            let sh = row(5, index).as_chunks::<3>().0.iter().take(sh_coefficients(sh_degree) - 1);
            block.sh.extend(sh.map(|rgb| rgb.map(|byte| (f32::from(byte) - 128.0) / 128.0)));
        }
        block
    }

    /// Appends packed Gaussians to the planes.
    pub(super) fn pack(&self, block: &Gaussians, planes: &mut [Vec<u8>; PLANES]) {
        let factor = (self.fractional_bits as f32).exp2();
        for index in 0..block.len() {
            for value in block.means[index] {
                let fixed = (value * factor).round().clamp(-8_388_608.0, 8_388_607.0) as i32;
                planes[0].extend_from_slice(&fixed.to_le_bytes()[..3]);
            }
            planes[1].push(byte(255.0 * block.opacity(index)));
            let sh = block.sh_of(index);
            planes[2].extend(sh[0].map(|dc| byte(dc * (COLOR_SCALE * 255.0) + 0.5 * 255.0)));
            planes[3].extend(block.log_scales[index].map(|s| byte((s + 10.0) * 16.0)));
            match self.version {
                2 => planes[4].extend(pack_first_three(block.quats[index])),
                _ => planes[4].extend(pack_smallest_three(block.quats[index]).to_le_bytes()),
            }
            for (k, rgb) in sh[1..].iter().enumerate() {
                let bits = if k < 3 { SH_BITS[0] } else { SH_BITS[1] };
                planes[5].extend(rgb.map(|value| pack_sh(value, 1 << (8 - bits))));
            }
        }
    }
}

fn byte(value: f32) -> u8 {
    value.round().clamp(0.0, 255.0) as u8
}

fn fixed_24(bytes: &[u8]) -> i32 {
    // The arithmetic shift extends the sign of the top byte.
    i32::from_le_bytes([0, bytes[0], bytes[1], bytes[2]]) >> 8
}

/// Rotation of version 2: x, y, z as bytes; w is positive.
fn first_three(bytes: [u8; 3]) -> [f32; 4] {
    let [x, y, z] = bytes.map(|b| f32::from(b) / 127.5 - 1.0);
    let w = (1.0 - (x * x + y * y + z * z)).max(0.0).sqrt();
    [w, x, y, z]
}

fn pack_first_three(quat: [f32; 4]) -> [u8; 3] {
    let [w, x, y, z] = unit(quat);
    [x, y, z].map(|v| byte(127.5 + 127.5 * v * w.signum()))
}

/// Normalises a quaternion; one of length 0 becomes the identity.
fn unit([w, x, y, z]: [f32; 4]) -> [f32; 4] {
    let length = (w * w + x * x + y * y + z * z).sqrt();
    if length > 0.0 { [w, x, y, z].map(|v| v / length) } else { [1.0, 0.0, 0.0, 0.0] }
}

/// Rotation from version 3 on: the index of the largest of x, y, z, w, and the others as sign and 9 bits.
fn smallest_three(packed: u32) -> [f32; 4] {
    const MAGNITUDE: u32 = (1 << 9) - 1;
    let largest = (packed >> 30) as usize;
    let mut rest = packed;
    let mut xyzw = [0.0f32; 4];
    for i in (0..4).rev().filter(|&i| i != largest) {
        let magnitude = (rest & MAGNITUDE) as f32 / MAGNITUDE as f32 * std::f32::consts::FRAC_1_SQRT_2;
        xyzw[i] = if rest & (1 << 9) == 0 { magnitude } else { -magnitude };
        rest >>= 10;
    }
    xyzw[largest] = (1.0 - xyzw.iter().map(|v| v * v).sum::<f32>()).max(0.0).sqrt();
    let [x, y, z, w] = xyzw;
    [w, x, y, z]
}

fn pack_smallest_three(quat: [f32; 4]) -> u32 {
    let [w, x, y, z] = unit(quat);
    let xyzw = [x, y, z, w];
    let largest = (1..4).fold(0, |best, i| if xyzw[i].abs() > xyzw[best].abs() { i } else { best });
    let others = (0..4).filter(|&i| i != largest);
    others.fold(largest as u32, |packed, i| {
        let negative = (xyzw[i] < 0.0) != (xyzw[largest] < 0.0);
        let magnitude = (511.0 * (xyzw[i].abs() * std::f32::consts::SQRT_2) + 0.5) as u32;
        packed << 10 | u32::from(negative) << 9 | magnitude.min(511)
    })
}

/// Rounds to multiples of `step`, so that it compresses better; 0 stays 0.
fn pack_sh(value: f32, step: i32) -> u8 {
    // Values outside the range end at the nearest byte. The clamp prevents overflow.
    let fine = (value * 128.0).round().clamp(-256.0, 256.0) as i32 + 128;
    ((fine + step / 2).div_euclid(step) * step).clamp(0, 255) as u8
}
