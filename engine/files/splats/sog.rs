//! SOG (PlayCanvas): attributes as the bytes of lossless WebP pictures, with codebooks. Reads versions 1 and 2, bundled in a
//! ZIP (`.sog`) or beside their `meta.json`; writes version 2 in a ZIP.
//!
//! Format: developer.playcanvas.com, "The SOG Format". Pixel `i` of each picture, row by row, belongs to Gaussian `i`.

use std::cell::RefCell;
use std::fs::{self, File};
use std::io::{BufReader, Cursor, Read, Write};
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

use image::{ImageFormat, ImageReader, Limits};
use serde::{Deserialize, Serialize};
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, System, ZipArchive, ZipWriter};

use super::codebook::{LEVELS, Palette, scalar_codebook};
use super::dot_splat::opacity_logit;
use super::format::{META, is_meta};
use super::stream::check_readable;
use super::{Blocks, Format, Header, Opened, Outline, Produce, ReadOptions, Sink, WriteOptions, row_bytes};
use crate::ply::{morton_order, pack_unorm, rotation_of_shares, shares_of_rotation};
use crate::regular_file::{self, OnFile, damaged};
use crate::{atomic, cost, host_memory};
use ashsplat::scene::gaussians::sh_coefficients;
use ashsplat::scene::{Bounds, Gaussians};
use ashsplat::{Error, Result};

/// Largest description, bytes: three codebooks of 256 numbers take 16 KB.
const MAX_META_BYTES: u64 = 1 << 20;
/// Largest number of pixels of a picture beyond those of its Gaussians.
const SPARE_PIXELS: u64 = 1 << 16;
/// SH vectors in a row of the palette's picture.
const PALETTE_COLUMNS: usize = 64;
/// Largest number of SH vectors: an index has 16 bits.
const MAX_VECTORS: usize = 1 << 16;
/// Alpha of a quaternion whose w is omitted; x, y and z follow.
const OMITS_W: u8 = 252;
const MAX_SIDE: usize = 16_383;
const VERSION: u32 = 2;

/// `meta.json` of both versions.
#[derive(Deserialize, Serialize)]
struct Meta {
    /// Version 1 has no number.
    #[serde(default = "first_version")]
    version: u32,
    /// Version 1 has it in the shape of the means.
    #[serde(default)]
    count: Option<u64>,
    #[serde(default)]
    antialias: bool,
    means: Attribute,
    scales: Attribute,
    quats: Attribute,
    sh0: Attribute,
    #[serde(rename = "shN", default, skip_serializing_if = "Option::is_none")]
    higher: Option<Attribute>,
}

fn first_version() -> u32 {
    1
}

#[derive(Default, Deserialize, Serialize)]
struct Attribute {
    /// Number of SH vectors in the palette.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    count: Option<usize>,
    /// SH degree of the palette.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    bands: Option<u32>,
    /// Version 1: the number of Gaussians first.
    #[serde(default, skip_serializing)]
    shape: Vec<u64>,
    #[serde(default, skip_serializing_if = "Numbers::is_empty")]
    mins: Numbers,
    #[serde(default, skip_serializing_if = "Numbers::is_empty")]
    maxs: Numbers,
    /// Some writers left the first value out.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    codebook: Vec<Option<f32>>,
    files: Vec<String>,
}

/// Version 1 has a single number for all higher SH coefficients.
#[derive(Deserialize, Serialize)]
#[serde(untagged, expecting = "expected a number or a list of numbers")]
enum Numbers {
    One(f64),
    Each(Vec<f64>),
}

impl Default for Numbers {
    fn default() -> Self {
        Self::Each(Vec::new())
    }
}

impl Numbers {
    fn is_empty(&self) -> bool {
        matches!(self, Self::Each(all) if all.is_empty())
    }

    fn at(&self, index: usize) -> Option<f64> {
        match self {
            Self::One(number) => Some(*number),
            Self::Each(all) => all.get(index).copied(),
        }
    }
}

/// An open SOG. Its pictures are decoded when the Gaussians are read.
struct Sog {
    members: Members,
    meta: Meta,
    count: u64,
}

/// RGBA of each pixel of a decoded picture, row by row.
type Pixels = Vec<[u8; 4]>;

