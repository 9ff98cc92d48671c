//! SOG (PlayCanvas): attributes as the bytes of lossless WebP pictures, with codebooks. Reads versions 1 and 2, bundled in a
//! ZIP (`.sog`) or beside their `meta.json`; writes version 2.
//!
//! Format: developer.playcanvas.com, "The SOG Format". Pixel `i` of each picture, row by row, belongs to Gaussian `i`.

use std::io::{BufReader, Cursor, Read, Write};
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

use image::{ImageFormat, ImageReader, Limits};
use serde::{Deserialize, Serialize};
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipArchive, ZipWriter};

use super::codebook::{LEVELS, Palette, scalar_codebook};
use super::format::read_origin;
use super::{BLOCK, Format, Header, Outline, Produce, Sink, Source, row_bytes, spz};
use crate::ply::morton_order;
use crate::regular_file::{self, OnFile};
use crate::{atomic, cost, host_memory};
use ashsplat::scene::gaussians::sh_coefficients;
use ashsplat::scene::{Bounds, Gaussians};
use ashsplat::{Error, Result};

/// Name of the description, in the ZIP or in the folder.
pub(super) const META: &str = "meta.json";
/// Largest description, bytes: three codebooks of 256 numbers take 16 KB.
const MOST_META_BYTES: u64 = 1 << 20;
/// Largest number of pixels of a picture beyond those of its Gaussians.
const SPARE_PIXELS: u64 = 1 << 16;
/// SH vectors in a row of the palette's picture.
const PALETTE_COLUMNS: usize = 64;
/// Largest number of SH vectors: an index has 16 bits.
const MOST_VECTORS: usize = 1 << 16;
/// Alpha of a quaternion whose w is omitted; x, y and z follow.
const OMITS_W: u8 = 252;
/// Least distance of a stored opacity from 0 and 1, whose logits are infinite.
const OPACITY_MARGIN: f64 = 1e-6;
const VERSION: u32 = 2;

/// `meta.json` of both versions.
#[derive(Deserialize, Serialize)]
struct Meta {
    /// Version 1 has no number.
    #[serde(default = "first_version")]
    version: u32,
    #[serde(default)]
    count: u64,
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
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    codebook: Vec<f32>,
    files: Vec<String>,
}

/// Version 1 has a single number for all higher SH coefficients.
#[derive(Deserialize, Serialize)]
#[serde(untagged)]
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
pub(super) struct Sog {
    path: PathBuf,
    meta: Meta,
    header: Header,
}

/// A decoded picture.
struct Decoded {
    columns: usize,
    /// RGBA of each pixel, row by row.
    pixels: Vec<[u8; 4]>,
}

impl Sog {
    pub(super) fn open(path: &Path) -> Result<Self> {
        let text = member(path, META, MOST_META_BYTES)?;
        regular_file::check_json(path, &text, None)?;
        let meta: Meta = serde_json::from_slice(&text).map_err(|e| damaged(path, format!("{META}: {e}")))?;
        if !(1..=VERSION).contains(&meta.version) {
            let problem = format!("is SOG version {}; 1 and 2 are known", meta.version);
            return Err(Error::input(path, problem, "write it again as version 2"));
        }
        let count =
            if meta.version == 1 { meta.means.shape.first().copied().unwrap_or(0) } else { meta.count };
        let sh_degree = meta.higher.as_ref().map_or(Ok(0), |palette| degree(path, palette))?;
        let mut header = Header::new(Format::Sog, count, sh_degree);
        header.antialiased = meta.antialias;
        header.origin = read_origin(path)?;
        let mut sog = Self { path: path.to_owned(), meta, header };
        sog.header.warnings = sog.lossy()?;
        Ok(sog)
    }

    /// Warns about pictures whose bytes are not those that were written.
    fn lossy(&self) -> Result<Vec<String>> {
        let Meta { means, scales, quats, sh0, higher, .. } = &self.meta;
        let mut lossy = Vec::new();
        for name in
            [means, scales, quats, sh0].into_iter().chain(higher).flat_map(|attribute| &attribute.files)
        {
            let picture = member(&self.path, name, self.most_bytes())?;
            if picture.starts_with(b"\xff\xd8\xff") || picture.get(12..16) == Some(b"VP8 ") {
                lossy.push(format!(
                    "{name} was packed with losses, so that its values are wrong: write the SOG again"
                ));
            }
        }
        Ok(lossy)
    }

