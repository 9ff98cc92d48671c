//! Parts of several files as one.

use std::path::Path;

use super::convert::around;
use super::{Format, Header, Outline, ReadOptions, Reader, WriteOptions, open, write_readable};
use ashsplat::scene::{Bounds, Gaussians, Similarity, WorldFrame};
use ashsplat::{Error, Result};
use glam::Vec3;

/// A file, and which of its Gaussians are taken.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Part<'a> {
    /// A file of any format.
    pub path: &'a Path,
    /// Those with means in this box, source units, relative to the first part's origin: see [`Bounds::contains`].
    pub within: Bounds,
}

/// What was merged.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Merged {
    /// The output's format.
    pub format: Format,
    /// How many Gaussians each part has given, in their order.
    pub written: Vec<u64>,
    /// SH degree written.
    pub sh_degree: u32,
    /// What was lost or odd.
    pub warnings: Vec<String>,
}

/// Writes what the parts have in their boxes into one file, part by part, in their order. Each file is read twice, block by
/// block: the memory needed depends neither on their sizes nor on their number, but for compressed PLY, which is sorted.
/// Whether the Gaussians were trained with antialiasing is what the parts say; `options` has no part in it.
///
/// # Errors
/// Same as [`super::read`] and [`super::write`]; [`Error::Input`] for a part of another SH degree than the first or that does not want
/// antialiasing as the first does; [`Error::Argument`] without parts.
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

/// The properties that all parts must share.
fn described(header: &Header) -> String {
    format!("SH degree {}, {}", header.sh_degree, header.marks_in_words())
}

/// Makes a part's positions relative to the first one's origin.
fn shift(part: &Header, first: &Header) -> Similarity {
    Similarity { translation: part.origin - first.origin, ..Default::default() }
}

/// Passes on what lies in a box, after a shift.
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