pub(super) fn open(path: &Path, options: &ReadOptions) -> Result<Opened<'static>> {
    let members = Members::open(path, options)?;
    let text = members.read(META, MAX_META_BYTES)?;
    regular_file::check_json(path, &text, options.max_host_memory)?;
    let meta: Meta = serde_json::from_slice(&text).map_err(|e| damaged(path, format!("{META}: {e}")))?;
    if !(1..=VERSION).contains(&meta.version) {
        let problem = format!("is SOG version {}; 1 and 2 are known", meta.version);
        return Err(Error::input(path, problem, "write it again as version 2"));
    }
    let count = if meta.version == 1 { meta.means.shape.first().copied() } else { meta.count };
    let max_count = (MAX_SIDE * MAX_SIDE) as u64;
    let count = count.filter(|count| *count <= max_count).ok_or_else(|| {
        damaged(path, format!("{META}: the number of Gaussians is missing or above {max_count}"))
    })?;
    let antialiased = meta.antialias;
    let sog = Sog { members, meta, count };
    let sh_degree = sog.degree()?;
    let header = Header { antialiased, ..Header::new(Format::Sog, count, sh_degree) };
    Ok((header, Box::new(move |sink| sog.read(sh_degree, sink))))
}

impl Sog {
    /// SH degree of the palette. Version 1 tells it by the width of the picture alone.
    fn degree(&self) -> Result<u32> {
        let Some(palette) = &self.meta.higher else { return Ok(0) };
        if palette.count.is_some_and(|count| count > MAX_VECTORS) {
            return Err(self.damaged(format!("{META}: shN has more than {MAX_VECTORS} vectors")));
        }
        if let Some(bands) = palette.bands.filter(|bands| (1..=3).contains(bands)) {
            return Ok(bands);
        }
        let (name, packed) = self.packed(palette, 0)?;
        let reader = ImageReader::new(Cursor::new(packed)).with_guessed_format();
        let size = reader.ok().and_then(|reader| reader.into_dimensions().ok());
        let fits = |degree: &u32| size.is_some_and(|(width, _)| width as usize == palette_width(*degree));
        let degree = (1..=3).find(fits).filter(|_| palette.bands.is_none());
        degree.ok_or_else(|| self.damaged(format!("{META}: shN has no SH degree from 1 to 3 for {name}")))
    }