    /// Largest packed picture. Bytes that do not compress take as much as pixels.
    fn most_bytes(&self) -> u64 {
        8 * (self.header.count + SPARE_PIXELS) + 4 * (MOST_VECTORS * 16) as u64
    }

    fn damaged(&self, problem: impl Into<String>) -> Error {
        damaged(&self.path, problem)
    }

    /// Decodes a picture with a number of pixels in `fitting`.
    fn pixels(&self, attribute: &Attribute, index: usize, fitting: RangeInclusive<u64>) -> Result<Decoded> {
        let name =
            attribute.files.get(index).ok_or_else(|| self.damaged(format!("{META} names too few files")))?;
        let bad = |e: &dyn std::fmt::Display| self.damaged(format!("{name}: {e}"));
        let packed = member(&self.path, name, self.most_bytes())?;
        let reader = || ImageReader::new(Cursor::new(&packed)).with_guessed_format().map_err(|e| bad(&e));
        if !matches!(reader()?.format(), Some(ImageFormat::WebP | ImageFormat::Png)) {
            return Err(bad(&"is no WebP"));
        }
        let (columns, rows) = reader()?.into_dimensions().map_err(|e| bad(&e))?;
        let pixels = u64::from(columns) * u64::from(rows);
        if !fitting.contains(&pixels) {
            let least = fitting.start();
            return Err(bad(&format!("has {columns}x{rows} pixels, where {least} are needed")));
        }
        host_memory::check(&self.path, 16 * pixels, None)?;
        let mut reader = reader()?;
        let mut limits = Limits::default();
        limits.max_alloc = Some(64 * pixels + (1 << 20));
        reader.limits(limits);
        let decoded = reader.decode().map_err(|e| bad(&e))?.into_rgba8();
        cost::steps(pixels as usize);
        Ok(Decoded { columns: columns as usize, pixels: decoded.into_raw().as_chunks().0.to_vec() })
    }

    /// The 256 values of one channel: a codebook, or equal steps of version 1.
    fn levels(&self, (name, attribute): (&str, &Attribute), channel: usize) -> Result<[f32; LEVELS]> {
        let book = &attribute.codebook;
        if self.meta.version == 1 {
            let (min, max) = self.range((name, attribute), channel)?;
            return Ok(std::array::from_fn(|i| (min + (max - min) * i as f64 / 255.0) as f32));
        }
        // Writers that find fewer values may end the list there; an index beyond it stands for the last one.
        let last = book.last().ok_or_else(|| self.damaged(format!("{META}: {name} has no codebook")))?;
        Ok(std::array::from_fn(|i| *book.get(i).unwrap_or(last)))
    }

    fn range(&self, (name, attribute): (&str, &Attribute), channel: usize) -> Result<(f64, f64)> {
        let ends = attribute.mins.at(channel).zip(attribute.maxs.at(channel));
        ends.ok_or_else(|| self.damaged(format!("{META}: {name} has no mins and maxs")))
    }
}

impl Source for Sog {
    fn header(&self) -> &Header {
        &self.header
    }

