//! Finds Gaussians with unusable or implausible parameters, and those that a format with packed attributes changes.

use std::path::Path;

use glam::DVec3;

use super::sog;
use super::spz::{MAX_FRACTIONAL_BITS, farthest, fractional_bits};
use super::{FARTHEST, Format, MAX_COMPRESSED_LOG_SCALE, Outline};
use crate::ply;
use ashsplat::kernels::constants::QUAT_NORM_MIN;
use ashsplat::scene::Gaussians;
use ashsplat::scene::sh::rgb_to_sh_dc;
use ashsplat::{Error, Result};

/// Largest usable coordinate of positions and quaternions: the square of a larger one overflows.
const MAX_COORDINATE: f32 = 1e18;
/// Largest usable SH coefficient: with it, no sum over terms, splats or their derivatives overflows.
const MAX_SH: f32 = 1e32;
/// Largest usable log-scale: the exponential of a larger one overflows.
const MAX_LOG_SCALE: f32 = 88.0;

/// Counts the unusable Gaussians of a file, which it removes from the stream, and those with implausible values.
#[derive(Default)]
pub(super) struct Validation {
    seen: u64,
    pub(super) unusable: u64,
    /// Row, parameter and value of the first one.
    first: Option<(u64, String, f32)>,
    without_rotation: u64,
    coarse: u64,
    /// Logarithmic sums over the Gaussians with coarse positions.
    log_steps: f64,
    log_sizes: f64,
}

impl Validation {
    /// Removes the unusable Gaussians of the next block, and counts implausible values of the others. A size of 0
    /// (log-scale -∞) becomes the smallest normal number, a quaternion of zeros the identity, which can be rotated.
    pub(super) fn look_through(&mut self, block: &mut Gaussians) {
        let rows = block.len();
        for log_scale in block.log_scales.as_flattened_mut() {
            if *log_scale == f32::NEG_INFINITY {
                *log_scale = f32::MIN_POSITIVE.ln();
            }
        }
        if (0..rows).any(|index| parameter(block, index).is_some()) {
            for index in 0..rows {
                if let Some((name, value)) = parameter(block, index) {
                    self.unusable += 1;
                    self.first.get_or_insert((self.seen + index as u64, name, value));
                }
            }
            block.retain(|all, index| parameter(all, index).is_none());
        }
        self.seen += rows as u64;
        for quat in &mut block.quats {
            if quat.iter().map(|q| q * q).sum::<f32>().sqrt() <= QUAT_NORM_MIN {
                *quat = [1.0, 0.0, 0.0, 0.0];
                self.without_rotation += 1;
            }
        }
        for (mean, [x, y, z]) in block.means.iter().zip(&block.log_scales) {
            let farthest = mean.iter().fold(0.0_f32, |most, v| most.max(v.abs()));
            // The next lower power of two has the same steps.
            let power = f32::from_bits(farthest.to_bits() & f32::INFINITY.to_bits());
            let step = f64::from(power) * f64::from(f32::EPSILON);
            let log_size = x.max(*y).max(*z);
            // A size of 0 cannot be compared with.
            if log_size > f32::MIN_POSITIVE.ln() && step > COARSE * f64::from(log_size).exp() {
                self.coarse += 1;
                self.log_steps += step.ln();
                self.log_sizes += f64::from(log_size);
            }
        }
    }

    /// Describes the unusable Gaussians in one line; `None` if all are usable.
    pub(super) fn describe_unusable(&self, all: u64, row_name: &str) -> Option<String> {
        let (row, name, value) = self.first.as_ref()?;
        let kind = if value.is_finite() { "too large" } else { "not finite" };
        let bad = self.unusable;
        let have = if bad == 1 { "Gaussian has" } else { "Gaussians have" };
        Some(format!(
            "{bad} of {all} {have} unusable parameters; the first, {row_name} {row}: {name} = {value} is {kind}"
        ))
    }

    /// One warning per kind of implausible value.
    pub(super) fn lines(&self) -> Vec<String> {
        let (count, mut lines) = (self.seen - self.unusable, Vec::new());
        if self.without_rotation > 0 {
            let some = self.without_rotation;
            lines.push(format!(
                "{some} of {count} Gaussians have a quaternion of zeros and are used without rotation"
            ));
        }
        if 2 * self.coarse > count {
            let [step, size] =
                [self.log_steps, self.log_sizes].map(|sum| short((sum / self.coarse as f64).exp()));
            lines.push(format!(
                "positions are rounded to steps of about {step} (a typical size is {size}), because the scene lies far from its origin: \
                 export doubles, or move it there before it is saved"
            ));
        }
        lines
    }
}

/// Refuses to write Gaussians that reading would refuse.
pub(super) fn check_readable(path: &Path, block: &Gaussians) -> Result<()> {
    match (0..block.len()).find_map(|index| parameter(block, index)) {
        None => Ok(()),
        Some((name, value)) => {
            let kind = if value.is_finite() { "too large" } else { "not finite" };
            let problem = format!("is not written: a Gaussian would have {name} = {value}, which is {kind}");
            Err(Error::input(path, problem, "scale, move or merge less"))
        }
    }
}