    /// Name and packed bytes of a picture. Pixels that do not compress take as much as they are.
    fn packed<'a>(&self, attribute: &'a Attribute, index: usize) -> Result<(&'a str, Vec<u8>)> {
        let name =
            attribute.files.get(index).ok_or_else(|| self.damaged(format!("{META} names too few files")))?;
        let max_bytes = 8 * (self.count + SPARE_PIXELS) + 4 * (MAX_VECTORS * 16) as u64;
        Ok((name, self.members.read(name, max_bytes)?))
    }

    fn damaged(&self, problem: impl Into<String>) -> Error {
        damaged(&self.members.path, problem)
    }

    /// Decodes a picture with a number of pixels in `fitting`, and its number of columns.
    fn decoded(
        &self,
        attribute: &Attribute,
        index: usize,
        fitting: RangeInclusive<u64>,
    ) -> Result<(usize, Pixels)> {
        let (name, packed) = self.packed(attribute, index)?;
        let bad = |e: &dyn std::fmt::Display| self.damaged(format!("{name}: {e}"));
        if is_lossy(&packed) {
            let problem = format!("{name} was packed with losses, so that its values are wrong");
            return Err(Error::input(&self.members.path, problem, "write the SOG again, with lossless WebP"));
        }
        let reader = || ImageReader::new(Cursor::new(&packed)).with_guessed_format().map_err(|e| bad(&e));
        if !matches!(reader()?.format(), Some(ImageFormat::WebP | ImageFormat::Png)) {
            return Err(bad(&"is no WebP"));
        }
        let (columns, rows) = reader()?.into_dimensions().map_err(|e| bad(&e))?;
        let pixels = u64::from(columns) * u64::from(rows);
        if !fitting.contains(&pixels) {
            let needed = fitting.start();
            return Err(bad(&format!("has {columns}x{rows} pixels, where {needed} are needed")));
        }
        // The decoder's pixels, and ours.
        self.members.check_memory(16 * pixels)?;
        let mut reader = reader()?;
        let mut limits = Limits::default();
        limits.max_alloc = Some(64 * pixels + (1 << 20));
        reader.limits(limits);
        let decoded = reader.decode().map_err(|e| bad(&e))?.into_rgba8();
        cost::steps(pixels as usize);
        Ok((columns as usize, decoded.into_raw().as_chunks().0.to_vec()))
    }

    /// The 256 values of one channel: a codebook, or equal steps of version 1.
    fn levels(&self, (name, attribute): (&str, &Attribute), channel: usize) -> Result<[f32; LEVELS]> {
        let book = &attribute.codebook;
        if self.meta.version == 1 {
            let (min, max) = self.range((name, attribute), channel)?;
            return Ok(std::array::from_fn(|i| (min + (max - min) * i as f64 / 255.0) as f32));
        }
        // A writer that finds fewer values may end the list there.
        let at = |i: usize| book.get(i.min(book.len().saturating_sub(1))).copied().flatten();
        // PlayCanvas' own reader repairs a first value that is missing in this way.
        let first = || at(0).or_else(|| Some(at(1)? + (at(1)? - at(255)?) / 255.0));
        let value = |i: usize| if i == 0 { first() } else { at(i) };
        let bad = || self.damaged(format!("{META}: {name} has no whole codebook"));
        (0..LEVELS).all(|i| value(i).is_some()).then_some(()).ok_or_else(bad)?;
        Ok(std::array::from_fn(|i| value(i).unwrap_or_default()))
    }

    fn range(&self, (name, attribute): (&str, &Attribute), channel: usize) -> Result<(f64, f64)> {
        let ends = attribute.mins.at(channel).zip(attribute.maxs.at(channel));
        ends.ok_or_else(|| self.damaged(format!("{META}: {name} has no mins and maxs")))
    }

    fn read(&self, sh_degree: u32, sink: &mut Sink<'_>) -> Result<()> {
        let Meta { version, means, scales, quats, sh0, higher, .. } = &self.meta;
        let count = self.count;
        let pixels = |attribute, index| {
            Ok::<_, Error>(self.decoded(attribute, index, count..=2 * count + SPARE_PIXELS)?.1)
        };
        // Six pictures beside the one that is decoded.
        self.members.check_memory(24 * count)?;
        let ranges = each_channel(|axis| self.range(("means", means), axis))?;
        let [low, high] = [pixels(means, 0)?, pixels(means, 1)?];
        let scale_levels = each_channel(|axis| self.levels(("scales", scales), axis))?;
        let scales = pixels(scales, 0)?;
        let quats = pixels(quats, 0)?;
        let color_levels = each_channel(|channel| self.levels(("sh0", sh0), channel))?;
        let logits = match version {
            1 => self.levels(("sh0", sh0), 3)?,
            _ => std::array::from_fn(|i| opacity_logit(i as u8)),
        };
        let sh0 = pixels(sh0, 0)?;
        let coefficients = sh_coefficients(sh_degree) - 1;
        let (palette, labels) = match higher {
            None => (Vec::new(), Vec::new()),
            Some(higher) => {
                let levels = self.levels(("shN", higher), 0)?;
                let width = palette_width(sh_degree);
                // Version 1 does not say how many there are. A label beyond them is found below.
                let needed = higher.count.unwrap_or(1).div_ceil(PALETTE_COLUMNS) * width;
                let fitting = needed as u64..=(MAX_VECTORS * coefficients) as u64;
                let (columns, vectors) = self.decoded(higher, 0, fitting)?;
                if columns != width {
                    return Err(
                        self.damaged(format!("the palette of shN has {columns} columns instead of {width}"))
                    );
                }
                let value = |[r, g, b, _]: [u8; 4]| [r, g, b].map(|byte| levels[usize::from(byte)]);
                (vectors.into_iter().map(value).collect(), pixels(higher, 1)?)
            }
        };
        let sh_of = |label: [u8; 4]| {
            let first = usize::from(u16::from_le_bytes([label[0], label[1]])) * coefficients;
            let found: Option<&[[f32; 3]]> = palette.get(first..first + coefficients);
            found.ok_or_else(|| self.damaged("an index lies beyond the palette of spherical harmonics"))
        };
        let mut blocks = Blocks::new(sh_degree, count, sink);
        for i in 0..count as usize {
            let block = blocks.next()?;
            block.means.push(std::array::from_fn(|axis| {
                let share = f64::from(u16::from_le_bytes([low[i][axis], high[i][axis]])) / 65_535.0;
                let (min, max) = ranges[axis];
                let logarithm = min + (max - min) * share;
                (libm::expm1(logarithm.abs()) * logarithm.signum()) as f32
            }));
            let level = |levels: &[[f32; LEVELS]; 3], pixel: [u8; 4]| -> [f32; 3] {
                std::array::from_fn(|channel| levels[channel][usize::from(pixel[channel])])
            };
            block.log_scales.push(level(&scale_levels, scales[i]));
            let no_index =
                || self.damaged(format!("the quaternion of Gaussian {i} does not say what it omits"));
            block.quats.push(unpack_rotation(quats[i]).ok_or_else(no_index)?);
            block.opacity_logits.push(logits[usize::from(sh0[i][3])]);
            block.sh.push(level(&color_levels, sh0[i]));
            if let Some(label) = labels.get(i) {
                block.sh.extend_from_slice(sh_of(*label)?);
            }
        }
        blocks.finish()
    }
}