    fn blocks(&mut self, sink: &mut Sink<'_>) -> Result<()> {
        let Meta { version, means, scales, quats, sh0, higher, .. } = &self.meta;
        let (count, sh_degree) = (self.header.count, self.header.sh_degree);
        let each = || count..=2 * count + SPARE_PIXELS;
        let mean_ranges = [0, 1, 2].map(|axis| self.range(("means", means), axis));
        let [x, y, z] = mean_ranges;
        let ranges = [x?, y?, z?];
        let [low, high] = [self.pixels(means, 0, each())?.pixels, self.pixels(means, 1, each())?.pixels];
        let scale_levels = [0, 1, 2].map(|axis| self.levels(("scales", scales), axis));
        let [x, y, z] = scale_levels;
        let scale_levels = [x?, y?, z?];
        let scales = self.pixels(scales, 0, each())?.pixels;
        let quats = self.pixels(quats, 0, each())?.pixels;
        let [r, g, b] = [0, 1, 2].map(|channel| self.levels(("sh0", sh0), channel));
        let color_levels = [r?, g?, b?];
        let logits = match version {
            1 => self.levels(("sh0", sh0), 3)?,
            _ => std::array::from_fn(|i| {
                let opacity = (i as f64 / 255.0).clamp(OPACITY_MARGIN, 1.0 - OPACITY_MARGIN);
                (opacity / (1.0 - opacity)).ln() as f32
            }),
        };
        let sh0 = self.pixels(sh0, 0, each())?.pixels;
        let coefficients = sh_coefficients(sh_degree) - 1;
        let (palette, columns, labels) = match higher {
            None => (Vec::new(), 0, Vec::new()),
            Some(higher) => {
                let levels = self.levels(("shN", higher), 0)?;
                let row = (PALETTE_COLUMNS * coefficients) as u64;
                // Version 1 does not say how many there are. A label beyond them is found below.
                let least = higher.count.unwrap_or(1).div_ceil(PALETTE_COLUMNS) as u64 * row;
                let most = (MOST_VECTORS * coefficients) as u64;
                let Decoded { columns, pixels } = self.pixels(higher, 0, least..=most)?;
                let value = |[r, g, b, _]: [u8; 4]| [r, g, b].map(|byte| levels[usize::from(byte)]);
                (pixels.into_iter().map(value).collect(), columns, self.pixels(higher, 1, each())?.pixels)
            }
        };
        let sh_of = |label: [u8; 4]| {
            let vector = usize::from(u16::from_le_bytes([label[0], label[1]]));
            let first = vector / PALETTE_COLUMNS * columns + vector % PALETTE_COLUMNS * coefficients;
            let found: Option<&[[f32; 3]]> = palette.get(first..first + coefficients);
            found.ok_or_else(|| self.damaged("an index lies beyond the palette of spherical harmonics"))
        };
        for start in (0..count as usize).step_by(BLOCK) {
            let rows = start..(start + BLOCK).min(count as usize);
            let mut block = Gaussians::with_capacity(sh_degree, rows.len());
            for i in rows {
                block.means.push(std::array::from_fn(|axis| {
                    let share = f64::from(u16::from_le_bytes([low[i][axis], high[i][axis]])) / 65_535.0;
                    let (min, max) = ranges[axis];
                    let logarithm = min + (max - min) * share;
                    (logarithm.abs().exp_m1() * logarithm.signum()) as f32
                }));
                block
                    .log_scales
                    .push(std::array::from_fn(|axis| scale_levels[axis][usize::from(scales[i][axis])]));
                block.quats.push(unpack_rotation(quats[i]));
                block.opacity_logits.push(logits[usize::from(sh0[i][3])]);
                block
                    .sh
                    .push(std::array::from_fn(|channel| color_levels[channel][usize::from(sh0[i][channel])]));
                if let Some(label) = labels.get(i) {
                    block.sh.extend_from_slice(sh_of(*label)?);
                }
            }
            sink(block)?;
        }
        Ok(())
    }
}

/// SH degree of a palette; version 1 tells it by the width of the picture alone.
fn degree(path: &Path, palette: &Attribute) -> Result<u32> {
    let degree = match palette.bands {
        Some(bands) => Some(bands),
        None => {
            let name =
                palette.files.first().ok_or_else(|| damaged(path, format!("{META}: shN names no files")))?;
            let picture = member(path, name, 4 * (MOST_VECTORS * 16) as u64)?;
            let reader = ImageReader::new(Cursor::new(picture)).with_guessed_format();
            let size = reader.ok().and_then(|reader| reader.into_dimensions().ok());
            size.and_then(|(width, _)| {
                (1..=3).find(|&d| width as usize == PALETTE_COLUMNS * (sh_coefficients(d) - 1))
            })
        }
    };
    degree
        .filter(|degree| (1..=3).contains(degree))
        .ok_or_else(|| damaged(path, format!("{META}: the SH degree is {degree:?}, and may be 1 to 3")))
}

fn damaged(path: &Path, problem: impl Into<String>) -> Error {
    Error::input(path, problem, "the file is damaged or cut short: write or download it again")
}

/// Reads a file of the ZIP, or of the folder.
fn member(path: &Path, name: &str, most: u64) -> Result<Vec<u8>> {
    if path.file_name().is_some_and(|own| own == META) {
        let place = match Path::new(name).components().count() {
            1 => path.with_file_name(name),
            _ => return Err(damaged(path, format!("{name:?} does not lie beside it"))),
        };
        return regular_file::read_at_most(&place, most)?
            .ok_or_else(|| damaged(&place, format!("has more than {most} bytes")));
    }
    let (file, _) = regular_file::open(path)?;
    let mut archive =
        ZipArchive::new(BufReader::new(file)).map_err(|e| damaged(path, format!("is no whole ZIP: {e}")))?;
    let found = (0..archive.len()).find(|&index| {
        // Some programs pack the folder itself.
        archive
            .name_for_index(index)
            .and_then(|inside| inside.ok())
            .is_some_and(|inside| inside.rsplit('/').next() == Some(name))
    });
    let missing = || damaged(path, format!("holds no {name}"));
    let mut entry = archive.by_index(found.ok_or_else(missing)?).map_err(|e| damaged(path, e.to_string()))?;
    if entry.size() > most {
        return Err(damaged(path, format!("{name} unpacks to {} bytes", entry.size())));
    }
    let mut bytes = host_memory::reserved(path, entry.size())?;
    entry.by_ref().take(most).read_to_end(&mut bytes).map_err(|e| damaged(path, format!("{name}: {e}")))?;
    Ok(bytes)
}

