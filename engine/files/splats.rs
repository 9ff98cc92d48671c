//! Gaussians in the formats that people exchange: PLY, compressed PLY, `.splat`, SPZ, glTF.
//!
//! All are read into, and written from, the frame and the raw parameters of the reference implementation's PLY.
//! Reading and writing go block by block, so that a conversion needs little memory where the formats allow it:
//! compressed PLY is sorted, and so written from memory; SPZ lies packed in memory, at a quarter of its size or less.

mod convert;
mod dot_splat;
mod format;
mod gltf;
mod gltf_write;
mod spz;
mod spz_pack;
mod spz_write;
mod validation;

use std::path::{Path, PathBuf};

use super::ply;
use ashsplat::scene::gaussians::sh_coefficients;
use ashsplat::scene::{Bounds, Gaussians};
use ashsplat::{Error, Result};

pub use convert::{ConvertOptions, Converted, Target, convert};
pub use format::Format;
use validation::Unusable;

/// Gaussians that are handled at once, at most.
pub(super) const BLOCK: usize = 16_384;

/// Takes Gaussians block by block; all blocks have the same SH degree.
pub(super) type Sink<'a> = dyn FnMut(Gaussians) -> Result<()> + 'a;

/// What a file says before its Gaussians.
#[derive(Clone, Debug, PartialEq)]
pub struct Header {
    /// What kind of file it is.
    pub format: Format,
    /// Number of Gaussians, usable or not.
    pub count: u64,
    /// Degree of the spherical harmonics, 0 to 3.
    pub sh_degree: u32,
    /// Whether the Gaussians were trained with, and want, antialiasing (Mip-Splatting's opacity compensation).
    pub antialiased: bool,
    /// What the file contains that is not used.
    pub warnings: Vec<String>,
}

/// How to read Gaussians.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ReadOptions {
    /// Leave out Gaussians with unusable parameters instead of refusing the file.
    pub drop_invalid: bool,
}

/// Gaussians from a file, and what was left out.
#[derive(Clone, Debug, PartialEq)]
pub struct Scene {
    /// The usable Gaussians, in the file's order.
    pub gaussians: Gaussians,
    /// What the file says of itself.
    pub header: Header,
    /// Number of Gaussians that were left out because a parameter is not usable.
    pub dropped: u64,
    /// Which those are, and what else the user should know.
    pub warnings: Vec<String>,
}

/// Reads a file of Gaussians in any format that is known by its first bytes or its extension.
///
/// # Errors
/// [`Error::Io`] when the file cannot be read; [`Error::Input`] when it is no file of Gaussians, is cut short or
/// damaged, or has unusable parameters (see [`super::ply::read`]) and [`ReadOptions::drop_invalid`] is not set.
pub fn read(path: impl AsRef<Path>, options: &ReadOptions) -> Result<Scene> {
    collect_from(Reader::open(path.as_ref(), options)?)
}

/// All Gaussians of one source.
pub(super) fn collect(path: &Path, source: Box<dyn Source + '_>, options: &ReadOptions) -> Result<Scene> {
    collect_from(Reader { path: path.to_owned(), source, options: *options, warning: None })
}

fn collect_from(mut reader: Reader<'_>) -> Result<Scene> {
    let header = reader.header().clone();
    // What the header claims was compared with the file's size; rows still take more than packed ones, and glTF may
    // place the same ones a limited number of times.
    let capacity = usize::try_from(header.count).unwrap_or(0);
    let mut gaussians = Gaussians::with_capacity(header.sh_degree, capacity);
    let dropped = reader.blocks(&mut |block| {
        gaussians.append(&block);
        Ok(())
    })?;
    let warnings = header.warnings.iter().cloned().chain(reader.warning.take()).collect();
    Ok(Scene { gaussians, header, dropped, warnings })
}

