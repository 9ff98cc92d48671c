//! Merges parts of several files into one.

use std::path::Path;

use super::convert::around;
use super::{Format, Header, Outline, ReadOptions, Reader, WriteOptions, open, write_readable};
use ashsplat::scene::{Bounds, Gaussians, Similarity, WorldFrame};
use ashsplat::{Error, Result};
use glam::Vec3;

/// A file, and a box that selects its Gaussians.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Part<'a> {
    /// A file of any format.
    pub path: &'a Path,
    /// Box that the means must lie in, source units, relative to the first part's origin: see [`Bounds::contains`].
    pub within: Bounds,
}

/// Result of a merge.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Merged {
    /// The output's format.
    pub format: Format,
    /// Number of Gaussians from each part, in order.
    pub written: Vec<u64>,
    /// SH degree written.
    pub sh_degree: u32,
    /// Losses and oddities.
    pub warnings: Vec<String>,
}

/// Writes the Gaussians inside the parts' boxes into one file, part by part, in order. Each file is read twice, block
/// by block, so memory does not grow with the files, except for compressed PLY, which is sorted in memory. The parts,
/// not `options`, decide if the output is marked as trained with antialiasing.
///
/// # Errors
/// Same as [`super::read`] and [`super::write`]; [`Error::Input`] for a part whose SH degree or antialiasing differs
/// from the first part's; [`Error::Argument`] without parts.
pub fn merge(
    parts: &[Part<'_>],
    output: &Path,
    read: &ReadOptions,
    options: &WriteOptions,
) -> Result<Merged> {
    let format = match options.format {
        Some(format) => format,
        None => Format::of_extension(output)?,
    };
    let first = parts.first().ok_or_else(|| Error::argument("parts", "there are none to merge"))?;
    let of_first = open(first.path, read)?.header().clone();
    let sh_degree = of_first.sh_degree.min(format.max_sh_degree());
    let Header { antialiased, kernel_size, is_2dgs, .. } = of_first;
    let mut warnings = format.losses(of_first.sh_degree, (antialiased, kernel_size, is_2dgs));
    let (mut written, mut bounds) = (Vec::new(), None);
    for part in parts {
        let mut reader = open(part.path, read)?;
        let header = reader.header();
        let (own, there) = (described(header), described(&of_first));
        if own != there {
            let problem = format!("has {own}, {} has {there}", first.path.display());
            return Err(Error::input(part.path, problem, "train all parts with the same settings"));
        }
        warnings.extend(header.warnings.iter().cloned());
        let mut count = 0;
        let shift = shift(header, &of_first);
        inside(&mut reader, (shift, part.within), &mut |block| {
            count += block.len() as u64;
            bounds = around(bounds, block.bounds());
            Ok(())
        })?;
        written.push(count);
        let own = reader.warnings.drain(..);
        warnings.extend(own.map(|warning| format!("{}: {warning}", part.path.display())));
    }
    let count = written.iter().sum();
    let frame = WorldFrame { origin: of_first.origin, unit: of_first.unit.unwrap_or(1.0) };
    let double_positions = of_first.double_positions && format == Format::Ply;
    let outline =
        Outline { count, sh_degree, antialiased, kernel_size, is_2dgs, bounds, frame, double_positions };
    warnings.extend(format.origin_note(output, &outline));
    let loss = write_readable(output, (format, options.spz_version), &outline, &mut |sink| {
        for part in parts {
            let mut reader = open(part.path, read)?;
            let shift = shift(reader.header(), &of_first);
            inside(&mut reader, (shift, part.within), &mut |block| {
                sink(if sh_degree == block.sh_degree { block } else { block.with_sh_degree(sh_degree) })
            })?;
        }
        Ok(())
    })?;
    warnings.extend(loss);
    Ok(Merged { format, written, sh_degree, warnings })
}

/// The properties that all parts must share, in words.
fn described(header: &Header) -> String {
    format!("SH degree {}, {}", header.sh_degree, header.marks_in_words())
}

/// Makes a part's positions relative to the first one's origin.
fn shift(part: &Header, first: &Header) -> Similarity {
    Similarity { translation: part.origin - first.origin, ..Default::default() }
}

/// Passes the Gaussians in a box to the sink, after a shift.
fn inside(
    reader: &mut Reader<'_>,
    (shift, within): (Similarity, Bounds),
    sink: &mut dyn FnMut(Gaussians) -> Result<()>,
) -> Result<()> {
    let read = reader.blocks(&mut |mut block| {
        block.transform(&shift);
        block.retain(|all, index| within.contains(Vec3::from_array(all.means[index])));
        sink(block)
    });
    read.map(drop)
}