fn each_channel<T>(value: impl Fn(usize) -> Result<T>) -> Result<[T; 3]> {
    Ok([value(0)?, value(1)?, value(2)?])
}

fn palette_width(sh_degree: u32) -> usize {
    PALETTE_COLUMNS * (sh_coefficients(sh_degree) - 1)
}

/// True for a WebP with a lossy chunk, also behind others.
fn is_lossy(packed: &[u8]) -> bool {
    let mut at = 12;
    while let Some(chunk) = packed.get(at..at + 8).filter(|_| packed.starts_with(b"RIFF")) {
        if chunk.starts_with(b"VP8 ") {
            return true;
        }
        at = at.saturating_add(8).saturating_add(regular_file::u32_at(chunk, 4).next_multiple_of(2) as usize);
    }
    false
}

/// Files of a SOG: those of its ZIP, or those beside its description.
struct Members {
    path: PathBuf,
    archive: Option<RefCell<ZipArchive<BufReader<File>>>>,
    max_host_memory: Option<u64>,
}

impl Members {
    fn open(path: &Path, options: &ReadOptions) -> Result<Self> {
        let archive = match is_meta(path) {
            true => None,
            false => {
                let archive = ZipArchive::new(BufReader::new(regular_file::open(path)?.0));
                let archive = archive.map_err(|e| damaged(path, format!("is no whole ZIP: {e}")))?;
                Some(RefCell::new(archive))
            }
        };
        Ok(Self { path: path.to_owned(), archive, max_host_memory: options.max_host_memory })
    }

    fn check_memory(&self, bytes: u64) -> Result<()> {
        host_memory::check(&self.path, bytes, self.max_host_memory)
    }

    /// Reads a file of at most these bytes, within the memory budget.
    fn read(&self, name: &str, max_bytes: u64) -> Result<Vec<u8>> {
        let path = &self.path;
        let Some(archive) = &self.archive else {
            let place = match Path::new(name).components().count() {
                _ if name == META => path.to_owned(),
                1 => path.with_file_name(name),
                _ => return Err(damaged(path, format!("{name:?} does not lie beside it"))),
            };
            host_memory::check(&place, regular_file::open(&place)?.1.min(max_bytes), self.max_host_memory)?;
            return regular_file::read_at_most(&place, max_bytes)?
                .ok_or_else(|| damaged(&place, format!("has more than {max_bytes} bytes")));
        };
        let mut archive = archive.borrow_mut();
        let found = (0..archive.len()).find(|&index| {
            // Some programs pack the folder itself.
            let inside = archive.name_for_index(index).and_then(|inside| inside.ok());
            inside.is_some_and(|inside| inside.rsplit('/').next() == Some(name))
        });
        let missing = || damaged(path, format!("holds no {name}"));
        let entry = archive.by_index(found.ok_or_else(missing)?).map_err(|e| damaged(path, e.to_string()))?;
        if entry.size() > max_bytes {
            return Err(damaged(path, format!("{name} unpacks to {} bytes", entry.size())));
        }
        self.check_memory(entry.size())?;
        let mut bytes = host_memory::reserved(path, entry.size())?;
        entry.take(max_bytes).read_to_end(&mut bytes).map_err(|e| damaged(path, format!("{name}: {e}")))?;
        Ok(bytes)
    }
}

