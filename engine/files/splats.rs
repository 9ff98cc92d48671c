//! Gaussians in common file formats: PLY, compressed PLY, `.splat`, SPZ, glTF, SOG, USDA, `.ksplat`.
//!
//! All are converted to and from the frame and the raw parameters of the reference implementation's PLY.
//! Reading and writing proceed block by block, so that a conversion needs little memory if the formats allow
//! it. Compressed PLY and SOG are sorted, so they are written from memory.
//!
//! A format is a file here: `open` returns the header and what produces the Gaussians ([`Opened`]), `write` takes an
//! [`Outline`] and what produces them.

mod codebook;
mod convert;
mod dot_splat;
mod format;
mod gltf;
mod gltf_write;
mod ksplat;
mod sog;
mod spz;
mod stream;
mod usda;
mod validation;

use std::path::Path;

use super::ply;
use ashsplat::scene::Gaussians;
use ashsplat::{Error, Result};
use validation::PackingLoss;

pub(super) use convert::OriginSample;
pub use convert::{ConvertOptions, Converted, Input, Target, convert, join, place};
pub(crate) use format::{FARTHEST, MAX_COMPRESSED_LOG_SCALE};
pub use format::{Format, foreign, is_sog};
pub(crate) use gltf::{EXTENSION, PACKED_EXTENSION, mirrored};
pub(super) use gltf_write::glb_head;
pub(super) use stream::{BLOCK, Blocks, Opened, Outline, Produce, Reader, Sink, in_blocks, is_kernel_size};
pub use stream::{Header, ReadOptions, Scene, WriteOptions, row_bytes};

/// Reads a file of Gaussians. Its first bytes or its extension select the format.
///
/// A PLY may have any property order, encoding and scalar type. Additional properties and elements are ignored, except
/// `filter_3D`: Mip-Splatting's 3D filter becomes a part of scales and opacities. The number of `f_rest` properties
/// gives the SH degree. Colours may be `red green blue` in place of `f_dc`. Without `scale_2` (2DGS) the Gaussians have
/// no thickness.
///
/// A parameter is unusable if it is not finite, except an opacity logit of ±∞ (opacity 1 or 0), if a coordinate (also of
/// a quaternion) exceeds 1e18 or a log-scale 88 (both overflow in the projection), or if an SH coefficient exceeds 1e32.
///
/// # Errors
/// [`ashsplat::Error::Input`] for unusable parameters too, without [`ReadOptions::drop_invalid`].
pub fn read(path: impl AsRef<Path>, options: &ReadOptions) -> Result<Scene> {
    open(path.as_ref(), options)?.collect()
}

/// Reads the properties of a file without its Gaussians.
pub fn header(path: impl AsRef<Path>, options: &ReadOptions) -> Result<Header> {
    Ok(open(path.as_ref(), options)?.header)
}

/// Writes Gaussians in the format of the path's extension, or in a given one. Returns a warning about visible losses of
/// the format: steps of positions, sizes, colours.
pub fn write(
    path: impl AsRef<Path>,
    gaussians: &Gaussians,
    options: &WriteOptions,
) -> Result<Option<String>> {
    write_with(write_blocks, path.as_ref(), gaussians, options)
}

/// Same as [`write()`], but refuses Gaussians that could not be read again, since they were changed after reading. The file has the
/// bytes of a [`convert()`] that makes the same changes.
pub fn write_changed(
    path: impl AsRef<Path>,
    gaussians: &Gaussians,
    options: &WriteOptions,
) -> Result<Option<String>> {
    write_with(write_readable, path.as_ref(), gaussians, options)
}

