//! Reads and writes OpenUSD's text (`.usda`): prims of the schema `ParticleField3DGaussianSplat`.
//!
//! Schema: github.com/PixarAnimationStudios/OpenUSD, `pxr/usd/usdVol/schema.usda`, since version 26.03. Sizes are standard
//! deviations, opacities are 0 to 1, quaternions w, x, y, z. Axes are glTF's, or z points up, as the stage says.

use std::collections::BTreeMap;
use std::f64::consts::FRAC_PI_2;
use std::io;
use std::ops::Range;
use std::path::Path;

use glam::{DMat4, DQuat, DVec3};

use super::gltf::{MIRRORED, mirrored, opacity_logit, origin_of, placed, similarity};
use super::{Blocks, Format, Header, Opened, Outline, Produce, ReadOptions, Sink, spz};
use crate::regular_file::{self, damaged};
use crate::{atomic, cost, host_memory};
use ashsplat::scene::Similarity;
use ashsplat::scene::gaussians::{MAX_SH_DEGREE, sh_coefficients};
use ashsplat::scene::sh::rgb_to_sh_dc;
use ashsplat::{Error, Result};

const PRIM: &str = "ParticleField3DGaussianSplat";
const DEGREE: &str = "radiance:sphericalHarmonicsDegree";
/// Type, name and numbers of an element of each array. Half precision has the same name with an h behind it.
const ARRAYS: [(&str, &str, usize); 5] = [
    ("point3f[]", "positions", 3),
    ("quatf[]", "orientations", 4),
    ("float3[]", "scales", 3),
    ("float[]", "opacities", 1),
    ("float3[]", "radiance:sphericalHarmonicsCoefficients", 3),
];
/// Host memory of a prim.
const PRIM_BYTES: usize = size_of::<Prim>() + 64;
const MAX_OPS: usize = 64;
/// Highest SH degree that is skipped rather than refused.
const MAX_DEGREES: u32 = 10;
/// Standard deviations of a Gaussian that lie within the extent.
const REACH: f32 = 3.0;

struct Part {
    placement: Similarity,
    count: usize,
    /// Stored degree, and the one that is read.
    sh_degrees: [u32; 2],
    /// Places of the arrays in the text; `None` for the schema's default.
    arrays: [Option<Range<usize>>; 5],
}