/// The three smaller components of (w, x, y, z), and the index of the omitted one in alpha. `None` for another alpha.
fn unpack_rotation([a, b, c, omitted]: [u8; 4]) -> Option<[f32; 4]> {
    let omitted = usize::from(omitted.checked_sub(OMITS_W)?);
    Some(rotation_of_shares(omitted, [a, b, c].map(|byte| f64::from(byte) / 255.0)))
}

fn pack_rotation(quat: [f32; 4]) -> [u8; 4] {
    let (omitted, shares) = shares_of_rotation(quat);
    let [a, b, c] = shares.map(|share| pack_unorm(share, 8) as u8);
    [a, b, c, OMITS_W + omitted as u8]
}

fn logarithm(value: f32) -> f64 {
    libm::log1p(f64::from(value).abs()) * f64::from(value).signum()
}

/// Largest step of the stored logarithms over the three axes.
pub(super) fn log_step(Bounds { min, max }: Bounds) -> f64 {
    let [low, high] = [min, max].map(|corner| corner.to_array().map(logarithm));
    (0..3).map(|axis| (high[axis] - low[axis]) / 65_535.0).fold(0.0, f64::max)
}

/// Writes Gaussians along a space-filling curve, so that their pictures compress well.
pub(super) fn write(path: &Path, outline: &Outline, produce: &mut Produce<'_>) -> Result<()> {
    // Beside the Gaussians: the pictures, sorted values, SH vectors.
    let all = outline.in_memory(path, row_bytes(outline.sh_degree) + 64, produce)?;
    let members = members(path, &all, &morton_order(&all.means), outline)?;
    atomic::write_seekable(path, |writer| {
        let mut archive = ZipWriter::new(writer);
        // By default an archive names the system that wrote it, and its bytes would differ between systems.
        let stored =
            SimpleFileOptions::default().compression_method(CompressionMethod::Stored).system(System::Unix);
        for (name, bytes) in members {
            let put = archive.start_file(name, stored).map_err(std::io::Error::other);
            put.and_then(|()| archive.write_all(&bytes)).writing(path)?;
        }
        archive.finish().map(drop).map_err(std::io::Error::other).writing(path)
    })
}

/// Writes Gaussians in this order into a new folder, as a description and the pictures beside it.
pub(crate) fn write_folder(
    folder: &Path,
    all: &Gaussians,
    order: &[usize],
    options: &WriteOptions,
) -> Result<()> {
    check_readable(folder, all)?;
    fs::create_dir(folder).on(folder, "create")?;
    for (name, bytes) in members(folder, all, order, &Outline::of(all, options))? {
        let path = folder.join(name);
        fs::write(&path, bytes).writing(&path)?;
    }
    Ok(())
}