/// The three smaller components of (w, x, y, z) around 127.5, and the index of the omitted one in alpha.
fn unpack_rotation([a, b, c, omitted]: [u8; 4]) -> [f32; 4] {
    let small = [a, b, c].map(|byte| (f64::from(byte) / 255.0 - 0.5) * std::f64::consts::SQRT_2);
    let largest = (1.0 - small.iter().map(|v| v * v).sum::<f64>()).max(0.0).sqrt();
    let mut small = small.into_iter();
    std::array::from_fn(|i| {
        let component =
            if i == usize::from(omitted.wrapping_sub(OMITS_W)) { Some(largest) } else { small.next() };
        component.unwrap_or(0.0) as f32
    })
}

fn pack_rotation(quat: [f32; 4]) -> [u8; 4] {
    let quat = spz::unit(quat);
    let largest = (1..4).fold(0, |best, i| if quat[i].abs() > quat[best].abs() { i } else { best });
    let sign = quat[largest].signum();
    let mut others = (0..4).filter(|&i| i != largest).map(|i| {
        let share = f64::from(sign * quat[i]) * std::f64::consts::FRAC_1_SQRT_2 + 0.5;
        (255.0 * share).round().clamp(0.0, 255.0) as u8
    });
    let mut next = || others.next().unwrap_or(0);
    [next(), next(), next(), OMITS_W + largest as u8]
}

/// The logarithm that positions are stored as.
fn logarithm(value: f32) -> f64 {
    f64::from(value).abs().ln_1p() * f64::from(value).signum()
}

/// Largest step of the stored logarithms over the three axes.
pub(super) fn log_step(Bounds { min, max }: Bounds) -> f64 {
    let [low, high] = [min, max].map(|corner| corner.to_array().map(logarithm));
    (0..3).map(|axis| (high[axis] - low[axis]) / 65_535.0).fold(0.0, f64::max)
}

/// Writes Gaussians along a space-filling curve, so that their pictures compress well.
pub(super) fn write(path: &Path, outline: &Outline, produce: &mut Produce<'_>) -> Result<()> {
    // Beside the Gaussians: the pictures, sorted values, SH vectors.
    let row = 2 * row_bytes(outline.sh_degree) + 64;
    host_memory::check_writing(path, outline.count.saturating_mul(row))?;
    let mut all = Gaussians { sh_degree: outline.sh_degree, ..Default::default() };
    produce(&mut |block| {
        all.append(&block);
        Ok(())
    })?;
    let members = members(path, &all, outline)?;
    if path.file_name().is_some_and(|name| name == META) {
        // The description comes last, so that it names no file that is missing.
        return members.into_iter().try_for_each(|(name, bytes)| {
            atomic::write(path.with_file_name(name), |writer| writer.write_all(&bytes))
        });
    }
    atomic::write_seekable(path, |writer| {
        let mut archive = ZipWriter::new(writer);
        let stored = SimpleFileOptions::default().compression_method(CompressionMethod::Stored);
        for (name, bytes) in members {
            let put = archive.start_file(name, stored).map_err(std::io::Error::other);
            put.and_then(|()| archive.write_all(&bytes)).writing(path)?;
        }
        archive.finish().map(drop).map_err(std::io::Error::other).writing(path)
    })
}

