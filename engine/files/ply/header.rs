//! The header of a PLY file: encoding, elements and their properties.

use std::collections::HashSet;
use std::fmt::Display;
use std::io::{self, BufRead, Read, Write};
use std::path::Path;

use glam::DVec3;

use crate::cost;
use crate::regular_file::{self, OnFile};
use crate::splats::{self, FARTHEST, Format, Outline, is_kernel_size};
use ashsplat::{Error, Result};

/// Limits above any valid header, which bound the parser's memory.
const MAX_LINE_BYTES: u64 = 64 * 1024;
const MAX_LINES: u64 = 20_000;

/// How the values after the header are stored.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Encoding {
    /// Decimal text, one row per line.
    #[default]
    Ascii,
    /// Binary, least significant byte first.
    BinaryLittleEndian,
    /// Binary, most significant byte first.
    BinaryBigEndian,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Scalar {
    fn from_name(name: &str) -> Option<Self> {
        Some(match name {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }

    /// Size in a binary file, bytes.
    pub(crate) fn bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    Scalar(Scalar),
    List { count: Scalar, item: Scalar },
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Property {
    pub(crate) name: String,
    pub(crate) kind: Kind,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Element {
    pub(crate) name: String,
    pub(crate) count: u64,
    pub(crate) properties: Vec<Property>,
}

impl Element {
    /// Bytes of one row in a binary file; `None` if a list makes row sizes differ.
    pub(crate) fn row_bytes(&self) -> Option<u64> {
        let bytes = |p: &Property| match p.kind {
            Kind::Scalar(scalar) => Some(scalar.bytes() as u64),
            Kind::List { .. } => None,
        };
        self.properties.iter().map(bytes).sum()
    }

    pub(crate) fn has(&self, name: &str) -> bool {
        self.properties.iter().any(|p| p.name == name)
    }
}

#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Header {
    pub(crate) encoding: Encoding,
    pub(crate) elements: Vec<Element>,
    /// Length of the header, bytes.
    pub(crate) bytes: u64,
    pub(crate) lines: u64,
    pub(crate) marks: Marks,
    /// Origin of the positions, source coordinates.
    pub(crate) origin: DVec3,
    /// World unit of the training, source units, if a comment names it.
    pub(crate) unit: Option<f64>,
    /// Vertices that are not Gaussians: index of the first, and number.
    pub(crate) padding: Vec<(u64, u64)>,
}

impl Header {
    /// The properties of a file of Gaussians that the comments give.
    pub(super) fn of_gaussians(&self, format: Format, count: u64, sh_degree: u32) -> splats::Header {
        splats::Header {
            antialiased: self.marks.mode == RenderMode::Mip,
            kernel_size: self.marks.kernel_size,
            is_2dgs: self.marks.mode == RenderMode::Disks,
            origin: self.origin,
            unit: self.unit,
            ..splats::Header::new(format, count, sh_degree)
        }
    }
}

/// Comment keyword for chunk-filling rows in compressed PLY of this crate.
pub(crate) const PADDING: &str = "padding";
const MAX_PADDING: usize = 16;
/// Keyword of the comment with the origin of the positions, `comment origin X Y Z`.
pub(crate) const ORIGIN: &str = "origin";
/// Keyword of the comment with the world unit of the training, `comment unit U`.
pub(crate) const UNIT: &str = "unit";

/// Comments about how to draw the Gaussians. PLY has no field for it.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Marks {
    pub(crate) mode: RenderMode,
    /// Variance that training added on the screen, square pixels.
    pub(crate) kernel_size: Option<f32>,
    /// The up axis, in nerfstudio's notation.
    pub(crate) up: Option<&'static str>,
}

#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) enum RenderMode {
    #[default]
    Default,
    /// Trained with antialiasing.
    Mip,
    /// Flat disks (2D Gaussian Splatting).
    Disks,
    Unknown(String),
}

/// The note about a scene of 2DGS.
pub(super) const DISKS: &str = "this is a 2DGS scene: its disks are used as 3D Gaussians without thickness, so pictures differ from 2DGS";

impl Marks {
    /// Reads a comment of Brush, gsplat or splat-transform (`SplatRenderMode: mip`), Postshot (`antialiased 1`) or
    /// web-splat (`mip=true`, `kernel_size=0.1`). The last one counts.
    fn comment(&mut self, text: &str) {
        let text = text.to_ascii_lowercase().replace([':', '='], " ");
        let is_mip = |mip: bool| if mip { RenderMode::Mip } else { RenderMode::Default };
        match *text.split_ascii_whitespace().collect::<Vec<_>>() {
            ["splatrendermode", "2dgs"] => self.mode = RenderMode::Disks,
            ["splatrendermode", mode @ ("mip" | "default")] => self.mode = is_mip(mode == "mip"),
            ["splatrendermode", mode] => self.mode = RenderMode::Unknown(shortened(mode)),
            ["antialiased"] => self.mode = RenderMode::Mip,
            ["antialiased" | "mip", value @ ("0" | "1" | "false" | "true")] => {
                self.mode = is_mip(matches!(value, "1" | "true"));
            }
            ["kernel_size", size] => self.kernel_size = size.parse().ok().filter(is_kernel_size),
            ["vertical", "axis", axis] => {
                let axes = [("x", "1,0,0"), ("y", "0,1,0"), ("z", "0,0,1")];
                self.up = axes.into_iter().find_map(|(name, up)| (name == axis).then_some(up));
            }
            _ => {}
        }
    }

    /// Warning for the user, if any.
    pub(crate) fn warning(&self) -> Option<String> {
        match &self.mode {
            RenderMode::Default | RenderMode::Mip => None,
            RenderMode::Disks => Some(DISKS.into()),
            RenderMode::Unknown(mode) => {
                Some(format!("SplatRenderMode '{mode}' is not known: the scene is drawn as the default one"))
            }
        }
    }

    /// Writes the marks in the notation of other programs.
    pub(super) fn write(writer: &mut impl Write, outline: &Outline) -> io::Result<()> {
        if outline.antialiased {
            writeln!(writer, "comment SplatRenderMode: mip")?;
        } else if outline.is_2dgs {
            writeln!(writer, "comment SplatRenderMode: 2dgs")?;
        }
        match outline.kernel_size {
            Some(size) => writeln!(writer, "comment kernel_size={size}"),
            None => Ok(()),
        }
    }
}

/// The property with the sizes of Mip-Splatting's 3D filter.
pub(crate) const FILTER: &str = "filter_3D";

/// Reads the header. The reader is then at the first byte of the data.
pub(crate) fn parse(reader: &mut impl BufRead, path: &Path) -> Result<Header> {
    check_magic(reader, path)?;
    let header = Header::default();
    let (element_names, property_names) = (HashSet::new(), HashSet::new());
    let mut parser = Parser { path, encoding: None, header, element_names, property_names };
    while !parser.line(reader)? {}
    let encoding = parser.encoding.ok_or_else(|| parser.error("the header has no format line"))?;
    Ok(Header { encoding, ..parser.header })
}

fn check_magic(reader: &mut impl BufRead, path: &Path) -> Result<()> {
    let start = reader.fill_buf().reading(path)?;
    let start = &start[..start.len().min(512)];
    if start.starts_with(b"ply\n") || start.starts_with(b"ply\r") || start == b"ply" {
        return Ok(());
    }
    if start.starts_with("\u{feff}ply".as_bytes()) {
        let remedy = "save it in UTF-8 without that mark; a binary PLY that an editor saved is lost: take the original";
        return Err(Error::input(path, "begins with a byte-order mark, as text editors write it", remedy));
    }
    let (problem, remedy) = regular_file::recognise(start)
        .unwrap_or(("is not a PLY file (its first line is not `ply`)", "give the path of a PLY file"));
    Err(Error::input(path, problem, remedy))
}

struct Parser<'a> {
    path: &'a Path,
    encoding: Option<Encoding>,
    header: Header,
    /// Names of the elements, and of the last element's properties.
    element_names: HashSet<String>,
    property_names: HashSet<String>,
}

