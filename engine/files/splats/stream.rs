//! Streams Gaussians block by block between files of any format.

use std::path::Path;

use glam::{DVec3, Vec3};

use super::format::Format;
use super::validation::Validation;
use crate::host_memory;
use ashsplat::scene::gaussians::sh_coefficients;
use ashsplat::scene::{Bounds, Gaussians, Similarity, WorldFrame};
use ashsplat::{Error, RenderSettings, Result};

/// Largest number of Gaussians in a block.
pub(crate) const BLOCK: usize = 16_384;

/// Receives Gaussians block by block. All blocks have the same SH degree.
pub(crate) type Sink<'a> = dyn FnMut(Gaussians) -> Result<()> + 'a;

/// Properties of a file before its Gaussians.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Header {
    /// Format of the file.
    pub format: Format,
    /// Number of Gaussians, usable or not.
    pub count: u64,
    /// Degree of the spherical harmonics, 0 to 3.
    pub sh_degree: u32,
    /// True if the Gaussians were trained with antialiasing (Mip-Splatting's opacity compensation) and need it.
    pub antialiased: bool,
    /// Variance that training added on the screen, square pixels; `None` if the file does not say.
    pub kernel_size: Option<f32>,
    /// True for a scene of 2DGS, whose disks are used as Gaussians without thickness.
    pub is_2dgs: bool,
    /// Origin of the positions, source coordinates; not zero for scenes far from the source's own origin.
    pub origin: DVec3,
    /// World unit of the training ([`WorldFrame::unit`]), if the file names one. Positions and sizes are in source units.
    pub unit: Option<f64>,
    /// True if the file's positions are in double precision.
    pub double_positions: bool,
    /// Warnings about parts of the file that are not used.
    pub warnings: Vec<String>,
}

impl Header {
    pub(crate) fn new(format: Format, count: u64, sh_degree: u32) -> Self {
        Self { format, count, sh_degree, ..Self::default() }
    }

    /// Antialiasing and kernel size, for messages.
    pub(crate) fn marks_in_words(&self) -> String {
        let with = if self.antialiased { "with" } else { "without" };
        let kernel = self.kernel_size.map_or_else(String::new, |size| format!(", kernel size {size}"));
        format!("{with} antialiasing{kernel}")
    }
}

/// True if a file's kernel size is valid for drawing.
pub(crate) fn is_kernel_size(size: &f32) -> bool {
    *size > 0.0 && *size <= 1e4
}

/// How to read Gaussians.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ReadOptions {
    /// Drop Gaussians with unusable parameters instead of refusing the file.
    pub drop_invalid: bool,
    /// Memory budget of reading, bytes; `None` for three quarters of the machine's free memory.
    pub max_host_memory: Option<u64>,
}

/// How to write Gaussians.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct WriteOptions {
    /// The format; `None` for that of the path's extension.
    pub format: Option<Format>,
    /// True if the Gaussians were trained with antialiasing.
    pub antialiased: bool,
    /// See [`Header::kernel_size`]; kept in PLY and glTF.
    pub kernel_size: Option<f32>,
    /// Marks a scene of 2DGS ([`Header::is_2dgs`]); PLY keeps it.
    pub is_2dgs: bool,
    /// Version of SPZ. SPZ: 2, 3 or 4; `None` for 4. GLB: 2 packs the attributes as
    /// `KHR_gaussian_splatting_compression_spz_2`; `None` does not pack. Other formats have no version.
    pub spz_version: Option<u32>,
    /// Frame of the Gaussians within the file's coordinates. They are written in source units, relative to the frame's
    /// origin, which the file names: PLY in a comment, glTF in the node's translation, .splat, SPZ and SOG in a file
    /// `NAME.origin.json` beside it.
    pub frame: WorldFrame,
}

impl WriteOptions {
    /// The marks of a scene that is drawn or was trained with these settings.
    pub fn marking(settings: &RenderSettings) -> Self {
        let usual = RenderSettings::default().dilation_px2;
        let kernel_size = Some(settings.dilation_px2).filter(|size| *size != usual);
        Self { antialiased: settings.antialias, kernel_size, ..Self::default() }
    }
}

