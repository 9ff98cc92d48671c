//! Gaussians in common file formats: PLY, compressed PLY, `.splat`, SPZ, glTF, SOG, USDA, `.ksplat`.
//!
//! All are converted to and from the frame and the raw parameters of the reference implementation's PLY.
//! Reading and writing proceed block by block, so that a conversion needs little memory if the formats allow
//! it. Compressed PLY and SOG are sorted, so they are written from memory.
//!
//! Each format is a file here. Its `open` returns the header and a call that produces the Gaussians; its `write` takes such a
//! call.

mod codebook;
mod dot_splat;
mod format;
mod gltf;
mod gltf_write;
mod ksplat;
mod sog;
mod spz;
mod stream;
mod streamed_sog;
mod usda;

use std::path::Path;

use glam::{DVec3, Vec3};

use crate::decimate::decimate;
use crate::{decimate, host_memory, ply};
use ashsplat::scene::{Bounds, Cut, Gaussians, Similarity, WorldFrame};
use ashsplat::{Error, Result};
use stream::PackingLoss;

pub(crate) use format::{FARTHEST, LOD_META, MAX_COMPRESSED_LOG_SCALE, write_origin};
pub use format::{Format, foreign, is_sog};
pub(crate) use gltf::{EXTENSION, PACKED_EXTENSION, mirrored};
pub(super) use gltf_write::{glb_head, placed_primitive};
pub(super) use sog::write_folder as write_sog_folder;
pub(super) use stream::{BLOCK, Blocks, Opened, Outline, Produce, Reader, Sink, in_blocks, is_kernel_size};
pub use stream::{Header, ReadOptions, Scene, WriteOptions, row_bytes};
pub(super) use streamed_sog::{Asset, Bound, LodMeta, Region, Run};

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
    let path = path.as_ref();
    gaussians.check_shapes()?;
    let format = Format::chosen(options.format, path)?;
    let outline = Outline::of(gaussians, options);
    write_blocks(path, format, &outline, &mut |sink| in_blocks(gaussians, options.frame.unit, sink))
}

/// Same as [`write()`], but refuses Gaussians that could not be read again, since they were changed after reading. The file has the
/// bytes of a [`convert()`] that makes the same changes.
pub fn write_changed(
    path: impl AsRef<Path>,
    gaussians: &Gaussians,
    options: &WriteOptions,
) -> Result<Option<String>> {
    let path = path.as_ref();
    gaussians.check_shapes()?;
    stream::check_origin(path, options.frame.origin)?;
    in_blocks(gaussians, options.frame.unit, &mut |block| stream::check_readable(path, &block))?;
    write(path, gaussians, options)
}

/// Names what Gaussians lose in a format, one line each.
pub fn losses(format: Format, gaussians: &Gaussians, options: &WriteOptions) -> Result<Vec<String>> {
    gaussians.check_shapes()?;
    let mut losses = format.losses(gaussians.sh_degree, options);
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

/// Writes the blocks of a scene in a format. Returns a warning about the format's losses.
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
        Format::Splat => dot_splat::write(path, produce),
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
    let description = format::sog_in(path);
    let format = if description.is_some() { Format::Sog } else { Format::of_file(path)? };
    let file = description.unwrap_or_else(|| path.to_owned());
    let (mut header, produce) = match format {
        Format::Ply => ply::open(path)?,
        Format::CompressedPly => ply::open_compressed(path)?,
        Format::Splat => dot_splat::open(path)?,
        Format::Spz => spz::open(path)?,
        Format::Glb | Format::Gltf => gltf::open(path, format, options)?,
        Format::Sog if format::is_lod_meta(&file) => streamed_sog::open(&file, options)?,
        Format::Sog => sog::open(&file, options)?,
        Format::Usda => usda::open(path, options)?,
        Format::Ksplat => ksplat::open(path)?,
    };
    if format.has_origin_file() {
        header.origin = format::read_origin(&file)?;
    }
    Ok(Reader { path, header, produce, options: *options, warnings: Vec::new() })
}

/// Share of the median Gaussian's size beyond which single-precision steps are too coarse for absolute positions.
const COARSE: f64 = 0.01;
/// Number of Gaussians that suffices to choose an origin.
const ORIGIN_SAMPLE: u64 = 1 << 16;