pub(super) fn open(path: &Path, options: &ReadOptions) -> Result<Opened<'static>> {
    host_memory::check(path, regular_file::open(path)?.1, options.max_host_memory)?;
    let mut text = regular_file::read(path, 1)?;
    if text.starts_with(b"\xef\xbb\xbf") {
        text.drain(..3);
    }
    let defined = text.windows(3).filter(|word| word == b"def").count() * PRIM_BYTES;
    host_memory::check(path, (text.len() + defined) as u64, options.max_host_memory)?;
    if !text.starts_with(b"#usda ") {
        let remedy = "`usdcat IN -o OUT.usda` makes it of other forms of USD";
        return Err(Error::input(path, "is no USD text: it does not begin with #usda", remedy));
    }
    let damaged = || damaged(path, "ends inside a value or a prim, or closes one that is not open");
    let prims = Parser::of(&text).prims().ok_or_else(damaged)?;
    let mut header = Header::new(Format::Usda, 0, 0);
    let (mut parts, mut placements) = (Vec::new(), Vec::<DMat4>::new());
    let mut hidden = Vec::new();
    for prim in &prims {
        hidden.push(prim.is_hidden || hidden.get(prim.parent).is_some_and(|hidden| *hidden));
        let refused = |problem: String, remedy: &str| {
            Error::input(path, format!("prim {}: {problem}", prim.name), remedy)
        };
        let flatten = "apply the transform, and save the scene again";
        let own = prim.transform(&text).map_err(|op| refused(format!("{op} is not read"), flatten))?;
        let placement = placements.get(prim.parent).copied().unwrap_or(DMat4::IDENTITY) * own;
        placements.push(placement);
        if prim.kind != PRIM {
            continue;
        }
        let mut warn = |what: String| {
            header.warnings.push(format!("{}: prim {}: {what}", path.display(), prim.name));
        };
        if hidden.last() == Some(&true) {
            warn("is inactive or invisible, and not read".into());
            continue;
        }
        let is_none =
            || refused("its transform is more than rotation, scale and translation".into(), flatten);
        let mut part = Part {
            placement: similarity(placement).ok_or_else(is_none)?,
            count: 0,
            sh_degrees: [0; 2],
            arrays: Default::default(),
        };
        let stored = match prim.attributes.get(DEGREE) {
            None => MAX_SH_DEGREE,
            Some(place) => {
                words(&text, place).next().and_then(|degree| degree.parse().ok()).unwrap_or(u32::MAX)
            }
        };
        if stored > MAX_DEGREES {
            return Err(refused(format!("its {DEGREE} makes no sense"), "write 0 to 3"));
        }
        for (array, (_, name, components)) in ARRAYS.iter().enumerate() {
            let half = format!("{name}h");
            let found = [name, &*half].into_iter().filter_map(|name| prim.attributes.get(name));
            let counted = found.map(|place| (place, words(&text, place).count()));
            let Some((place, count)) = counted.into_iter().find(|(_, count)| *count > 0) else {
                if array == 0 {
                    warn("has no positions; values over time are not read".into());
                }
                continue;
            };
            let is_sh = array == ARRAYS.len() - 1;
            if array == 0 {
                part.count = count / components;
            }
            let needed = components * part.count * if is_sh { sh_coefficients(stored) } else { 1 };
            if array == 0 && count > needed {
                return Err(refused(
                    format!("{name} has {count} numbers, not three for each"),
                    "write it again",
                ));
            }
            if count < needed {
                let problem = format!("{name} has {count} numbers instead of {needed}");
                return Err(refused(problem, "write it again"));
            }
            if count > needed {
                warn(format!("{name} has {count} numbers, of which {needed} are read"));
            }
            part.arrays[array] = Some(place.clone());
            if is_sh {
                part.sh_degrees = [stored, stored.min(MAX_SH_DEGREE)];
            }
        }
        if part.sh_degrees[0] > MAX_SH_DEGREE {
            warn(format!("SH of degree {stored} are cut to {MAX_SH_DEGREE}, the highest here"));
        }
        header.count += part.count as u64;
        header.sh_degree = header.sh_degree.max(part.sh_degrees[1]);
        parts.push(part);
    }
    if parts.is_empty() {
        let problem = format!("has no prim of {PRIM}");
        return Err(Error::input(path, problem, "flatten it if it refers to others: `usdcat --flatten`"));
    }
    let placements: Vec<Similarity> = parts.iter().map(|part| part.placement).collect();
    let path = path.to_owned();
    let read = move |origin: DVec3, sink: &mut Sink<'_>| {
        parts.iter().try_for_each(|part| {
            part.read(&path, &text, &mut |block| sink(placed(block, &part.placement, origin)))
        })
    };
    let origin = origin_of(&placements, &read);
    header.origin = origin;
    Ok((header, Box::new(move |sink| read(origin, sink))))
}

impl Part {
    /// Passes the Gaussians in the prim's coordinates to a sink.
    fn read(&self, path: &Path, text: &[u8], sink: &mut Sink<'_>) -> Result<()> {
        let [stored, kept] = self.sh_degrees.map(sh_coefficients);
        let mut arrays: [_; 5] = std::array::from_fn(|array| {
            let place = self.arrays[array].as_ref();
            Array { name: ARRAYS[array].1, path, words: place.map(|place| words(text, place)) }
        });
        let [positions, orientations, scales, opacities, sh] = &mut arrays;
        let mut blocks = Blocks::new(self.sh_degrees[1], self.count as u64, sink);
        for _ in 0..self.count {
            cost::step();
            let block = blocks.next()?;
            block.means.push(positions.next([0.0; 3])?);
            block.quats.push(orientations.next([1.0, 0.0, 0.0, 0.0])?);
            // The logarithm of a negative size is NaN, which is unusable.
            block.log_scales.push(scales.next([1.0; 3])?.map(libm::logf));
            let logit = opacity_logit(opacities.next([1.0])?[0]);
            if logit.is_nan() {
                let problem = "opacities has values outside of 0 to 1";
                return Err(Error::input(path, problem, "write opacities, not their logits"));
            }
            block.opacity_logits.push(logit);
            for k in 0..stored {
                let value = sh.next([rgb_to_sh_dc(0.5); 3])?;
                block.sh.extend((k < kept).then_some(value));
            }
        }
        blocks.finish()
    }
}

