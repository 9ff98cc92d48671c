//! `.splat`: 32 bytes for each Gaussian, without header and without view dependence.
//!
//! Mean and standard deviations as floats, colour and opacity as bytes, then the quaternion (w, x, y, z) as bytes
//! around 128. Format: antimatter15/splat.

use std::path::Path;

use super::{Blocks, Format, Header, Opened, Produce, Sink, spz};
use crate::atomic;
use crate::regular_file::{self, OnFile, u32_at};
use ashsplat::scene::Gaussians;
use ashsplat::scene::sh::{rgb_to_sh_dc, sh_dc_to_rgb};
use ashsplat::{Error, Result};

const ROW: usize = 32;
/// Least distance of a stored opacity from 0 and 1, whose logits are infinite.
const OPACITY_MARGIN: f64 = 1e-6;

pub(super) fn open(path: &Path) -> Result<Opened<'_>> {
    let (mut file, bytes) = regular_file::open(path)?;
    if bytes == 0 {
        return Err(Error::input(path, "is empty", "download or copy it again"));
    }
    let (count, rest) = (bytes / ROW as u64, bytes % ROW as u64);
    if rest > 0 {
        let problem = format!("has {rest} bytes after {count} Gaussians of {ROW} bytes");
        return Err(Error::input(path, problem, "it is cut short or no .splat: download it again"));
    }
    let produce = move |sink: &mut Sink<'_>| {
        let mut blocks = Blocks::new(0, count, sink);
        regular_file::rows(path, &mut file, (count, ROW), |row| {
            unpack(row, blocks.next()?);
            Ok(())
        })?;
        blocks.finish()
    };
    Ok((Header::new(Format::Splat, count, 0), Box::new(produce)))
}

/// Logit of an opacity in 255ths.
pub(super) fn opacity_logit(byte: u8) -> f32 {
    let opacity = (f64::from(byte) / 255.0).clamp(OPACITY_MARGIN, 1.0 - OPACITY_MARGIN);
    (opacity / (1.0 - opacity)).ln() as f32
}

fn unpack(row: &[u8], block: &mut Gaussians) {
    let float = |at: usize| f32::from_bits(u32_at(row, at));
    block.means.push([float(0), float(4), float(8)]);
    // The logarithm of a negative size is NaN, which is unusable.
    block.log_scales.push([float(12), float(16), float(20)].map(libm::logf));
    block.sh.push([24, 25, 26].map(|at| rgb_to_sh_dc(f32::from(row[at]) / 255.0)));
    block.opacity_logits.push(opacity_logit(row[27]));
    let quat = [28, 29, 30, 31].map(|at| (f32::from(row[at]) - 128.0) / 128.0);
    let length = quat.iter().map(|q| q * q).sum::<f32>().sqrt();
    block.quats.push(if length > 0.0 { quat.map(|q| q / length) } else { quat });
}

pub(super) fn write(path: &Path, produce: &mut Produce<'_>) -> Result<()> {
    atomic::write_seekable(path, |writer| {
        let mut rows = Vec::new();
        produce(&mut |block| {
            rows.clear();
            (0..block.len()).for_each(|index| pack(&block, index, &mut rows));
            writer.write_all(&rows).writing(path)
        })
    })
}

fn pack(block: &Gaussians, index: usize, rows: &mut Vec<u8>) {
    let byte = |value: f32| value.round().clamp(0.0, 255.0) as u8;
    let scales = block.log_scales[index].map(libm::expf);
    for value in block.means[index].iter().chain(&scales) {
        rows.extend(value.to_le_bytes());
    }
    rows.extend(block.sh_of(index)[0].map(|dc| byte(255.0 * sh_dc_to_rgb(dc))));
    rows.push(byte(255.0 * block.opacity(index)));
    rows.extend(spz::unit(block.quats[index]).map(|q| byte(q * 128.0 + 128.0)));
}