/// Changes of a conversion, in this order: SH degree, cut, similarity, number of Gaussians.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ConvertOptions {
    /// Options for reading the input.
    pub read: ReadOptions,
    /// Highest SH degree that is kept; `None` for all that the output can hold.
    pub sh_degree: Option<u32>,
    /// Gaussians to drop; the cut's box is relative to the input's origin ([`Header::origin`]).
    pub cut: Cut,
    /// Two opposite corners of a box, source coordinates of the input; Gaussians with means outside are dropped too.
    pub crop_box: Option<[DVec3; 2]>,
    /// Similarity that moves the whole scene, source coordinates.
    pub similarity: Similarity,
    /// Largest number of Gaussians in the output; others are merged into them.
    pub decimate: Option<Target>,
    /// The output's format; `None` for that of its extension.
    pub format: Option<Format>,
    /// See [`WriteOptions::spz_version`].
    pub spz_version: Option<u32>,
}

/// Largest number of Gaussians after decimation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Target {
    /// A number of Gaussians.
    Count(u64),
    /// Share of the Gaussians before decimation, 0 to 1.
    Share(f64),
}

/// One of the files that are joined.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Input<'a> {
    /// A file of any format.
    pub path: &'a Path,
    /// Similarity of this file before [`ConvertOptions::similarity`], source coordinates.
    pub similarity: Similarity,
    /// Box that the means must lie in, for the parts of one scene: in the output's coordinates, relative to the first
    /// input's origin, which the output keeps. See [`Bounds::contains`].
    pub within: Option<Bounds>,
}

impl<'a> Input<'a> {
    /// A whole file, as it is.
    pub fn new(path: &'a Path) -> Self {
        Self { path, similarity: Similarity::default(), within: None }
    }
}

/// Result of a conversion.
#[derive(Clone, Debug, PartialEq)]
pub struct Converted {
    /// Headers of the inputs.
    pub inputs: Vec<Header>,
    /// The output's format.
    pub format: Format,
    /// Number of Gaussians written.
    pub written: u64,
    /// Number of Gaussians of each input, before decimation.
    pub taken: Vec<u64>,
    /// SH degree written.
    pub sh_degree: u32,
    /// Losses and oddities.
    pub warnings: Vec<String>,
}

/// Reads a file of Gaussians, changes them, and writes them in another format.
///
/// The input is read twice if the output's header needs the number and box of the Gaussians.
pub fn convert(input: &Path, output: &Path, options: &ConvertOptions) -> Result<Converted> {
    join(&[Input::new(input)], output, options)
}

