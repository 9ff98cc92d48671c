//! Writes PLY files, binary little endian.

use std::io::{self, Write};
use std::path::Path;

use glam::DVec3;

use super::file::{FILTER, Marks, ORIGIN, UNIT};
use crate::atomic;
use crate::regular_file::OnFile;
use crate::splats::{Outline, Produce, WriteOptions, in_blocks};
use ashsplat::scene::gaussians::sh_coefficients;
use ashsplat::scene::{Gaussians, PointCloud, WorldFrame};
use ashsplat::{Error, Result};

/// Writes Gaussians in the layout of the reference implementation; `filters`: the sizes of Mip-Splatting's 3D filter,
/// source units.
pub(crate) fn write_blocks(
    path: &Path,
    outline: &Outline,
    filters: Option<&[f32]>,
    produce: &mut Produce<'_>,
) -> Result<()> {
    let mut names = property_names(outline.sh_degree);
    names.extend(filters.map(|_| FILTER.to_owned()));
    let is_double = |name: &str| outline.double_positions && ["x", "y", "z"].contains(&name);
    // Positions in double precision need no origin.
    let doubles = outline.double_positions.then_some(outline.options.frame.origin);
    let origin = if outline.double_positions { DVec3::ZERO } else { outline.options.frame.origin };
    let frame = WorldFrame { origin, ..outline.options.frame };
    let header = Outline { options: WriteOptions { frame, ..outline.options }, ..*outline };
    atomic::write_seekable(path, |mut writer| {
        let scalars =
            names.iter().map(|name| (if is_double(name) { "double" } else { "float" }, name.as_str()));
        write_header(&mut writer, &header, scalars).writing(path)?;
        let (mut rows, mut filters) = (Vec::new(), filters.into_iter().flatten());
        produce(&mut |block| {
            rows.clear();
            for index in 0..block.len() {
                gaussian_row(&block, index, doubles, &mut rows);
                rows.extend(filters.next().into_iter().flat_map(|size| size.to_le_bytes()));
            }
            writer.write_all(&rows).writing(path)
        })
    })
}

/// Writes Gaussians with the sizes of Mip-Splatting's 3D filter as the property `filter_3D`, as Mip-Splatting does.
/// Reading makes the filter a part of scales and opacities.
pub fn write_filtered(
    path: impl AsRef<Path>,
    gaussians: &Gaussians,
    filters: &[f32],
    options: &WriteOptions,
) -> Result<()> {
    gaussians.check_shapes()?;
    if filters.len() != gaussians.len() {
        let problem = format!("are {}, there are {} Gaussians", filters.len(), gaussians.len());
        return Err(Error::argument("filters", problem));
    }
    let unit = options.frame.unit;
    let filters: Vec<f32> = filters.iter().map(|&size| (f64::from(size) * unit) as f32).collect();
    let outline = Outline::of(gaussians, options);
    write_blocks(path.as_ref(), &outline, Some(&filters), &mut |sink| in_blocks(gaussians, unit, sink))
}

/// Writes coloured points like the reference implementation's `input.ply`: `x y z nx ny nz` (float, normals 0) `red
/// green blue` (uchar). The points are in the world coordinates of `frame`; the file has source units from the frame's
/// origin, which its header names.
pub fn write_points(path: impl AsRef<Path>, points: &PointCloud, frame: &WorldFrame) -> Result<()> {
    let floats = ["x", "y", "z", "nx", "ny", "nz"].map(|name| ("float", name));
    let bytes = ["red", "green", "blue"].map(|name| ("uchar", name));
    let options = WriteOptions { frame: *frame, ..Default::default() };
    let outline = Outline { count: points.len() as u64, ..Outline::of(&Gaussians::default(), &options) };
    atomic::write(path, |writer| {
        write_header(&mut *writer, &outline, floats.into_iter().chain(bytes))?;
        for (position, color) in points.positions.iter().zip(&points.colors) {
            let position = position.map(|v| (frame.unit * f64::from(v)) as f32);
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
    outline: &Outline,
    properties: impl Iterator<Item = (&'a str, &'a str)>,
) -> io::Result<()> {
    write!(writer, "ply\nformat binary_little_endian 1.0\n")?;
    Marks::write(&mut writer, outline)?;
    write_frame(&mut writer, &outline.options.frame)?;
    writeln!(writer, "element vertex {}", outline.count)?;
    for (kind, name) in properties {
        writeln!(writer, "property {kind} {name}")?;
    }
    writeln!(writer, "end_header")
}

/// Writes the comments about the frame, unless it is the default.
pub(crate) fn write_frame(writer: &mut impl Write, frame: &WorldFrame) -> io::Result<()> {
    let DVec3 { x, y, z } = frame.origin;
    if frame.origin != DVec3::ZERO {
        writeln!(writer, "comment {ORIGIN} {x} {y} {z}")?;
    }
    if frame.unit != 1.0 {
        writeln!(writer, "comment {UNIT} {}", frame.unit)?;
    }
    Ok(())
}

fn property_names(sh_degree: u32) -> Vec<String> {
    let rest = 3 * (sh_coefficients(sh_degree) - 1);
    let fixed = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"];
    let last = ["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"];
    let rest = (0..rest).map(|i| format!("f_rest_{i}"));
    fixed.iter().map(|s| s.to_string()).chain(rest).chain(last.iter().map(|s| s.to_string())).collect()
}

/// `doubles` is the origin of positions that are written in double precision.
fn gaussian_row(gaussians: &Gaussians, index: usize, doubles: Option<DVec3>, row: &mut Vec<u8>) {
    let mean = gaussians.means[index];
    if let Some(origin) = doubles {
        let absolute = origin + DVec3::from_array(mean.map(f64::from));
        absolute.to_array().iter().for_each(|v| row.extend_from_slice(&v.to_le_bytes()));
    }
    let mut put = |value: f32| row.extend_from_slice(&value.to_le_bytes());
    let floats = if doubles.is_some() { &[][..] } else { &mean };
    floats.iter().chain(&[0.0; 3]).for_each(|&v| put(v));
    let sh = gaussians.sh_of(index);
    sh[0].iter().for_each(|&v| put(v));
    for channel in 0..3 {
        sh[1..].iter().for_each(|coefficient| put(coefficient[channel]));
    }
    put(gaussians.opacity_logits[index]);
    gaussians.log_scales[index].iter().for_each(|&v| put(v));
    gaussians.quats[index].iter().for_each(|&v| put(v));
}