/// Writes Gaussians in the format of the path's extension, or in a given one.
///
/// # Errors
/// [`Error::Argument`] when the vectors do not fit together; [`Error::Input`] for an unknown extension; what the
/// format cannot hold; [`Error::Io`] naming the file when it cannot be written. No partial file is left.
pub fn write(path: impl AsRef<Path>, gaussians: &Gaussians, options: &WriteOptions) -> Result<()> {
    gaussians.check_shapes()?;
    let path = path.as_ref();
    let format = match options.format {
        Some(format) => format,
        None => Format::of_extension(path)?,
    };
    let outline = Outline {
        count: gaussians.len() as u64,
        sh_degree: gaussians.sh_degree,
        antialiased: options.antialiased,
        bounds: gaussians.bounds(),
    };
    write_blocks(path, format, &outline, &mut |sink| {
        let coefficients = sh_coefficients(gaussians.sh_degree);
        for start in (0..gaussians.len()).step_by(BLOCK) {
            let rows = start..(start + BLOCK).min(gaussians.len());
            sink(Gaussians {
                sh_degree: gaussians.sh_degree,
                means: gaussians.means[rows.clone()].to_vec(),
                quats: gaussians.quats[rows.clone()].to_vec(),
                log_scales: gaussians.log_scales[rows.clone()].to_vec(),
                opacity_logits: gaussians.opacity_logits[rows.clone()].to_vec(),
                sh: gaussians.sh[rows.start * coefficients..rows.end * coefficients].to_vec(),
            })?;
        }
        Ok(())
    })
}

/// How to write Gaussians.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct WriteOptions {
    /// The format; none: that of the path's extension.
    pub format: Option<Format>,
    /// Whether the Gaussians were trained with antialiasing.
    pub antialiased: bool,
}

/// What must be known of a scene before its first Gaussian is written.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Outline {
    pub(super) count: u64,
    pub(super) sh_degree: u32,
    pub(super) antialiased: bool,
    /// Box around the means; none without Gaussians.
    pub(super) bounds: Option<Bounds>,
}

/// Hands all blocks of a scene, in order, to the sink that it is given.
pub(super) type Produce<'a> = dyn FnMut(&mut Sink<'_>) -> Result<()> + 'a;

fn write_blocks(path: &Path, format: Format, outline: &Outline, produce: &mut Produce<'_>) -> Result<()> {
    match format {
        Format::Ply => ply::write_blocks(path, outline, produce),
        Format::CompressedPly => ply::write_compressed_blocks(path, outline, produce),
        Format::Splat => dot_splat::write(path, outline, produce),
        Format::Spz => spz_write::write(path, outline, produce),
        Format::Glb | Format::Gltf => gltf_write::write(path, format, outline, produce),
    }
}

/// One kind of file, open.
pub(super) trait Source {
    fn header(&self) -> &Header;

    /// Hands over all Gaussians, usable or not. Called once.
    fn blocks(&mut self, sink: &mut Sink<'_>) -> Result<()>;

    /// What one Gaussian is called in messages about the file.
    fn row_name(&self) -> &'static str {
        "Gaussian"
    }
}

/// An open file whose Gaussians come block by block.
struct Reader<'a> {
    path: PathBuf,
    source: Box<dyn Source + 'a>,
    options: ReadOptions,
    /// Which Gaussians were left out.
    warning: Option<String>,
}

impl<'a> Reader<'a> {
    fn open(path: &'a Path, options: &ReadOptions) -> Result<Self> {
        let source: Box<dyn Source + 'a> = match Format::of_file(path)? {
            Format::Ply => Box::new(ply::GaussianRows::open(path)?),
            Format::CompressedPly => Box::new(ply::CompressedPly::open(path)?),
            Format::Splat => Box::new(dot_splat::DotSplat::open(path)?),
            Format::Spz => Box::new(spz::Spz::open(path)?),
            format @ (Format::Glb | Format::Gltf) => Box::new(gltf::Gltf::open(path, format)?),
        };
        Ok(Self { path: path.to_owned(), source, options: *options, warning: None })
    }

    fn header(&self) -> &Header {
        self.source.header()
    }

    /// Hands over the usable Gaussians; the answer is how many were left out.
    fn blocks(&mut self, sink: &mut Sink<'_>) -> Result<u64> {
        let (count, row_name) = (self.header().count, self.source.row_name());
        let drop_invalid = self.options.drop_invalid;
        let mut unusable = Unusable::default();
        self.source.blocks(&mut |mut block| {
            unusable.look_through(&mut block);
            // After the first unusable one, a file that is refused is read on for the count alone.
            if unusable.count() == 0 || drop_invalid { sink(block) } else { Ok(()) }
        })?;
        self.warning = unusable.describe(count, row_name);
        match &self.warning {
            Some(problem) if !drop_invalid => {
                Err(Error::input(&self.path, problem.clone(), "--drop-invalid leaves them out"))
            }
            _ => Ok(unusable.count()),
        }
    }
}