/// Same as [`convert`], but joins several files in order, block by block. The highest SH degree is kept.
///
/// # Errors
/// [`Error::Input`] for inputs of which only some were trained with antialiasing, or with different kernel sizes; for
/// parts of a scene ([`Input::within`]) also with different SH degrees.
pub fn join(inputs: &[Input<'_>], output: &Path, options: &ConvertOptions) -> Result<Converted> {
    let format = Format::chosen(options.format, output)?;
    options.cut.check()?;
    let headers = inputs.iter().map(|input| Ok(open(input.path, &options.read)?.header));
    let headers = headers.collect::<Result<Vec<Header>>>()?;
    let (Some(first), Some(all)) = (headers.first(), inputs.first()) else {
        return Err(Error::argument("inputs", "there are none"));
    };
    let are_parts = inputs.iter().any(|input| input.within.is_some());
    let trained = |header: &Header| match are_parts {
        true => format!("at SH degree {}, {}", header.sh_degree, header.marks_in_words()),
        false => header.marks_in_words(),
    };
    for (input, header) in inputs.iter().zip(&headers) {
        let [own, there] = [header, first].map(trained);
        if own != there {
            let all = all.path.display();
            let problem = format!("was trained {own}, {all} {there}: one file cannot say both");
            return Err(Error::input(input.path, problem, "join scenes that were trained alike"));
        }
    }
    let highest = headers.iter().map(|header| header.sh_degree).max().unwrap_or(0);
    let wanted_degree = highest.min(options.sh_degree.unwrap_or(3));
    let sh_degree = wanted_degree.min(format.max_sh_degree());
    let named = |input: &Input<'_>, warning: String| match inputs {
        [_] => warning,
        _ => format!("{}: {warning}", input.path.display()),
    };
    let own = |(input, header): (&Input<'_>, &Header)| -> Vec<String> {
        header.warnings.iter().map(|warning| named(input, warning.clone())).collect()
    };
    let mut warnings: Vec<String> = inputs.iter().zip(&headers).flat_map(own).collect();
    let Header { antialiased, kernel_size, distance_order, .. } = *first;
    let is_2dgs = headers.iter().any(|header| header.is_2dgs);
    let marks = WriteOptions { antialiased, kernel_size, distance_order, is_2dgs, ..Default::default() };
    warnings.extend(format.losses(wanted_degree, &marks));
    let count = headers.iter().map(|header| header.count).fold(0, u64::saturating_add);
    if options.decimate.is_some() {
        // All Gaussians, the merged ones, and the search for pairs.
        let needed = count.saturating_mul(2 * row_bytes(sh_degree) + decimate::BYTES);
        host_memory::check(all.path, needed, options.read.max_host_memory)?;
    }
    let change = |(input, header): (&Input<'_>, &Header)| {
        let similarity = match input.similarity == Similarity::default() {
            true => options.similarity,
            false => options.similarity.after(&input.similarity),
        };
        (options.cut_of(header), similarity)
    };
    let changes: Vec<(Cut, Similarity)> = inputs.iter().zip(&headers).map(change).collect();
    let read = |to: DVec3, sink: &mut dyn FnMut(usize, Gaussians) -> Result<()>| {
        let mut reported = Vec::new();
        for (index, (input, (cut, similarity))) in inputs.iter().zip(&changes).enumerate() {
            let mut reader = open(input.path, &options.read)?;
            let similarity = relative(similarity, headers[index].origin, to);
            reader.blocks(&mut |block| {
                let mut block = changed(block, sh_degree, cut, &similarity);
                if let Some(within) = input.within {
                    block.retain(|all, index| within.contains(Vec3::from_array(all.means[index])));
                }
                sink(index, block)
            })?;
            reported.extend(reader.warnings.drain(..).map(|warning| named(input, warning)));
        }
        Ok(reported)
    };
    let moved = changes[0].1;
    // A PLY without a similarity keeps its origin.
    let is_same = inputs.len() == 1 && format == Format::Ply && moved == Similarity::default();
    let mut to = if first.origin == DVec3::ZERO { DVec3::ZERO } else { moved.apply(first.origin) };
    let step = OriginSample::step(count);
    let (taken, mut bounds, mut kept, reported) = loop {
        let mut sample = OriginSample::default();
        let (mut taken, mut bounds) = (vec![0; inputs.len()], None);
        let mut kept = options.decimate.map(|_| Gaussians { sh_degree, ..Default::default() });
        let reported = read(to, &mut |index, block| {
            taken[index] += block.len() as u64;
            bounds = around(bounds, block.bounds());
            sample.add(&block, step);
            if let Some(kept) = &mut kept {
                kept.append(&block);
            }
            Ok(())
        })?;
        let chosen = if is_same || are_parts { to } else { sample.origin(to) };
        if chosen == to {
            break (taken, bounds, kept, reported);
        }
        // Reads again, for the box relative to the new origin.
        to = chosen;
    };
    warnings.extend(reported);
    let mut count = taken.iter().sum::<u64>();
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
    let unit = |index: usize| Some(headers[index].unit? * changes[index].1.scale);
    let unit = unit(0).filter(|own| (1..inputs.len()).all(|index| unit(index) == Some(*own)));
    let frame = WorldFrame { origin: to, unit: unit.unwrap_or(1.0) };
    let double_positions = headers.iter().any(|header| header.double_positions) && format == Format::Ply;
    let options = WriteOptions { format: Some(format), spz_version: options.spz_version, frame, ..marks };
    let outline = Outline { count, sh_degree, options, bounds, double_positions };
    // Positions in double precision are absolute.
    warnings.extend(format.origin_note(output, to).filter(|_| !double_positions));
    stream::check_origin(output, to)?;
    let loss = write_blocks(output, format, &outline, &mut |sink| {
        let mut sink = |block: Gaussians| {
            stream::check_readable(output, &block)?;
            sink(block)
        };
        match kept.take() {
            Some(all) => sink(all),
            None => read(to, &mut |_, block| sink(block)).map(drop),
        }
    })?;
    warnings.extend(loss);
    Ok(Converted { inputs: headers, format, written: count, taken, sh_degree, warnings })
}