/// Names and contents of the files, the description last. `order` has an index of each Gaussian.
fn members(
    path: &Path,
    all: &Gaussians,
    order: &[usize],
    outline: &Outline,
) -> Result<Vec<(&'static str, Vec<u8>)>> {
    let count = order.len();
    let width = ((count as f64).sqrt() / 4.0).ceil().max(1.0) as usize * 4;
    let size = (width, count.div_ceil(width).max(1).next_multiple_of(4));
    if width > MAX_SIDE {
        let limit = ((MAX_SIDE * MAX_SIDE) as u64, "the side of a WebP picture");
        return Err(Error::too_large(
            format!("{}: a SOG", path.display()),
            (count as u64, "Gaussians"),
            limit,
        ));
    }
    let logs: Vec<[f64; 3]> = order.iter().map(|&i| all.means[i].map(logarithm)).collect();
    let ends = |axis: usize| {
        logs.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(min, max), log| {
            (min.min(log[axis]), max.max(log[axis]))
        })
    };
    let ranges = [0, 1, 2].map(ends);
    let words = logs.iter().map(|log| -> [[u8; 2]; 3] {
        std::array::from_fn(|axis| {
            let (min, max) = ranges[axis];
            let share = if max > min { (log[axis] - min) / (max - min) } else { 0.0 };
            ((65_535.0 * share).round() as u16).to_le_bytes()
        })
    });
    let words: Vec<[[u8; 2]; 3]> = words.collect();
    let half = |at: usize| words.iter().map(move |word| word.map(|bytes| bytes[at]));

    let in_order = |values: &[[f32; 3]], stride: usize| -> Vec<f32> {
        order.iter().flat_map(|&i| values[i * stride]).collect()
    };
    let (scale_book, scales) = scalar_codebook(&in_order(&all.log_scales, 1));
    let coefficients = sh_coefficients(all.sh_degree);
    let (color_book, colors) = scalar_codebook(&in_order(&all.sh, coefficients));
    let opacity = |&i: &usize| (255.0 * all.opacity(i)).round() as u8;
    let triples = |bytes: &[u8]| bytes.as_chunks::<3>().0.to_vec();
    let colors = triples(&colors).into_iter().zip(order).map(|([r, g, b], i)| [r, g, b, opacity(i)]);
    let quats = order.iter().map(|&i| pack_rotation(all.quats[i]));
    let mut files = vec![
        ("means_l.webp", picture(half(0), size)),
        ("means_u.webp", picture(half(1), size)),
        ("scales.webp", picture(triples(&scales), size)),
        ("quats.webp", picture(quats, size)),
        ("sh0.webp", picture(colors, size)),
    ];
    let mut higher = None;
    if coefficients > 1 {
        let vectors: Vec<f32> = order.iter().flat_map(|&i| &all.sh_of(i)[1..]).flatten().copied().collect();
        let Palette { book, vectors, labels } = Palette::of(&vectors, 3 * (coefficients - 1));
        let found = vectors.len() / (3 * (coefficients - 1));
        let palette = (palette_width(all.sh_degree), found.div_ceil(PALETTE_COLUMNS).max(1));
        let labels = labels.iter().map(|label| label.to_le_bytes()).map(|[l, h]| [l, h, 0]);
        files.push(("shN_centroids.webp", picture(triples(&vectors), palette)));
        files.push(("shN_labels.webp", picture(labels, size)));
        higher = Some(Attribute {
            count: Some(found),
            bands: Some(all.sh_degree),
            codebook: book.map(Some).to_vec(),
            files: vec!["shN_centroids.webp".into(), "shN_labels.webp".into()],
            ..Default::default()
        });
    }
    let names = |names: &[&str]| names.iter().map(|&name| name.into()).collect::<Vec<String>>();
    let book = |book: [f32; LEVELS], name| Attribute {
        codebook: book.map(Some).to_vec(),
        files: names(&[name]),
        ..Default::default()
    };
    let finite = |value: f64| if value.is_finite() { value } else { 0.0 };
    let meta = Meta {
        version: VERSION,
        count: Some(count as u64),
        antialias: outline.options.antialiased,
        means: Attribute {
            mins: Numbers::Each(ranges.iter().map(|range| finite(range.0)).collect()),
            maxs: Numbers::Each(ranges.iter().map(|range| finite(range.1)).collect()),
            files: names(&["means_l.webp", "means_u.webp"]),
            ..Default::default()
        },
        scales: book(scale_book, "scales.webp"),
        quats: Attribute { files: names(&["quats.webp"]), ..Default::default() },
        sh0: book(color_book, "sh0.webp"),
        higher,
    };
    files.push((META, serde_json::to_vec(&meta).map_err(std::io::Error::from).writing(path)?));
    Ok(files)
}

/// Packs pixels of r, g, b or r, g, b, a without loss. Those after the last value are 0.
fn picture<const N: usize>(
    pixels: impl IntoIterator<Item = [u8; N]>,
    (width, height): (usize, usize),
) -> Vec<u8> {
    let mut bytes: Vec<u8> = pixels.into_iter().flatten().collect();
    bytes.resize(N * width * height, 0);
    let layout = if N == 3 { webp::PixelLayout::Rgb } else { webp::PixelLayout::Rgba };
    webp::Encoder::new(&bytes, layout, width as u32, height as u32).encode_lossless().to_vec()
}