/// Writes the blocks of a scene in a format. Returns a warning about the format's losses.
type WriteBlocks = fn(&Path, Format, &Outline, &mut Produce<'_>) -> Result<Option<String>>;

fn write_with(
    write: WriteBlocks,
    path: &Path,
    gaussians: &Gaussians,
    options: &WriteOptions,
) -> Result<Option<String>> {
    gaussians.check_shapes()?;
    let format = Format::chosen(options.format, path)?;
    let outline = Outline::of(gaussians, options);
    write(path, format, &outline, &mut |sink| in_blocks(gaussians, options.frame.unit, sink))
}

/// Names what Gaussians lose in a format, one line each.
pub fn losses(format: Format, gaussians: &Gaussians, options: &WriteOptions) -> Result<Vec<String>> {
    gaussians.check_shapes()?;
    let marks = (options.antialiased, options.kernel_size, options.is_2dgs);
    let mut losses = format.losses(gaussians.sh_degree, marks);
    if let Some(mut loss) = PackingLoss::of(format, options.spz_version) {
        in_blocks(gaussians, options.frame.unit, &mut |block| {
            loss.add(&block);
            Ok(())
        })?;
        losses.extend(loss.line(format, &Outline::of(gaussians, options)));
    }
    Ok(losses)
}

/// Checks that a format has this version of SPZ: [`WriteOptions::spz_version`].
pub fn check_spz_version(format: Format, version: Option<u32>) -> Result<()> {
    match (format, version) {
        (_, None) | (Format::Spz, Some(2..=4)) | (Format::Glb, Some(2)) => Ok(()),
        (_, Some(version)) => {
            let problem = format!("{format} has no version {version}: SPZ has 2, 3 and 4, GLB has 2");
            Err(Error::argument("spz_version", problem))
        }
    }
}

/// Same as [`write_blocks`], but refuses Gaussians that could not be read again, since they were changed after reading.
fn write_readable(
    path: &Path,
    format: Format,
    outline: &Outline,
    produce: &mut Produce<'_>,
) -> Result<Option<String>> {
    validation::check_origin(path, outline.options.frame.origin)?;
    write_blocks(path, format, outline, &mut |sink| {
        produce(&mut |block| {
            validation::check_readable(path, &block)?;
            sink(block)
        })
    })
}

/// Writes a file of any format. Returns a warning about the format's losses.
fn write_blocks(
    path: &Path,
    format: Format,
    outline: &Outline,
    produce: &mut Produce<'_>,
) -> Result<Option<String>> {
    let spz_version = outline.options.spz_version;
    check_spz_version(format, spz_version)?;
    let mut loss = PackingLoss::of(format, spz_version);
    let produce: &mut Produce<'_> = &mut |sink| {
        produce(&mut |block| {
            loss.iter_mut().for_each(|loss| loss.add(&block));
            sink(block)
        })
    };
    let written = match format {
        Format::Glb if spz_version == Some(2) => gltf_write::write_packed(path, outline, produce),
        Format::Ply => ply::write_blocks(path, outline, None, produce),
        Format::CompressedPly => ply::write_compressed_blocks(path, outline, produce),
        Format::Splat => dot_splat::write(path, outline, produce),
        Format::Spz => spz::write(path, outline, produce),
        Format::Glb | Format::Gltf => gltf_write::write(path, format, outline, produce),
        Format::Sog => sog::write(path, outline, produce),
        Format::Usda => usda::write(path, outline, produce),
        // It has no writer, so this returns its error.
        Format::Ksplat => Format::chosen(Some(format), path).map(drop),
    };
    match written {
        Ok(()) if format.has_origin_file() => format::write_origin(path, outline.options.frame.origin),
        written => written,
    }?;
    Ok(loss.and_then(|loss| loss.line(format, outline)))
}

pub(crate) fn open<'a>(path: &'a Path, options: &ReadOptions) -> Result<Reader<'a>> {
    let is_folder = path.is_dir() && is_sog(path);
    let file = if is_folder { path.join(format::META) } else { path.to_owned() };
    let format = if is_folder { Format::Sog } else { Format::of_file(path)? };
    let (mut header, produce) = match format {
        Format::Ply => ply::open(path)?,
        Format::CompressedPly => ply::open_compressed(path)?,
        Format::Splat => dot_splat::open(path)?,
        Format::Spz => spz::open(path)?,
        Format::Glb | Format::Gltf => gltf::open(path, format, options)?,
        Format::Sog => sog::open(&file, options)?,
        Format::Usda => usda::open(path, options)?,
        Format::Ksplat => ksplat::open(path)?,
    };
    if format.has_origin_file() {
        header.origin = format::read_origin(&file)?;
    }
    Ok(Reader { path, header, produce, options: *options, warnings: Vec::new() })
}