impl ConvertOptions {
    /// The cut, with the box given in source coordinates if there is one, relative to the input's origin.
    fn cut_of(&self, header: &Header) -> Cut {
        let relative = |corner: DVec3| (corner - header.origin).as_vec3();
        let corners = self.crop_box.map(|[one, other]| Bounds::between(relative(one), relative(other)));
        Cut { bounds: corners.or(self.cut.bounds), ..self.cut }
    }
}

/// A similarity of source coordinates for positions relative to `from`, with the result relative to `to`.
fn relative(similarity: &Similarity, from: DVec3, to: DVec3) -> Similarity {
    // Exact without an origin.
    let moved = if from == DVec3::ZERO { similarity.translation } else { similarity.apply(from) };
    Similarity { translation: moved - to, ..*similarity }
}

/// Most attempts to choose an origin: rounding may move it between two.
const ATTEMPTS: usize = 3;

/// Moves a scene in memory by a similarity of source coordinates, and chooses its origin, both as [`convert()`] does. The unit stays.
pub fn place(gaussians: &mut Gaussians, frame: &mut WorldFrame, similarity: &Similarity) {
    let (from, unit) = (frame.origin, frame.unit);
    let step = OriginSample::step(gaussians.len() as u64);
    let sampled = gaussians.select(&(0..gaussians.len()).step_by(step).collect::<Vec<_>>()).with_sh_degree(0);
    frame.origin = if from == DVec3::ZERO { DVec3::ZERO } else { similarity.apply(from) };
    for _ in 0..ATTEMPTS {
        let mut in_source = sampled.clone();
        let moved = relative(similarity, from, frame.origin);
        in_source.transform(&Similarity { scale: moved.scale * unit, ..moved });
        let mut sample = OriginSample::default();
        sample.add(&in_source, 1);
        let chosen = sample.origin(frame.origin);
        if chosen == frame.origin || !chosen.is_finite() {
            break;
        }
        frame.origin = chosen;
    }
    let moved = relative(similarity, from, frame.origin);
    gaussians.transform(&Similarity { translation: moved.translation / unit, ..moved });
}

/// A sample of the Gaussians, from which a scene's origin is chosen.
#[derive(Default)]
pub(crate) struct OriginSample {
    means: Vec<Vec3>,
    /// Largest standard deviation of each.
    sizes: Vec<f32>,
}

impl OriginSample {
    /// Stride that samples enough of a scene's Gaussians.
    pub(crate) fn step(count: u64) -> usize {
        count.div_ceil(ORIGIN_SAMPLE).max(1) as usize
    }

    pub(crate) fn add(&mut self, block: &Gaussians, step: usize) {
        self.means.extend(block.means.iter().step_by(step).map(|&mean| Vec3::from_array(mean)));
        let largest = |[x, y, z]: &[f32; 3]| x.max(*y).max(*z).exp();
        self.sizes.extend(block.log_scales.iter().step_by(step).map(largest));
    }

    /// The scene's origin, for positions relative to `from`; zero if single precision resolves absolute ones well.
    pub(crate) fn origin(mut self, from: DVec3) -> DVec3 {
        let points: Vec<DVec3> = self.means.iter().map(|mean| from + mean.as_dvec3()).collect();
        let middle = self.sizes.len() / 2;
        if self.sizes.is_empty() {
            return DVec3::ZERO;
        }
        let size = f64::from(*self.sizes.select_nth_unstable_by(middle, f32::total_cmp).1);
        let origin = WorldFrame::around(&points).origin;
        let step = origin.abs().max_element() * f64::from(f32::EPSILON);
        if step > COARSE * size { origin } else { DVec3::ZERO }
    }
}

fn changed(mut block: Gaussians, sh_degree: u32, cut: &Cut, similarity: &Similarity) -> Gaussians {
    if sh_degree != block.sh_degree {
        block = block.with_sh_degree(sh_degree);
    }
    if *cut != Cut::default() {
        let limits = cut.limits();
        block.retain(|all, index| limits.keeps(all, index));
    }
    block.transform(similarity);
    block
}

fn around(a: Option<Bounds>, b: Option<Bounds>) -> Option<Bounds> {
    Bounds::of(a.into_iter().chain(b).flat_map(|bounds| [bounds.min, bounds.max]))
}