/// Names and contents of the files, the description last.
fn members(path: &Path, all: &Gaussians, outline: &Outline) -> Result<Vec<(&'static str, Vec<u8>)>> {
    let means: Vec<[f32; 3]> = all.means.clone();
    let order = morton_order(&means);
    let count = order.len();
    let width = ((count as f64).sqrt() / 4.0).ceil().max(1.0) as usize * 4;
    let size = (width, count.div_ceil(width).max(1).next_multiple_of(4));
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
    let half = |at: usize| words.iter().map(|word| word.map(|bytes| bytes[at])).collect::<Vec<_>>();

    let in_order = |values: &[[f32; 3]], stride: usize| -> Vec<f32> {
        order.iter().flat_map(|&i| values[i * stride]).collect()
    };
    let (scale_book, scales) = scalar_codebook(&in_order(&all.log_scales, 1));
    let coefficients = sh_coefficients(all.sh_degree);
    let (color_book, colors) = scalar_codebook(&in_order(&all.sh, coefficients));
    let opacity = |&i: &usize| (255.0 * all.opacity(i)).round() as u8;
    let colors = colors.as_chunks::<3>().0.iter().zip(&order).map(|(&[r, g, b], i)| [r, g, b, opacity(i)]);
    let quats = order.iter().map(|&i| pack_rotation(all.quats[i]));
    let webp = |name: &str, picture: Picture| picture.packed(path, name);
    let mut files = vec![
        ("means_l.webp", webp("means_l.webp", Picture::rgb(&half(0), size))?),
        ("means_u.webp", webp("means_u.webp", Picture::rgb(&half(1), size))?),
        ("scales.webp", webp("scales.webp", Picture::rgb(scales.as_chunks::<3>().0, size))?),
        ("quats.webp", webp("quats.webp", Picture::rgba(quats, size))?),
        ("sh0.webp", webp("sh0.webp", Picture::rgba(colors, size))?),
    ];
    let mut higher = None;
    if coefficients > 1 {
        let vectors: Vec<f32> = order.iter().flat_map(|&i| &all.sh_of(i)[1..]).flatten().copied().collect();
        let Palette { book, vectors, labels } = Palette::of(&vectors, 3 * (coefficients - 1));
        let found = vectors.len() / (3 * (coefficients - 1));
        let rows = found.div_ceil(PALETTE_COLUMNS).max(1);
        let palette = Picture::rgb(vectors.as_chunks::<3>().0, (PALETTE_COLUMNS * (coefficients - 1), rows));
        let labels: Vec<[u8; 3]> =
            labels.iter().map(|label| label.to_le_bytes()).map(|[l, h]| [l, h, 0]).collect();
        files.push(("shN_centroids.webp", webp("shN_centroids.webp", palette)?));
        files.push(("shN_labels.webp", webp("shN_labels.webp", Picture::rgb(&labels, size))?));
        higher = Some(Attribute {
            count: Some(found),
            bands: Some(all.sh_degree),
            codebook: book.to_vec(),
            files: vec!["shN_centroids.webp".into(), "shN_labels.webp".into()],
            ..Default::default()
        });
    }
    let names = |names: &[&str]| names.iter().map(|&name| name.into()).collect::<Vec<String>>();
    let book = |book: [f32; LEVELS], name| Attribute {
        codebook: book.to_vec(),
        files: names(&[name]),
        ..Default::default()
    };
    let finite = |value: f64| if value.is_finite() { value } else { 0.0 };
    let meta = Meta {
        version: VERSION,
        count: count as u64,
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

/// Pixels to be packed. Those after the last value are 0.
struct Picture {
    bytes: Vec<u8>,
    size: (usize, usize),
    channels: usize,
}

impl Picture {
    fn rgb(values: &[[u8; 3]], size: (usize, usize)) -> Self {
        let mut bytes = values.as_flattened().to_vec();
        bytes.resize(3 * size.0 * size.1, 0);
        Self { bytes, size, channels: 3 }
    }

    fn rgba(values: impl Iterator<Item = [u8; 4]>, size: (usize, usize)) -> Self {
        let mut bytes: Vec<u8> = values.flatten().collect();
        bytes.resize(4 * size.0 * size.1, 0);
        Self { bytes, size, channels: 4 }
    }

    fn packed(self, path: &Path, name: &str) -> Result<Vec<u8>> {
        let Self { bytes, size: (width, height), channels } = self;
        if width.max(height) > MOST_SIDE {
            let limit = ((MOST_SIDE * MOST_SIDE) as u64, "the side of a WebP picture");
            return Err(Error::too_large(
                format!("{}: {name}", path.display()),
                ((width * height) as u64, "pixels"),
                limit,
            ));
        }
        let (width, height) = (width as u32, height as u32);
        let encoder = match channels {
            3 => webp::Encoder::from_rgb(&bytes, width, height),
            _ => webp::Encoder::from_rgba(&bytes, width, height),
        };
        Ok(encoder.encode_lossless().to_vec())
    }
}

/// Largest side of a WebP picture.
const MOST_SIDE: usize = 16_383;
