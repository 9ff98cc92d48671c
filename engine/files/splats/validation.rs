//! Finds Gaussians with unusable parameters.

use std::path::Path;

use super::FARTHEST;
use ashsplat::scene::Gaussians;
use ashsplat::{Error, Result};
use glam::DVec3;

/// Largest usable coordinate of positions and quaternions: the square of a larger one overflows.
const MAX_COORDINATE: f32 = 1e18;

/// Largest usable SH coefficient: with it, no sum over terms, splats or their derivatives overflows.
const MAX_SH: f32 = 1e32;

/// Largest usable log-scale: the exponential of a larger one overflows.
const MAX_LOG_SCALE: f32 = 88.0;

/// Removes unusable Gaussians from the stream, and counts them.
#[derive(Default)]
pub(super) struct Unusable {
    seen: u64,
    count: u64,
    /// Row, parameter and value of the first one.
    first: Option<(u64, String, f32)>,
}

impl Unusable {
    /// Number of unusable Gaussians so far.
    pub(super) fn count(&self) -> u64 {
        self.count
    }

    /// Removes the unusable Gaussians from the next block. A size of 0 (log-scale -∞) becomes the smallest normal
    /// number.
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
                    self.count += 1;
                    self.first.get_or_insert_with(|| (self.seen + index as u64, name(), value));
                }
            }
            block.retain(|all, index| parameter(all, index).is_none());
        }
        self.seen += rows as u64;
    }

    /// Describes the unusable Gaussians in one line; `None` if all are usable.
    pub(super) fn describe(&self, all: u64, row_name: &str) -> Option<String> {
        let (row, name, value) = self.first.as_ref()?;
        let kind = if value.is_finite() { "too large" } else { "not finite" };
        let bad = self.count;
        let have = if bad == 1 { "Gaussian has" } else { "Gaussians have" };
        Some(format!(
            "{bad} of {all} {have} unusable parameters; the first, {row_name} {row}: {name} = {value} is {kind}"
        ))
    }
}

/// Refuses to write Gaussians that reading would refuse.
pub(super) fn check_readable(path: &Path, block: &Gaussians) -> Result<()> {
    match (0..block.len()).find_map(|index| parameter(block, index)) {
        None => Ok(()),
        Some((name, value)) => {
            let kind = if value.is_finite() { "too large" } else { "not finite" };
            let problem =
                format!("is not written: a Gaussian would have {} = {value}, which is {kind}", name());
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
fn parameter(block: &Gaussians, index: usize) -> Option<(Box<dyn Fn() -> String>, f32)> {
    type Name = Box<dyn Fn() -> String>;
    let bad_coordinate = |v: f32| !v.is_finite() || v.abs() > MAX_COORDINATE;
    let bad_scale = |v: f32| !v.is_finite() || v > MAX_LOG_SCALE;
    let bad_sh = |v: f32| !v.is_finite() || v.abs() > MAX_SH;
    let find = |values: &[f32], bad: &dyn Fn(f32) -> bool, prefix: &'static str| {
        let at = values.iter().position(|&v| bad(v))?;
        Some((Box::new(move || format!("{prefix}{at}")) as Name, values[at]))
    };
    let mean = &block.means[index];
    if let Some(axis) = mean.iter().position(|&v| bad_coordinate(v)) {
        return Some((Box::new(move || ["x", "y", "z"][axis].to_owned()), mean[axis]));
    }
    let opacity = block.opacity_logits[index];
    if opacity.is_nan() {
        return Some((Box::new(|| "opacity".to_owned()), opacity));
    }
    find(&block.log_scales[index], &bad_scale, "scale_")
        .or_else(|| find(&block.quats[index], &bad_coordinate, "rot_"))
        .or_else(|| find(&block.sh_of(index)[0], &bad_sh, "f_dc_"))
        .or_else(|| {
            let rest = &block.sh_of(index)[1..];
            let (k, channel) =
                rest.iter().enumerate().find_map(|(k, sh)| Some((k, sh.iter().position(|&v| bad_sh(v))?)))?;
            let (place, value) = (channel * rest.len() + k, rest[k][channel]);
            Some((Box::new(move || format!("f_rest_{place}")) as Name, value))
        })
}
