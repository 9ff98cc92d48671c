//! Writing PLY files, binary little endian.

use std::io::{self, Write};
use std::path::Path;

use super::header::{ANTIALIASED, FILTER};
use crate::atomic;
use crate::splats::{Outline, Produce, in_blocks};
use ashsplat::scene::gaussians::sh_coefficients;
use ashsplat::scene::{Gaussians, PointCloud};
use ashsplat::{Error, Result};

/// Writes Gaussians in the layout of the reference implementation, at the SH degree that they have.
///
/// Values are stored as they are, so that reading gives the same bits.
///
/// # Errors
/// [`ashsplat::Error::Argument`] when the vectors do not fit together, [`ashsplat::Error::Io`] naming the file when it
/// cannot be written; no partial file is left.
pub fn write(path: impl AsRef<Path>, gaussians: &Gaussians) -> Result<()> {
    gaussians.check_shapes()?;
    let outline = Outline::of(gaussians, false);
    write_blocks(path.as_ref(), &outline, &mut |sink| in_blocks(gaussians, sink))
}

/// Writes Gaussians as they come.
pub(crate) fn write_blocks(path: &Path, outline: &Outline, produce: &mut Produce<'_>) -> Result<()> {
    let names = property_names(outline.sh_degree);
    let io = |source| Error::io(path, "write", source);
    atomic::write_seekable(path, |mut writer| {
        let floats = names.iter().map(|name| ("float", name.as_str()));
        write_header(&mut writer, outline.count, outline.antialiased, floats).map_err(io)?;
        let mut rows = Vec::new();
        produce(&mut |block| {
            rows.clear();
            (0..block.len()).for_each(|index| gaussian_row(&block, index, &mut rows));
            writer.write_all(&rows).map_err(io)
        })
    })
}

/// Writes Gaussians with the sizes of Mip-Splatting's 3D filter as the property `filter_3D`, as its own trainer does.
/// Reading makes the filter a part of scales and opacities.
///
/// # Errors
/// As [`write()`]; [`ashsplat::Error::Argument`] for another number of sizes.
pub fn write_filtered(
    path: impl AsRef<Path>,
    gaussians: &Gaussians,
    filters: &[f32],
    antialiased: bool,
) -> Result<()> {
    gaussians.check_shapes()?;
    if filters.len() != gaussians.len() {
        let problem = format!("are {}, there are {} Gaussians", filters.len(), gaussians.len());
        return Err(Error::argument("filters", problem));
    }
    let mut names = property_names(gaussians.sh_degree);
    names.push(FILTER.to_owned());
    atomic::write(path.as_ref(), |writer| {
        let floats = names.iter().map(|name| ("float", name.as_str()));
        write_header(&mut *writer, gaussians.len() as u64, antialiased, floats)?;
        let mut row = Vec::new();
        for (index, size) in filters.iter().enumerate() {
            row.clear();
            gaussian_row(gaussians, index, &mut row);
            row.extend_from_slice(&size.to_le_bytes());
            writer.write_all(&row)?;
        }
        Ok(())
    })
}

/// Writes coloured points as the reference implementation's `input.ply`: `x y z nx ny nz` (float, normals 0)
/// `red green blue` (uchar).
///
/// # Errors
/// [`ashsplat::Error::Io`] naming the file when it cannot be written; no partial file is left.
pub fn write_points(path: impl AsRef<Path>, points: &PointCloud) -> Result<()> {
    let floats = ["x", "y", "z", "nx", "ny", "nz"].map(|name| ("float", name));
    let bytes = ["red", "green", "blue"].map(|name| ("uchar", name));
    atomic::write(path, |writer| {
        write_header(&mut *writer, points.len() as u64, false, floats.into_iter().chain(bytes))?;
        for (position, color) in points.positions.iter().zip(&points.colors) {
            for value in position.iter().chain(&[0.0; 3]) {
                writer.write_all(&value.to_le_bytes())?;
            }
            writer.write_all(color)?;
        }
        Ok(())
    })
}

fn write_header<'a>(
    mut writer: impl Write,
    count: u64,
    antialiased: bool,
    properties: impl Iterator<Item = (&'a str, &'a str)>,
) -> io::Result<()> {
    write!(writer, "ply\nformat binary_little_endian 1.0\n")?;
    if antialiased {
        writeln!(writer, "comment {ANTIALIASED}")?;
    }
    writeln!(writer, "element vertex {count}")?;
    for (kind, name) in properties {
        writeln!(writer, "property {kind} {name}")?;
    }
    writeln!(writer, "end_header")
}

fn property_names(sh_degree: u32) -> Vec<String> {
    let rest = 3 * (sh_coefficients(sh_degree) - 1);
    let fixed = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"];
    let last = ["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"];
    let rest = (0..rest).map(|i| format!("f_rest_{i}"));
    fixed.iter().map(|s| s.to_string()).chain(rest).chain(last.iter().map(|s| s.to_string())).collect()
}

fn gaussian_row(gaussians: &Gaussians, index: usize, row: &mut Vec<u8>) {
    let mut put = |value: f32| row.extend_from_slice(&value.to_le_bytes());
    gaussians.means[index].iter().chain(&[0.0; 3]).for_each(|&v| put(v));
    let sh = gaussians.sh_of(index);
    sh[0].iter().for_each(|&v| put(v));
    for channel in 0..3 {
        sh[1..].iter().for_each(|coefficient| put(coefficient[channel]));
    }
    put(gaussians.opacity_logits[index]);
    gaussians.log_scales[index].iter().for_each(|&v| put(v));
    gaussians.quats[index].iter().for_each(|&v| put(v));
}