/// Gaussians from a file, and the number of dropped ones.
#[derive(Clone, Debug, PartialEq)]
pub struct Scene {
    /// The usable Gaussians, in the file's order.
    pub gaussians: Gaussians,
    /// The file's header.
    pub header: Header,
    /// Frame of the Gaussians within the file's coordinates.
    pub frame: WorldFrame,
    /// Number of Gaussians that were dropped because of an unusable parameter.
    pub dropped: u64,
    /// Descriptions of the dropped Gaussians, and other warnings.
    pub warnings: Vec<String>,
}

/// Number of points that suffices to choose a scene's frame.
const FRAME_POINTS: usize = 1 << 16;

impl Scene {
    /// Moves the scene to its drawing frame: a distant scene gets an origin of its own, a tiny one is enlarged beyond
    /// the near limit. Origin and unit that the file names are kept.
    pub fn in_world_frame(mut self) -> Self {
        let step = self.gaussians.len().div_ceil(FRAME_POINTS).max(1);
        let means = self.gaussians.means.iter().step_by(step);
        let points: Vec<DVec3> = means.map(|&mean| self.frame.source(Vec3::from_array(mean))).collect();
        let around = WorldFrame::around_gaussians(&points);
        let frame = WorldFrame {
            origin: if self.header.origin == DVec3::ZERO { around.origin } else { self.header.origin },
            unit: self.header.unit.unwrap_or(around.unit),
        };
        self.express_in(&frame);
        self
    }

    /// Moves the Gaussians to another frame, such as that of a data set.
    pub fn express_in(&mut self, frame: &WorldFrame) {
        self.gaussians.transform(&Similarity::between(&self.frame, frame));
        self.frame = *frame;
    }
}

/// Properties of a scene that must be known before its first Gaussian is written.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Outline {
    pub(crate) count: u64,
    pub(crate) sh_degree: u32,
    /// The Gaussians themselves are in source units, relative to the frame's origin.
    pub(crate) options: WriteOptions,
    /// Box around the means; `None` without Gaussians.
    pub(crate) bounds: Option<Bounds>,
    /// True if positions are written in double precision, if the format can. They are absolute then.
    pub(crate) double_positions: bool,
}

/// Passes all blocks of a scene, in order, to a sink.
pub(crate) type Produce<'a> = dyn FnMut(&mut Sink<'_>) -> Result<()> + 'a;

impl Outline {
    /// Outline of Gaussians in the options' frame; they are written in source units.
    pub(crate) fn of(gaussians: &Gaussians, options: &WriteOptions) -> Self {
        let scaled = |corner: Vec3| (options.frame.unit * corner.as_dvec3()).as_vec3();
        Self {
            count: gaussians.len() as u64,
            sh_degree: gaussians.sh_degree,
            options: *options,
            bounds: gaussians
                .bounds()
                .map(|Bounds { min, max }| Bounds { min: scaled(min), max: scaled(max) }),
            double_positions: false,
        }
    }

    /// All Gaussians, if the machine has the memory for them and `beside` bytes more for each.
    pub(crate) fn in_memory(&self, path: &Path, beside: u64, produce: &mut Produce<'_>) -> Result<Gaussians> {
        host_memory::check_writing(path, self.count.saturating_mul(row_bytes(self.sh_degree) + beside))?;
        let mut all = Gaussians { sh_degree: self.sh_degree, ..Default::default() };
        produce(&mut |block| {
            all.append(&block);
            Ok(())
        })?;
        Ok(all)
    }
}

/// Bytes of a Gaussian in memory.
pub fn row_bytes(sh_degree: u32) -> u64 {
    (size_of::<f32>() * (11 + 3 * sh_coefficients(sh_degree))) as u64
}