/// The numbers of one array, or the schema's default.
struct Array<'a, I> {
    name: &'static str,
    path: &'a Path,
    words: Option<I>,
}

impl<'a, I: Iterator<Item = &'a str>> Array<'_, I> {
    fn next<const N: usize>(&mut self, default: [f32; N]) -> Result<[f32; N]> {
        let Some(words) = &mut self.words else { return Ok(default) };
        let mut values = default;
        for (value, word) in values.iter_mut().zip(words) {
            *value = word.parse().map_err(|_| {
                let problem = format!("{}: {word:?} is no number", self.name);
                Error::input(self.path, problem, "write or download the file again")
            })?;
        }
        Ok(values)
    }
}

/// The numbers or names of a value, without its brackets.
fn words<'a>(text: &'a [u8], place: &Range<usize>) -> impl Iterator<Item = &'a str> + use<'a> {
    let mut parser = Parser::of(&text[place.clone()]);
    std::iter::from_fn(move || {
        loop {
            if let Token::Word(word) | Token::Text(word) = parser.next()? {
                return Some(word);
            }
        }
    })
}

/// True if metadata give a name this value.
fn follows(metadata: &[u8], name: &str, value: &str) -> bool {
    let mut words = words(metadata, &(0..metadata.len()));
    words.any(|word| word == name) && words.next() == Some(value)
}

/// A prim that is defined. The first one is the stage.
#[derive(Default)]
struct Prim<'a> {
    kind: &'a str,
    name: &'a str,
    parent: usize,
    /// True if it is inactive or invisible, and so are those in it.
    is_hidden: bool,
    /// True for a stage whose z axis points up.
    z_is_up: bool,
    /// Places of the values in the text.
    attributes: BTreeMap<&'a str, Range<usize>>,
}

impl Prim<'_> {
    /// Transform from the prim to its parent. Fails with the name of an operation that is not known.
    fn transform(&self, text: &[u8]) -> Result<DMat4, String> {
        let mut matrix = match self.z_is_up {
            true => DMat4::from_rotation_x(-FRAC_PI_2),
            false => DMat4::IDENTITY,
        };
        let Some(order) = self.attributes.get("xformOpOrder") else { return Ok(matrix) };
        for (number, op) in words(text, order).enumerate() {
            let name = op.strip_prefix("!invert!").unwrap_or(op);
            let values = self.attributes.get(name).into_iter().flat_map(|place| words(text, place));
            // A matrix has the most.
            let values: Result<Vec<f64>, _> = values.take(17).map(str::parse).collect();
            let values = values.ok().filter(|_| number < MAX_OPS).ok_or(op)?;
            let own = match (name.split(':').nth(1), &*values) {
                (Some("translate"), &[x, y, z]) => DMat4::from_translation(DVec3::new(x, y, z)),
                (Some("scale"), &[x, y, z]) => DMat4::from_scale(DVec3::new(x, y, z)),
                (Some("rotateX"), &[x]) => DMat4::from_rotation_x(x.to_radians()),
                (Some("rotateY"), &[y]) => DMat4::from_rotation_y(y.to_radians()),
                (Some("rotateZ"), &[z]) => DMat4::from_rotation_z(z.to_radians()),
                (Some("rotateXYZ"), &[x, y, z]) => {
                    DMat4::from_rotation_z(z.to_radians())
                        * DMat4::from_rotation_y(y.to_radians())
                        * DMat4::from_rotation_x(x.to_radians())
                }
                (Some("orient"), &[w, x, y, z]) => DMat4::from_quat(DQuat::from_xyzw(x, y, z, w).normalize()),
                // Rows of a matrix that multiplies row vectors.
                (Some("transform"), values) if values.len() == 16 => DMat4::from_cols_slice(values),
                _ => return Err(op.to_owned()),
            };
            matrix *= if name == op { own } else { own.inverse() };
        }
        Ok(matrix)
    }
}

