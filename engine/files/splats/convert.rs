//! From one file of Gaussians to another, block by block.

use std::path::Path;

use super::{Format, Header, Outline, ReadOptions, open, row_bytes, write_blocks};
use crate::decimate::decimate;
use crate::host_memory;
use ashsplat::Result;
use ashsplat::scene::{Bounds, Cut, Gaussians, Similarity};

/// What is changed on the way, in this order: the SH degree, what is cut, place, number.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ConvertOptions {
    /// How the input is read.
    pub read: ReadOptions,
    /// The highest SH degree that is kept; none: all that the output can hold.
    pub sh_degree: Option<u32>,
    /// Which Gaussians are dropped; in the input's frame.
    pub cut: Cut,
    /// How everything is moved.
    pub similarity: Similarity,
    /// How many Gaussians are to be left, at most; the others are merged into them.
    pub decimate: Option<Target>,
    /// The output's format; none: that of its extension.
    pub format: Option<Format>,
    /// As [`super::WriteOptions::spz_version`].
    pub spz_version: Option<u32>,
}

/// How many Gaussians are to be left.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Target {
    /// So many.
    Count(u64),
    /// This share of those that are left otherwise, 0 to 1.
    Share(f64),
}

/// What a conversion did.
#[derive(Clone, Debug, PartialEq)]
pub struct Converted {
    /// What the input said of itself.
    pub input: Header,
    /// The output's format.
    pub format: Format,
    /// Number of Gaussians written.
    pub written: u64,
    /// SH degree written.
    pub sh_degree: u32,
    /// What was lost or odd.
    pub warnings: Vec<String>,
}

/// Reads a file of Gaussians, changes them, and writes them in another format.
///
/// The input is read twice where the output's beginning depends on its end (number and box of the Gaussians).
///
/// # Errors
/// As [`super::read`] and [`super::write`].
pub fn convert(input: &Path, output: &Path, options: &ConvertOptions) -> Result<Converted> {
    let format = match options.format {
        Some(format) => format,
        None => Format::of_extension(output)?,
    };
    options.cut.check()?;
    let mut reader = open(input, &options.read)?;
    let header = reader.header().clone();
    let sh_degree = header.sh_degree.min(format.max_sh_degree()).min(options.sh_degree.unwrap_or(3));
    let mut warnings = header.warnings.clone();
    let wanted_degree = header.sh_degree.min(options.sh_degree.unwrap_or(3));
    warnings.extend(format.losses(wanted_degree, header.antialiased));
    let (mut count, mut bounds) = (0, None);
    if options.decimate.is_some() {
        // All of them, and those that are merged of them.
        let needed = header.count.saturating_mul(2 * row_bytes(sh_degree));
        host_memory::check(input, needed, options.read.max_host_memory)?;
    }
    let mut kept = options.decimate.map(|_| Gaussians { sh_degree, ..Default::default() });
    reader.blocks(&mut |block| {
        let block = options.change(block, sh_degree);
        count += block.len() as u64;
        bounds = around(bounds, block.bounds());
        if let Some(kept) = &mut kept {
            kept.append(&block);
        }
        Ok(())
    })?;
    warnings.extend(reader.warning.take());
    if let (Some(all), Some(target)) = (&mut kept, options.decimate) {
        let target = match target {
            Target::Count(target) => target,
            Target::Share(share) => (share * count as f64).round() as u64,
        };
        decimate(all, usize::try_from(target).unwrap_or(usize::MAX));
        (count, bounds) = (all.len() as u64, all.bounds());
    }
    if count == 0 {
        warnings.push("no Gaussians are left".into());
    }
    let outline = Outline { count, sh_degree, antialiased: header.antialiased, bounds };
    write_blocks(output, (format, options.spz_version), &outline, &mut |sink| match kept.take() {
        Some(all) => sink(all),
        None => open(input, &options.read)?
            .blocks(&mut |block| sink(options.change(block, sh_degree)))
            .map(|_| ()),
    })?;
    Ok(Converted { input: header, format, written: count, sh_degree, warnings })
}

impl ConvertOptions {
    /// All but the decimation.
    pub(super) fn change(&self, mut block: Gaussians, sh_degree: u32) -> Gaussians {
        if sh_degree != block.sh_degree {
            block = block.with_sh_degree(sh_degree);
        }
        if self.cut != Cut::default() {
            let limits = self.cut.limits();
            block.retain(|all, index| limits.keeps(all, index));
        }
        block.transform(&self.similarity);
        block
    }
}

/// The box around two.
pub(super) fn around(a: Option<Bounds>, b: Option<Bounds>) -> Option<Bounds> {
    match (a, b) {
        (Some(a), Some(b)) => Some(Bounds { min: a.min.min(b.min), max: a.max.max(b.max) }),
        (one, other) => one.or(other),
    }
}