/// Passes Gaussians to a sink in blocks, enlarged by a factor.
pub(crate) fn in_blocks(gaussians: &Gaussians, scale: f64, sink: &mut Sink<'_>) -> Result<()> {
    let similarity = Similarity { scale, ..Default::default() };
    for start in (0..gaussians.len()).step_by(BLOCK) {
        let rows: Vec<usize> = (start..(start + BLOCK).min(gaussians.len())).collect();
        let mut block = gaussians.select(&rows);
        block.transform(&similarity);
        sink(block)?;
    }
    Ok(())
}

/// Collects single Gaussians into blocks for a sink.
pub(crate) struct Blocks<'a, 's> {
    block: Gaussians,
    sink: &'a mut Sink<'s>,
}

impl<'a, 's> Blocks<'a, 's> {
    pub(crate) fn new(sh_degree: u32, count: u64, sink: &'a mut Sink<'s>) -> Self {
        Self { block: Gaussians::with_capacity(sh_degree, count.min(BLOCK as u64) as usize), sink }
    }

    /// The block to which the next Gaussian is to be appended.
    pub(crate) fn next(&mut self) -> Result<&mut Gaussians> {
        if self.block.len() == BLOCK {
            let next = Gaussians::with_capacity(self.block.sh_degree, BLOCK);
            (self.sink)(std::mem::replace(&mut self.block, next))?;
        }
        Ok(&mut self.block)
    }

    pub(crate) fn finish(self) -> Result<()> {
        (self.sink)(self.block)
    }
}

/// The header of an open file, and a call that passes all its Gaussians to a sink, usable or not.
pub(crate) type Opened<'a> = (Header, Box<Produce<'a>>);

/// An open file that is read block by block.
pub(crate) struct Reader<'a> {
    pub(super) path: &'a Path,
    pub(crate) header: Header,
    pub(super) produce: Box<Produce<'a>>,
    pub(super) options: ReadOptions,
    /// Descriptions of the dropped and of the implausible Gaussians.
    pub(crate) warnings: Vec<String>,
}

impl Reader<'_> {
    /// Passes the usable Gaussians to the sink, all with the header's SH degree. Returns the number of dropped ones.
    pub(crate) fn blocks(&mut self, sink: &mut Sink<'_>) -> Result<u64> {
        let Header { count, format, sh_degree, .. } = self.header;
        let row_name =
            if matches!(format, Format::Ply | Format::CompressedPly) { "vertex" } else { "Gaussian" };
        let drop_invalid = self.options.drop_invalid;
        let mut validation = Validation::default();
        (self.produce)(&mut |mut block| {
            if block.sh_degree < sh_degree {
                block = block.with_sh_degree(sh_degree);
            }
            validation.look_through(&mut block);
            // If the file is refused, Gaussians after the first unusable one are only counted.
            if validation.unusable == 0 || drop_invalid { sink(block) } else { Ok(()) }
        })?;
        let problem = validation.describe_unusable(count, row_name);
        if let Some(problem) = &problem
            && (!drop_invalid || validation.unusable == count)
        {
            let remedy = match drop_invalid {
                true => "none is left without them: write the file again",
                false => "--drop-invalid leaves them out",
            };
            return Err(Error::input(self.path, problem, remedy));
        }
        self.warnings = problem.into_iter().chain(validation.lines()).collect();
        Ok(validation.unusable)
    }

    pub(crate) fn collect(mut self) -> Result<Scene> {
        let header = self.header.clone();
        // The header's count has been checked against the file's size. But rows take more memory than packed ones, and
        // glTF may repeat Gaussians a limited number of times.
        let capacity = usize::try_from(header.count).unwrap_or(0);
        let needed = header.count.saturating_mul(row_bytes(header.sh_degree));
        host_memory::check(self.path, needed, self.options.max_host_memory)?;
        let mut gaussians = Gaussians::with_capacity(header.sh_degree, capacity);
        let dropped = self.blocks(&mut |block| {
            gaussians.append(&block);
            Ok(())
        })?;
        let warnings = header.warnings.iter().cloned().chain(self.warnings.drain(..)).collect();
        let frame = WorldFrame { origin: header.origin, unit: 1.0 };
        Ok(Scene { gaussians, header, frame, dropped, warnings })
    }
}
