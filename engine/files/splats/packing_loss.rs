//! Losses of a scene in a format with packed attributes.

use super::doubtful::{COARSE, short};
use super::spz_write::{MAX_FRACTIONAL_BITS, farthest, fractional_bits};
use super::{Format, MAX_COMPRESSED_LOG_SCALE, Outline};
use crate::ply;
use ashsplat::scene::Gaussians;
use ashsplat::scene::sh::rgb_to_sh_dc;

/// Logarithm of the ratio at which a Gaussian's longest axis hides that its thinnest one is cut.
const THIN: f32 = 3.0;

/// Share of the Gaussians with cut colours or SH coefficients in ordinary scenes.
const USUALLY_CUT: f64 = 0.02;

/// Statistics of a scene's Gaussians against the limits of a format.
pub(super) struct PackingLoss {
    /// Smallest and largest log-scale.
    log_scales: [f32; 2],
    /// Smallest and largest coefficient of a base colour.
    dc: [f32; 2],
    /// Largest higher SH coefficient.
    max_sh: f32,
    count: u64,
    /// Sum of each Gaussian's largest log-scale.
    log_sizes: f64,
    cut_scales: u64,
    cut_colors: u64,
    cut_sh: u64,
    /// Means and base colours, by which compressed PLY forms its chunks.
    chunked: Option<Gaussians>,
}

impl PackingLoss {
    /// Returns `None` for formats that hold all values in single precision.
    pub(super) fn of(format: Format, spz_version: Option<u32>) -> Option<Self> {
        let any = [f32::NEG_INFINITY, f32::INFINITY];
        let (log_scales, dc, max_sh) = match (format, spz_version) {
            (Format::Spz, _) | (Format::Glb, Some(_)) => ([-10.0, 5.9375], [-0.5 / 0.15, 0.5 / 0.15], 1.0),
            (Format::CompressedPly, _) => ([-MAX_COMPRESSED_LOG_SCALE, MAX_COMPRESSED_LOG_SCALE], any, 4.0),
            // Without view dependence, colours below 0 are drawn as 0.
            (Format::Splat, _) => (any, [f32::NEG_INFINITY, rgb_to_sh_dc(1.0)], f32::INFINITY),
            _ => return None,
        };
        let chunked = (format == Format::CompressedPly).then(Gaussians::default);
        let (count, log_sizes, cut_scales, cut_colors, cut_sh) = (0, 0.0, 0, 0, 0);
        Some(Self { log_scales, dc, max_sh, count, log_sizes, cut_scales, cut_colors, cut_sh, chunked })
    }

    pub(super) fn add(&mut self, block: &Gaussians) {
        let [least, most] = self.log_scales;
        for (index, [x, y, z]) in block.log_scales.iter().enumerate() {
            let (smallest, largest) = (x.min(*y).min(*z), x.max(*y).max(*z));
            self.log_sizes += f64::from(largest.max(-100.0));
            let is_cut = largest > most || (smallest < least && largest < least + THIN);
            self.cut_scales += u64::from(is_cut);
            let (dc, higher) = block.sh_of(index).split_at(1);
            let [least, most] = self.dc;
            self.cut_colors += u64::from(dc[0].iter().any(|dc| !(least..=most).contains(dc)));
            self.cut_sh += u64::from(higher.as_flattened().iter().any(|sh| sh.abs() > self.max_sh));
        }
        if let Some(chunked) = &mut self.chunked {
            chunked.means.extend_from_slice(&block.means);
            chunked.sh.extend((0..block.len()).map(|index| block.sh_of(index)[0]));
        }
        self.count += block.len() as u64;
    }

    /// A warning, if the loss is visible.
    pub(super) fn line(&self, format: Format, outline: &Outline) -> Option<String> {
        let mut losses = Vec::new();
        let step = fractional_bits(outline).map_or(0.0, |bits| (-f64::from(bits)).exp2());
        let finest = (-f64::from(MAX_FRACTIONAL_BITS)).exp2();
        let typical = (self.log_sizes / self.count.max(1) as f64).exp();
        if matches!(format, Format::Spz | Format::Glb) && step > COARSE * typical {
            let reason = match step == finest {
                true => "the finest that SPZ has: scale the scene up".into(),
                false => {
                    let farthest = short(farthest(outline).into());
                    format!("because one lies at {farthest}: crop the scene for finer steps")
                }
            };
            losses.push(format!(
                "positions are rounded to steps of {} (a typical size is {}), {reason}",
                short(step),
                short(typical)
            ));
        }
        let step = self.chunked.as_ref().map_or(0.0, ply::typical_step);
        if step > COARSE * typical {
            losses.push(format!(
                "positions are rounded to steps of {} (a typical size is {}), because 256 Gaussians share a box and lie far apart",
                short(step),
                short(typical)
            ));
        }
        let count = self.count;
        if self.cut_scales > 0 {
            let [least, most] = self.log_scales.map(|scale| short(f64::from(scale).exp()));
            let cut = self.cut_scales;
            losses.push(format!(
                "sizes of {cut} of {count} Gaussians are beyond {least} to {most} and are cut"
            ));
        }
        if self.cut_colors as f64 > USUALLY_CUT * count as f64 {
            losses.push(format!("colours of {} of {count} Gaussians are cut", self.cut_colors));
        }
        if self.cut_sh as f64 > USUALLY_CUT * count as f64 {
            let (cut, most) = (self.cut_sh, self.max_sh);
            losses.push(format!(
                "SH coefficients above degree 0 of {cut} of {count} Gaussians are beyond -{most} to {most} and are cut"
            ));
        }
        (!losses.is_empty())
            .then(|| format!("{format} does not hold the scene exactly: {}", losses.join("; ")))
    }
}
