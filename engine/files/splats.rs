//! Gaussians in common file formats: PLY, compressed PLY, `.splat`, SPZ, glTF.
//!
//! All are converted to and from the frame and the raw parameters of the reference implementation's PLY.
//! Reading and writing proceed block by block, so that a conversion needs little memory if the formats allow
//! it. Compressed PLY is sorted, so it is written from memory. SPZ is held packed in memory, at a quarter of
//! its size or less.

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

use super::{host_memory, ply};
use ashsplat::scene::gaussians::sh_coefficients;
use ashsplat::scene::{Bounds, Gaussians};
use ashsplat::{Error, Result};

pub use convert::{ConvertOptions, Converted, Target, convert};
pub use format::Format;
use validation::Unusable;

/// Most Gaussians of a block.
pub(super) const BLOCK: usize = 16_384;

/// Receives Gaussians block by block. All blocks have the same SH degree.
pub(super) type Sink<'a> = dyn FnMut(Gaussians) -> Result<()> + 'a;

/// Properties of a file before its Gaussians.
#[derive(Clone, Debug, PartialEq)]
pub struct Header {
    /// Format of the file.
    pub format: Format,
    /// Number of Gaussians, usable or not.
    pub count: u64,
    /// Degree of the spherical harmonics, 0 to 3.
    pub sh_degree: u32,
    /// Whether the Gaussians were trained with antialiasing (Mip-Splatting's opacity compensation) and need
    /// it.
    pub antialiased: bool,
    /// Parts of the file that are not used.
    pub warnings: Vec<String>,
}

/// How to read Gaussians.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ReadOptions {
    /// Drop Gaussians with unusable parameters instead of refusing the file.
    pub drop_invalid: bool,
    /// Bytes of memory that reading may take at most; none: three quarters of what the machine has left.
    pub max_host_memory: Option<u64>,
}

/// Gaussians from a file, and the number of dropped ones.
#[derive(Clone, Debug, PartialEq)]
pub struct Scene {
    /// The usable Gaussians, in the file's order.
    pub gaussians: Gaussians,
    /// The file's header.
    pub header: Header,
    /// Number of Gaussians that were dropped because of an unusable parameter.
    pub dropped: u64,
    /// Descriptions of the dropped Gaussians, and other warnings.
    pub warnings: Vec<String>,
}

/// Reads a file of Gaussians. Its first bytes or its extension select the format.
///
/// # Errors
/// [`Error::Io`] when the file cannot be read; [`Error::Input`] when it is no file of Gaussians, is cut short
/// or damaged, or has unusable parameters (see [`super::ply::read`]) and [`ReadOptions::drop_invalid`] is not
/// set; [`Error::TooLarge`] when it needs more memory than [`ReadOptions::max_host_memory`].
pub fn read(path: impl AsRef<Path>, options: &ReadOptions) -> Result<Scene> {
    collect_from(Reader::open(path.as_ref(), options)?)
}

/// All Gaussians of one source.
pub(super) fn collect(path: &Path, source: Box<dyn Source + '_>, options: &ReadOptions) -> Result<Scene> {
    collect_from(Reader { path: path.to_owned(), source, options: *options, warning: None })
}

fn collect_from(mut reader: Reader<'_>) -> Result<Scene> {
    let header = reader.header().clone();
    // The header's count was checked against the file's size. Rows still take more memory than packed ones,
    // and glTF may repeat the same ones a limited number of times.
    let capacity = usize::try_from(header.count).unwrap_or(0);
    let row = size_of::<f32>() * (11 + 3 * sh_coefficients(header.sh_degree));
    let needed = header.count.saturating_mul(row as u64).saturating_add(reader.source.held_bytes());
    host_memory::check(&reader.path, needed, reader.options.max_host_memory)?;
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
/// [`Error::Argument`] when the vectors do not fit together; [`Error::Input`] for an unknown extension or for
/// data that the format cannot hold; [`Error::Io`] naming the file when it cannot be written. No partial file
/// remains.
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

/// Properties of a scene that are needed before its first Gaussian is written.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Outline {
    pub(super) count: u64,
    pub(super) sh_degree: u32,
    pub(super) antialiased: bool,
    /// Box around the means; none without Gaussians.
    pub(super) bounds: Option<Bounds>,
}

/// Passes all blocks of a scene, in order, to a sink.
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

/// An open file of one format.
pub(super) trait Source {
    fn header(&self) -> &Header;

    /// Passes all Gaussians to the sink, usable or not. Called once.
    fn blocks(&mut self, sink: &mut Sink<'_>) -> Result<()>;

    /// Bytes that it holds in memory.
    fn held_bytes(&self) -> u64 {
        0
    }

    /// Name of one Gaussian in messages about the file.
    fn row_name(&self) -> &'static str {
        "Gaussian"
    }
}

/// An open file that is read block by block.
struct Reader<'a> {
    path: PathBuf,
    source: Box<dyn Source + 'a>,
    options: ReadOptions,
    /// Description of the dropped Gaussians.
    warning: Option<String>,
}

impl<'a> Reader<'a> {
    fn open(path: &'a Path, options: &ReadOptions) -> Result<Self> {
        let source: Box<dyn Source + 'a> = match Format::of_file(path)? {
            Format::Ply => Box::new(ply::GaussianRows::open(path)?),
            Format::CompressedPly => Box::new(ply::CompressedPly::open(path)?),
            Format::Splat => Box::new(dot_splat::DotSplat::open(path)?),
            Format::Spz => Box::new(spz::Spz::open(path, options.max_host_memory)?),
            format @ (Format::Glb | Format::Gltf) => Box::new(gltf::Gltf::open(path, format)?),
        };
        Ok(Self { path: path.to_owned(), source, options: *options, warning: None })
    }

    fn header(&self) -> &Header {
        self.source.header()
    }

    /// Passes the usable Gaussians to the sink. Returns the number of dropped ones.
    fn blocks(&mut self, sink: &mut Sink<'_>) -> Result<u64> {
        let (count, row_name) = (self.header().count, self.source.row_name());
        let drop_invalid = self.options.drop_invalid;
        let mut unusable = Unusable::default();
        self.source.blocks(&mut |mut block| {
            unusable.look_through(&mut block);
            // After the first unusable Gaussian, a file that is refused is only counted.
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
