//! Streams Gaussians block by block between files of any format.

use std::path::Path;

use glam::{DVec3, Vec3};

use super::spz::{MAX_FRACTIONAL_BITS, farthest, fractional_bits};
use super::{FARTHEST, Format, MAX_COMPRESSED_LOG_SCALE, sog};
use crate::{host_memory, ply};
use ashsplat::kernels::constants::QUAT_NORM_MIN;
use ashsplat::scene::gaussians::sh_coefficients;
use ashsplat::scene::sh::rgb_to_sh_dc;
use ashsplat::scene::{Bounds, Gaussians, Similarity, WorldFrame};
use ashsplat::{Error, RenderSettings, Result};

/// Largest number of Gaussians in a block.
pub(crate) const BLOCK: usize = 16_384;

/// Receives Gaussians block by block. All blocks of a [`Reader`] have the same SH degree.
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
    /// True if the Gaussians were trained in the order of distances and need it ([`RenderSettings::distance_order`]).
    pub distance_order: bool,
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

    /// Antialiasing, kernel size and order, for messages.
    pub(crate) fn marks_in_words(&self) -> String {
        let with = if self.antialiased { "with" } else { "without" };
        let kernel = self.kernel_size.map_or_else(String::new, |size| format!(", kernel size {size}"));
        let order = if self.distance_order { ", ordered by distance" } else { "" };
        format!("{with} antialiasing{kernel}{order}")
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
    /// See [`Header::distance_order`]; kept in PLY and glTF.
    pub distance_order: bool,
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
        let distance_order = settings.distance_order;
        Self { antialiased: settings.antialias, kernel_size, distance_order, ..Self::default() }
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

/// The header of an open file, and a call that passes all its Gaussians to a sink once: usable or not, with the header's SH
/// degree or a lower one.
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

/// Largest usable coordinate of positions and quaternions: the square of a larger one overflows.
const MAX_COORDINATE: f32 = 1e18;
/// Largest usable SH coefficient: with it, no sum over terms, splats or their derivatives overflows.
const MAX_SH: f32 = 1e32;
/// Largest usable log-scale: the exponential of a larger one overflows.
const MAX_LOG_SCALE: f32 = 88.0;

/// Counts the unusable Gaussians of a file, which it removes from the stream, and those with implausible values.
#[derive(Default)]
struct Validation {
    seen: u64,
    pub(super) unusable: u64,
    /// Row, parameter and value of the first one.
    first: Option<(u64, String, f32)>,
    without_rotation: u64,
    coarse: u64,
    /// Logarithmic sums over the Gaussians with coarse positions.
    log_steps: f64,
    log_sizes: f64,
}

impl Validation {
    /// Removes the unusable Gaussians of the next block, and counts implausible values of the others. A size of 0
    /// (log-scale -∞) becomes the smallest normal number, a quaternion of zeros the identity, which can be rotated.
    fn look_through(&mut self, block: &mut Gaussians) {
        let rows = block.len();
        for log_scale in block.log_scales.as_flattened_mut() {
            if *log_scale == f32::NEG_INFINITY {
                *log_scale = f32::MIN_POSITIVE.ln();
            }
        }
        if (0..rows).any(|index| parameter(block, index).is_some()) {
            for index in 0..rows {
                if let Some((name, value)) = parameter(block, index) {
                    self.unusable += 1;
                    self.first.get_or_insert((self.seen + index as u64, name, value));
                }
            }
            block.retain(|all, index| parameter(all, index).is_none());
        }
        self.seen += rows as u64;
        for quat in &mut block.quats {
            if quat.iter().map(|q| q * q).sum::<f32>().sqrt() <= QUAT_NORM_MIN {
                *quat = [1.0, 0.0, 0.0, 0.0];
                self.without_rotation += 1;
            }
        }
        for (mean, [x, y, z]) in block.means.iter().zip(&block.log_scales) {
            let farthest = mean.iter().fold(0.0_f32, |max, v| max.max(v.abs()));
            // The next lower power of two has the same steps.
            let power = f32::from_bits(farthest.to_bits() & f32::INFINITY.to_bits());
            let step = f64::from(power) * f64::from(f32::EPSILON);
            let log_size = x.max(*y).max(*z);
            // A size of 0 cannot be compared with.
            if log_size > f32::MIN_POSITIVE.ln() && step > COARSE * f64::from(log_size).exp() {
                self.coarse += 1;
                self.log_steps += step.ln();
                self.log_sizes += f64::from(log_size);
            }
        }
    }

    /// Describes the unusable Gaussians in one line; `None` if all are usable.
    fn describe_unusable(&self, all: u64, row_name: &str) -> Option<String> {
        let (row, name, value) = self.first.as_ref()?;
        let kind = if value.is_finite() { "too large" } else { "not finite" };
        let bad = self.unusable;
        let have = if bad == 1 { "Gaussian has" } else { "Gaussians have" };
        Some(format!(
            "{bad} of {all} {have} unusable parameters; the first, {row_name} {row}: {name} = {value} is {kind}"
        ))
    }

    /// One warning per kind of implausible value.
    pub(super) fn lines(&self) -> Vec<String> {
        let (count, mut lines) = (self.seen - self.unusable, Vec::new());
        if self.without_rotation > 0 {
            let some = self.without_rotation;
            lines.push(format!(
                "{some} of {count} Gaussians have a quaternion of zeros and are used without rotation"
            ));
        }
        if 2 * self.coarse > count {
            let [step, size] =
                [self.log_steps, self.log_sizes].map(|sum| short((sum / self.coarse as f64).exp()));
            lines.push(format!(
                "positions are rounded to steps of about {step} (a typical size is {size}), because the scene lies far from its origin: \
                 export doubles, or move it there before it is saved"
            ));
        }
        lines
    }
}

/// Refuses to write Gaussians that reading would refuse.
pub(super) fn check_readable(path: &Path, block: &Gaussians) -> Result<()> {
    match (0..block.len()).find_map(|index| parameter(block, index)) {
        None => Ok(()),
        Some((name, value)) => {
            let kind = if value.is_finite() { "too large" } else { "not finite" };
            let problem = format!("is not written: a Gaussian would have {name} = {value}, which is {kind}");
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
fn parameter(block: &Gaussians, index: usize) -> Option<(String, f32)> {
    let bad_coordinate = |v: &f32| !v.is_finite() || v.abs() > MAX_COORDINATE;
    let bad_scale = |v: &f32| !v.is_finite() || *v > MAX_LOG_SCALE;
    let bad_sh = |v: &f32| !v.is_finite() || v.abs() > MAX_SH;
    let find = |values: &[f32], bad: &dyn Fn(&f32) -> bool, name: &dyn Fn(usize) -> String| {
        let at = values.iter().position(bad)?;
        Some((name(at), values[at]))
    };
    let opacity = block.opacity_logits[index];
    let (dc, rest) = block.sh_of(index).split_at(1);
    // PLY has the coefficients of red, then green, then blue.
    let place = |at: usize| at % 3 * rest.len() + at / 3;
    find(&block.means[index], &bad_coordinate, &|axis| ["x", "y", "z"][axis].into())
        .or_else(|| opacity.is_nan().then(|| ("opacity".into(), opacity)))
        .or_else(|| find(&block.log_scales[index], &bad_scale, &|axis| format!("scale_{axis}")))
        .or_else(|| find(&block.quats[index], &bad_coordinate, &|at| format!("rot_{at}")))
        .or_else(|| find(dc.as_flattened(), &bad_sh, &|at| format!("f_dc_{at}")))
        .or_else(|| find(rest.as_flattened(), &bad_sh, &|at| format!("f_rest_{}", place(at))))
}

/// Share of a typical Gaussian's size at which steps of positions are coarse: pictures lose about 6 dB.
pub(super) const COARSE: f64 = 0.2;

/// A positive number with two significant digits, or with all digits before the decimal point.
pub(super) fn short(value: f64) -> String {
    let digits = (1.0 - value.log10().floor()).clamp(0.0, 40.0) as usize;
    format!("{value:.digits$}")
}

/// Logarithm of the ratio at which a Gaussian's longest axis hides that its thinnest one is cut.
const THIN: f32 = 3.0;
/// Share of the Gaussians with cut colours or SH coefficients in ordinary scenes.
const USUALLY_CUT: f64 = 0.02;

/// Statistics of a scene's Gaussians against the limits of a format.
#[derive(Default)]
pub(super) struct PackingLoss {
    /// Smallest and largest log-scale.
    log_scales: [f32; 2],
    /// Smallest and largest coefficient of a base colour.
    dc: [f32; 2],
    /// Largest higher SH coefficient.
    max_sh: f32,
    count: u64,
    /// Sum of each Gaussian's largest log-scale.
    log_sizes: f64,
    /// Sum of the logarithms of 1 + each Gaussian's largest coordinate.
    log_reach: f64,
    cut_scales: u64,
    cut_colors: u64,
    cut_sh: u64,
    /// Means and base colours, by which compressed PLY forms its chunks.
    chunked: Option<Gaussians>,
}

impl PackingLoss {
    /// Returns `None` for formats that hold all values in single precision.
    pub(super) fn of(format: Format, spz_version: Option<u32>) -> Option<Self> {
        let any = [f32::NEG_INFINITY, f32::INFINITY];
        let (log_scales, dc, max_sh) = match (format, spz_version) {
            (Format::Spz, _) | (Format::Glb, Some(_)) => ([-10.0, 5.9375], [-0.5 / 0.15, 0.5 / 0.15], 1.0),
            (Format::CompressedPly, _) => ([-MAX_COMPRESSED_LOG_SCALE, MAX_COMPRESSED_LOG_SCALE], any, 4.0),
            // Without view dependence, colours below 0 are drawn as 0.
            (Format::Splat, _) => (any, [f32::NEG_INFINITY, rgb_to_sh_dc(1.0)], f32::INFINITY),
            (Format::Sog, _) => (any, any, f32::INFINITY),
            _ => return None,
        };
        let chunked = (format == Format::CompressedPly).then(Gaussians::default);
        Some(Self { log_scales, dc, max_sh, chunked, ..Self::default() })
    }

    pub(super) fn add(&mut self, block: &Gaussians) {
        let [low, high] = self.log_scales;
        for (index, [x, y, z]) in block.log_scales.iter().enumerate() {
            let (smallest, largest) = (x.min(*y).min(*z), x.max(*y).max(*z));
            self.log_sizes += f64::from(largest.max(-100.0));
            let [x, y, z] = block.means[index].map(|v| f64::from(v).abs());
            self.log_reach += x.max(y).max(z).ln_1p();
            let is_cut = largest > high || (smallest < low && largest < low + THIN);
            self.cut_scales += u64::from(is_cut);
            let (dc, higher) = block.sh_of(index).split_at(1);
            let [low, high] = self.dc;
            self.cut_colors += u64::from(dc[0].iter().any(|dc| !(low..=high).contains(dc)));
            self.cut_sh += u64::from(higher.as_flattened().iter().any(|sh| sh.abs() > self.max_sh));
        }
        if let Some(chunked) = &mut self.chunked {
            chunked.means.extend_from_slice(&block.means);
            chunked.sh.extend((0..block.len()).map(|index| block.sh_of(index)[0]));
        }
        self.count += block.len() as u64;
    }

    /// Warning about what the format loses, if it is visible.
    pub(super) fn line(&self, format: Format, outline: &Outline) -> Option<String> {
        let mut losses = Vec::new();
        let step = fractional_bits(outline).map_or(0.0, |bits| (-f64::from(bits)).exp2());
        let finest = (-f64::from(MAX_FRACTIONAL_BITS)).exp2();
        let typical = (self.log_sizes / self.count.max(1) as f64).exp();
        let mut coarse = |step: f64, reason: &str| {
            if step > COARSE * typical {
                let [step, size] = [step, typical].map(short);
                let line =
                    format!("positions are rounded to steps of {step} (a typical size is {size}), {reason}");
                losses.push(line);
            }
        };
        if matches!(format, Format::Spz | Format::Glb) {
            let farthest = short(farthest(outline).into());
            let crop = format!("because one lies at {farthest}: crop the scene for finer steps");
            let finest_of_spz = "the finest that SPZ has: scale the scene up";
            coarse(step, if step == finest { finest_of_spz } else { &crop });
        }
        if let (Format::Sog, Some(bounds)) = (format, outline.bounds) {
            // Positions are stored as logarithms, so that steps grow with the distance.
            let reach = (self.log_reach / self.count.max(1) as f64).exp();
            coarse(
                reach * sog::log_step(bounds),
                "because the scene is large: crop it, or move its middle to 0",
            );
        }
        let step = self.chunked.as_ref().map_or(0.0, ply::typical_step);
        coarse(step, "because 256 Gaussians share a box and lie far apart");
        let count = self.count;
        if self.cut_scales > 0 {
            let [low, high] = self.log_scales.map(|scale| short(f64::from(scale).exp()));
            let cut = self.cut_scales;
            losses
                .push(format!("sizes of {cut} of {count} Gaussians are beyond {low} to {high} and are cut"));
        }
        if self.cut_colors as f64 > USUALLY_CUT * count as f64 {
            losses.push(format!("colours of {} of {count} Gaussians are cut", self.cut_colors));
        }
        if self.cut_sh as f64 > USUALLY_CUT * count as f64 {
            let (cut, limit) = (self.cut_sh, self.max_sh);
            losses.push(format!(
                "SH coefficients above degree 0 of {cut} of {count} Gaussians are beyond -{limit} to {limit} and are cut"
            ));
        }
        let losses = Some(losses.join("; ")).filter(|losses| !losses.is_empty())?;
        Some(format!("{format} does not hold the scene exactly: {losses}"))
    }
}