impl Parser<'_> {
    fn error(&self, problem: impl Display) -> Error {
        let problem = format!("header line {}: {problem}", self.header.lines.max(1));
        Error::input(self.path, problem, "the file is damaged or not a PLY: write or download it again")
    }

    /// Reads one line; true at `end_header`.
    fn line(&mut self, reader: &mut impl BufRead) -> Result<bool> {
        let mut text = Vec::new();
        let read =
            Read::take(&mut *reader, MAX_LINE_BYTES).read_until(b'\n', &mut text).reading(self.path)?;
        self.header.bytes += read as u64;
        self.header.lines += 1;
        if text.pop_if(|last| *last == b'\n').is_none() {
            return Err(match read as u64 {
                MAX_LINE_BYTES => self.error("is longer than 64 KiB"),
                _ => self.error("the file ends inside the header (no end_header)"),
            });
        }
        text.pop_if(|last| *last == b'\r');
        if self.header.lines > MAX_LINES {
            return Err(self.error("the header does not end (no end_header)"));
        }
        match std::str::from_utf8(&text) {
            Ok(text) => self.words(&text.split_ascii_whitespace().collect::<Vec<_>>()),
            // Only comments may have any encoding.
            Err(_) if text.starts_with(b"comment") || text.starts_with(b"obj_info") => Ok(false),
            Err(_) => Err(self.error("is not text (no end_header)")),
        }
    }

    fn words(&mut self, words: &[&str]) -> Result<bool> {
        match *words {
            ["ply"] if self.header.lines == 1 => {}
            ["format", name, _version] => self.format(name)?,
            ["element", name, count] => self.element(name, count)?,
            ["property", kind, name] => self.property(Kind::Scalar(self.scalar(kind)?), name)?,
            ["property", "list", count, item, name] => {
                let kind = Kind::List { count: self.scalar(count)?, item: self.scalar(item)? };
                self.property(kind, name)?;
            }
            ["end_header"] => return Ok(true),
            ["comment", ORIGIN, x, y, z] => {
                let numbers = [x, y, z].map(|number| number.parse().unwrap_or(f64::NAN));
                // A comment of another program may begin with the same word.
                if numbers.iter().all(|number| number.abs() <= FARTHEST) {
                    self.header.origin = DVec3::from_array(numbers);
                }
            }
            ["comment", UNIT, unit] => {
                self.header.unit =
                    unit.parse().ok().filter(|unit| (FARTHEST.recip()..=FARTHEST).contains(unit));
            }
            ["comment", PADDING, first, count] if self.header.padding.len() < MAX_PADDING => {
                self.header.padding.extend(first.parse().ok().zip(count.parse().ok()));
            }
            ["comment", ref words @ ..] => self.header.marks.comment(&words.join(" ")),
            ["obj_info", ..] | [] => {}
            ["element", name] => return Err(self.error(format!("element {name} has no count"))),
            [word, ..] => return Err(self.error(format!("'{}' is not understood", shortened(word)))),
        }
        Ok(false)
    }

    fn format(&mut self, name: &str) -> Result<()> {
        self.encoding = Some(match name {
            "ascii" => Encoding::Ascii,
            "binary_little_endian" => Encoding::BinaryLittleEndian,
            "binary_big_endian" => Encoding::BinaryBigEndian,
            _ => return Err(self.error(format!("unknown format '{}'", shortened(name)))),
        });
        Ok(())
    }

    fn element(&mut self, name: &str, count: &str) -> Result<()> {
        cost::step();
        self.property_names.clear();
        if !self.element_names.insert(name.to_owned()) {
            return Err(self.error(format!("element {name} appears twice")));
        }
        let count = count
            .parse()
            .map_err(|_| self.error(format!("'{}' is not a number of {name} elements", shortened(count))))?;
        self.header.elements.push(Element { name: name.to_owned(), count, properties: Vec::new() });
        Ok(())
    }

    fn property(&mut self, kind: Kind, name: &str) -> Result<()> {
        cost::step();
        // CloudCompare prefixes every field except positions, normals and colours.
        let own = name.strip_prefix("scalar_").filter(|own| {
            ["opacity", "f_dc_", "f_rest_", "scale_", "rot_"].iter().any(|start| own.starts_with(start))
        });
        let name = own.unwrap_or(name);
        let new = self.property_names.insert(name.to_owned());
        match self.header.elements.last_mut() {
            None => Err(self.error(format!("property {name} stands before any element"))),
            Some(element) if !new => {
                let problem = format!("property {name} appears twice in element {}", element.name);
                Err(self.error(problem))
            }
            Some(element) => {
                element.properties.push(Property { name: name.to_owned(), kind });
                Ok(())
            }
        }
    }

    fn scalar(&self, name: &str) -> Result<Scalar> {
        Scalar::from_name(name)
            .ok_or_else(|| self.error(format!("unknown property type '{}'", shortened(name))))
    }
}

/// The beginning of a word, shortened for a message.
pub(crate) fn shortened(word: &str) -> String {
    let mut start: String = word.chars().take(40).collect();
    if start.len() < word.len() {
        start.push('…');
    }
    start
}