enum Token<'a> {
    /// A name, a type or a number.
    Word(&'a str),
    /// A quoted text, without its quotation marks.
    Text(&'a str),
    /// An equals sign or a bracket.
    Mark(u8),
}

/// Reads tokens. Commas, semicolons and ends of lines separate them and mean nothing.
struct Parser<'a> {
    text: &'a [u8],
    start: usize,
    at: usize,
}

impl<'a> Parser<'a> {
    fn of(text: &'a [u8]) -> Self {
        Self { text, start: 0, at: 0 }
    }

    /// `None` at the end and inside a quotation. Where the text is no UTF-8, it is a question mark.
    fn next(&mut self) -> Option<Token<'a>> {
        loop {
            let rest = &self.text[self.at..];
            let first = *rest.first()?;
            self.start = self.at;
            let utf8 = |bytes: &'a [u8]| std::str::from_utf8(bytes).ok();
            match first {
                b' ' | b'\t' | b'\r' | b'\n' | b',' | b';' => self.at += 1,
                b'#' => self.at += rest.iter().position(|byte| *byte == b'\n').unwrap_or(rest.len()),
                b'=' | b'(' | b')' | b'[' | b']' | b'{' | b'}' => {
                    self.at += 1;
                    return Some(Token::Mark(first));
                }
                b'"' | b'\'' | b'@' | b'<' => {
                    let width = if rest.starts_with(&[first; 3]) { 3 } else { 1 };
                    let end = &[if first == b'<' { b'>' } else { first }; 3][..width];
                    let mut length = width;
                    while !rest.get(length..)?.starts_with(end) {
                        length += if *rest.get(length)? == b'\\' { 2 } else { 1 };
                    }
                    self.at += length + width;
                    return Some(Token::Text(utf8(&rest[width..length]).unwrap_or("?")));
                }
                _ => {
                    let ends = |byte: &u8| b" \t\r\n,;#=()[]{}\"'@<".contains(byte);
                    let length = rest.iter().position(ends).unwrap_or(rest.len());
                    self.at += length;
                    return Some(Token::Word(utf8(&rest[..length]).unwrap_or("?")));
                }
            }
        }
    }

    /// Skips a value, also one whose opening bracket was the last token, and returns its place.
    fn value(&mut self, is_open: bool) -> Option<Range<usize>> {
        let (begin, mut depth) = (self.at, usize::from(is_open));
        loop {
            match self.next()? {
                Token::Mark(b'(' | b'[' | b'{') => depth += 1,
                Token::Mark(b')' | b']' | b'}') => depth = depth.checked_sub(1)?,
                _ => {}
            }
            if depth == 0 {
                return Some(begin..self.at);
            }
        }
    }

    fn prims(mut self) -> Option<Vec<Prim<'a>>> {
        let mut prims = vec![Prim::default()];
        // Indices of the prims around the current place, the innermost last.
        let mut open = vec![0];
        let mut name = "";
        while let Some(token) = self.next() {
            cost::step();
            match token {
                Token::Word(word @ ("def" | "over" | "class" | "variantSet")) => {
                    let mut prim = Prim { parent: *open.last()?, ..Prim::default() };
                    loop {
                        match self.next()? {
                            Token::Word(kind) => prim.kind = kind,
                            Token::Text(name) => prim.name = name,
                            Token::Mark(b'(') => {
                                let place = self.value(true)?;
                                prim.is_hidden |= follows(&self.text[place], "active", "false");
                            }
                            Token::Mark(b'{') => break,
                            Token::Mark(_) => {}
                        }
                    }
                    // Prims that are not defined draw nothing by themselves.
                    if word == "def" {
                        open.push(prims.len());
                        prims.push(prim);
                    } else {
                        self.value(true)?;
                    }
                }
                Token::Word(word) => name = word,
                Token::Mark(b'=') => {
                    let place = self.value(false)?;
                    let prim = &mut prims[*open.last()?];
                    let is_invisible = || words(self.text, &place).any(|word| word == "invisible");
                    prim.is_hidden |= name == "visibility" && is_invisible();
                    prim.attributes.insert(name, place);
                }
                // Metadata, of which only the stage's upward axis matters.
                Token::Mark(b'(') if prims.len() == 1 => {
                    let place = self.value(true)?;
                    // Y is the default.
                    prims[0].z_is_up |= follows(&self.text[place], "upAxis", "Z");
                }
                Token::Mark(b'(') => {
                    self.value(true)?;
                }
                Token::Mark(b'}') => {
                    open.pop();
                    open.last()?;
                }
                // The brackets of an array's type.
                Token::Mark(_) | Token::Text(_) => {}
            }
        }
        (open.len() == 1 && self.at == self.text.len()).then_some(prims)
    }
}