/// Same as [`check_readable`], for the origin of the positions.
pub(super) fn check_origin(path: &Path, origin: DVec3) -> Result<()> {
    let farthest = origin.abs().max_element();
    if farthest <= FARTHEST {
        return Ok(());
    }
    let problem =
        format!("is not written: its positions would lie {farthest:e} from zero, more than {FARTHEST:e}");
    Err(Error::input(path, problem, "scale or move less"))
}

/// The first unusable parameter of a Gaussian: its name in a PLY, and its value.
fn parameter(block: &Gaussians, index: usize) -> Option<(String, f32)> {
    let bad_coordinate = |v: &f32| !v.is_finite() || v.abs() > MAX_COORDINATE;
    let bad_scale = |v: &f32| !v.is_finite() || *v > MAX_LOG_SCALE;
    let bad_sh = |v: &f32| !v.is_finite() || v.abs() > MAX_SH;
    let find = |values: &[f32], bad: &dyn Fn(&f32) -> bool, name: &dyn Fn(usize) -> String| {
        let at = values.iter().position(bad)?;
        Some((name(at), values[at]))
    };
    let opacity = block.opacity_logits[index];
    let (dc, rest) = block.sh_of(index).split_at(1);
    // PLY has the coefficients of red, then green, then blue.
    let place = |at: usize| at % 3 * rest.len() + at / 3;
    find(&block.means[index], &bad_coordinate, &|axis| ["x", "y", "z"][axis].into())
        .or_else(|| opacity.is_nan().then(|| ("opacity".into(), opacity)))
        .or_else(|| find(&block.log_scales[index], &bad_scale, &|axis| format!("scale_{axis}")))
        .or_else(|| find(&block.quats[index], &bad_coordinate, &|at| format!("rot_{at}")))
        .or_else(|| find(dc.as_flattened(), &bad_sh, &|at| format!("f_dc_{at}")))
        .or_else(|| find(rest.as_flattened(), &bad_sh, &|at| format!("f_rest_{}", place(at))))
}

/// Share of a typical Gaussian's size at which steps of positions are coarse: pictures lose about 6 dB.
pub(super) const COARSE: f64 = 0.2;

/// A positive number with two significant digits, or with all digits before the decimal point.
pub(super) fn short(value: f64) -> String {
    let digits = (1.0 - value.log10().floor()).clamp(0.0, 40.0) as usize;
    format!("{value:.digits$}")
}

/// Logarithm of the ratio at which a Gaussian's longest axis hides that its thinnest one is cut.
const THIN: f32 = 3.0;
/// Share of the Gaussians with cut colours or SH coefficients in ordinary scenes.
const USUALLY_CUT: f64 = 0.02;

/// Statistics of a scene's Gaussians against the limits of a format.
#[derive(Default)]
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
    /// Sum of the logarithms of 1 + each Gaussian's largest coordinate.
    log_reach: f64,
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
            (Format::Sog, _) => (any, any, f32::INFINITY),
            _ => return None,
        };
        let chunked = (format == Format::CompressedPly).then(Gaussians::default);
        Some(Self { log_scales, dc, max_sh, chunked, ..Self::default() })
    }

    pub(super) fn add(&mut self, block: &Gaussians) {
        let [least, most] = self.log_scales;
        for (index, [x, y, z]) in block.log_scales.iter().enumerate() {
            let (smallest, largest) = (x.min(*y).min(*z), x.max(*y).max(*z));
            self.log_sizes += f64::from(largest.max(-100.0));
            let [x, y, z] = block.means[index].map(|v| f64::from(v).abs());
            self.log_reach += x.max(y).max(z).ln_1p();
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

    /// Warning about what the format loses, if it is visible.
    pub(super) fn line(&self, format: Format, outline: &Outline) -> Option<String> {
        let mut losses = Vec::new();
        let step = fractional_bits(outline).map_or(0.0, |bits| (-f64::from(bits)).exp2());
        let finest = (-f64::from(MAX_FRACTIONAL_BITS)).exp2();
        let typical = (self.log_sizes / self.count.max(1) as f64).exp();
        let mut coarse = |step: f64, reason: &str| {
            if step > COARSE * typical {
                let [step, size] = [step, typical].map(short);
                let line =
                    format!("positions are rounded to steps of {step} (a typical size is {size}), {reason}");
                losses.push(line);
            }
        };
        if matches!(format, Format::Spz | Format::Glb) {
            let farthest = short(farthest(outline).into());
            let crop = format!("because one lies at {farthest}: crop the scene for finer steps");
            let finest_of_spz = "the finest that SPZ has: scale the scene up";
            coarse(step, if step == finest { finest_of_spz } else { &crop });
        }
        if let (Format::Sog, Some(bounds)) = (format, outline.bounds) {
            // Positions are stored as logarithms, so that steps grow with the distance.
            let reach = (self.log_reach / self.count.max(1) as f64).exp();
            coarse(
                reach * sog::log_step(bounds),
                "because the scene is large: crop it, or move its middle to 0",
            );
        }
        let step = self.chunked.as_ref().map_or(0.0, ply::typical_step);
        coarse(step, "because 256 Gaussians share a box and lie far apart");
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
        let losses = Some(losses.join("; ")).filter(|losses| !losses.is_empty())?;
        Some(format!("{format} does not hold the scene exactly: {losses}"))
    }
}