/// Writes Gaussians block by block. Temporary files hold the arrays until they are put together.
pub(super) fn write(path: &Path, outline: &Outline, produce: &mut Produce<'_>) -> Result<()> {
    let mut separator = "";
    let mut extent = [[f32::INFINITY; 3], [f32::NEG_INFINITY; 3]];
    let mut files = spz::spooled(produce, |mut block| {
        block.mirror(MIRRORED);
        let mut texts: [String; ARRAYS.len()] = Default::default();
        for index in 0..block.len() {
            let (mean, scales) = (block.means[index], block.log_scales[index].map(libm::expf));
            let reach = REACH * scales.into_iter().fold(0.0, f32::max);
            for axis in 0..3 {
                extent[0][axis] = extent[0][axis].min(mean[axis] - reach);
                extent[1][axis] = extent[1][axis].max(mean[axis] + reach);
            }
            let [positions, orientations, sizes, opacities, sh] = &mut texts;
            *positions += &format!("{separator}{}", tuple(&mean));
            *orientations += &format!("{separator}{}", tuple(&spz::unit(block.quats[index])));
            *sizes += &format!("{separator}{}", tuple(&scales));
            *opacities += &format!("{separator}{:?}", block.opacity(index));
            for (k, coefficient) in block.sh_of(index).iter().enumerate() {
                *sh += &format!("{}{}", if k == 0 { separator } else { ", " }, tuple(coefficient));
            }
            separator = ", ";
        }
        texts.map(String::into_bytes)
    })?;
    let origin = mirrored(outline.options.frame.origin).to_array();
    atomic::write(path, |writer| {
        writeln!(writer, "#usda 1.0\n(\n    defaultPrim = \"Gaussians\"\n    upAxis = \"Y\"\n)\n")?;
        writeln!(writer, "def {PRIM} \"Gaussians\"\n{{")?;
        if outline.count > 0 {
            let [low, high] = extent.map(|corner| tuple(&corner));
            writeln!(writer, "    float3[] extent = [{low}, {high}]")?;
        }
        for ((kind, name, _), file) in ARRAYS.iter().zip(&mut files) {
            write!(writer, "    {kind} {name} = [")?;
            io::copy(file, writer)?;
            writeln!(writer, "]")?;
        }
        writeln!(writer, "    uniform int {DEGREE} = {}", outline.sh_degree)?;
        if outline.options.frame.origin != DVec3::ZERO {
            writeln!(writer, "    double3 xformOp:translate = {}", tuple(&origin))?;
            writeln!(writer, "    uniform token[] xformOpOrder = [\"xformOp:translate\"]")?;
        }
        writeln!(writer, "}}")
    })
}

/// The shortest decimals that read as the same numbers.
fn tuple<T: std::fmt::Debug>(values: &[T]) -> String {
    let values: Vec<String> = values.iter().map(|value| format!("{value:?}")).collect();
    format!("({})", values.join(", "))
}
