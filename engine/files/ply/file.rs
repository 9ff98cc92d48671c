//! A PLY file: its header, and the rows of one element as numbers, in any encoding, streamed through a small buffer.

use std::collections::HashSet;
use std::fmt::Display;
use std::fs::File;
use std::io::{self, BufRead, BufReader, Read, Write};
use std::path::Path;

use glam::DVec3;

use crate::regular_file::{self, OnFile, damaged};
use crate::splats::{self, FARTHEST, Format, Outline, is_kernel_size};
use crate::{cost, text};
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

    /// Type of a property that is no list.
    pub(crate) fn scalar(&self, name: &str) -> Option<Scalar> {
        self.properties.iter().find_map(|p| match p.kind {
            Kind::Scalar(scalar) if p.name == name => Some(scalar),
            _ => None,
        })
    }
}

#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct PlyHeader {
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

impl PlyHeader {
    /// The properties of a file of Gaussians that the comments give.
    pub(super) fn of_gaussians(&self, format: Format, count: u64, sh_degree: u32) -> splats::Header {
        splats::Header {
            antialiased: self.marks.mode == RenderMode::Mip,
            kernel_size: self.marks.kernel_size,
            distance_order: self.marks.distance_order,
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
    /// True if the Gaussians are to be blended in the order of distances.
    pub(crate) distance_order: bool,
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
            ["distance_order", value] => self.distance_order = value == "true",
            ["kernel_size", size] => self.kernel_size = size.parse().ok().filter(is_kernel_size),
            ["vertical", "axis", axis] => {
                let axes = [("x", "1,0,0"), ("y", "0,1,0"), ("z", "0,0,1")];
                self.up = axes.into_iter().find_map(|(name, up)| (name == axis).then_some(up));
            }
            _ => {}
        }
    }

    pub(crate) fn warning(&self) -> Option<String> {
        match &self.mode {
            RenderMode::Default | RenderMode::Mip => None,
            RenderMode::Disks => Some(DISKS.into()),
            RenderMode::Unknown(mode) => {
                Some(format!("SplatRenderMode '{mode}' is not known: the scene is drawn as the default one"))
            }
        }
    }

    /// Writes the marks, in the notation of other programs where they have one.
    pub(super) fn write(writer: &mut impl Write, outline: &Outline) -> io::Result<()> {
        if outline.options.antialiased {
            writeln!(writer, "comment SplatRenderMode: mip")?;
        } else if outline.options.is_2dgs {
            writeln!(writer, "comment SplatRenderMode: 2dgs")?;
        }
        if outline.options.distance_order {
            writeln!(writer, "comment distance_order=true")?;
        }
        match outline.options.kernel_size {
            Some(size) => writeln!(writer, "comment kernel_size={size}"),
            None => Ok(()),
        }
    }
}

/// The property with the sizes of Mip-Splatting's 3D filter.
pub(crate) const FILTER: &str = "filter_3D";

/// Reads the header. The reader is then at the first byte of the data.
pub(crate) fn parse(reader: &mut impl BufRead, path: &Path) -> Result<PlyHeader> {
    check_magic(reader, path)?;
    let header = PlyHeader::default();
    let (element_names, property_names) = (HashSet::new(), HashSet::new());
    let mut parser = Parser { path, encoding: None, header, element_names, property_names };
    while !parser.line(reader)? {}
    let encoding = parser.encoding.ok_or_else(|| parser.error("the header has no format line"))?;
    Ok(PlyHeader { encoding, ..parser.header })
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
    header: PlyHeader,
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

const BUFFER_BYTES: usize = 1 << 20;

/// An open PLY file at some position in its data.
pub(crate) struct PlyFile<'a> {
    path: &'a Path,
    reader: BufReader<File>,
    pub(crate) header: PlyHeader,
    /// Bytes of the file after the current position.
    remaining: u64,
    /// Lines read so far, for messages about ASCII files.
    line: u64,
    /// The element at the current position.
    next_element: usize,
}

#[derive(Clone, Copy)]
struct Column {
    /// Byte offset in a binary row.
    offset: usize,
    /// Index in an ASCII row.
    place: usize,
    scalar: Scalar,
}

impl<'a> PlyFile<'a> {
    pub(crate) fn open(path: &'a Path) -> Result<Self> {
        let (file, length) = regular_file::open(path)?;
        let mut reader = BufReader::with_capacity(BUFFER_BYTES, file);
        let header = parse(&mut reader, path)?;
        let (remaining, line) = (length.saturating_sub(header.bytes), header.lines);
        Ok(Self { path, reader, header, remaining, line, next_element: 0 })
    }

    pub(crate) fn error(&self, problem: impl Into<String>) -> Error {
        damaged(self.path, problem)
    }

    /// Skips the elements before `name` and returns it. The caller must read its rows before the next call.
    pub(crate) fn seek_element(&mut self, name: &str) -> Result<Element> {
        for element in self.header.elements.clone().into_iter().skip(self.next_element) {
            self.next_element += 1;
            if element.name == name {
                self.check_size(&element)?;
                return Ok(element);
            }
            self.skip_element(&element)?;
        }
        let names: Vec<_> = self.header.elements.iter().map(|e| shortened(&e.name)).collect();
        let names = if names.is_empty() { "none".to_owned() } else { names.join(", ") };
        Err(Error::input(self.path, format!("has no element '{name}' (elements: {names})"), ""))
    }

    /// Number of bytes after the last element, if that is `element` and its rows have one size.
    pub(crate) fn bytes_behind(&self, element: &Element) -> Option<u64> {
        let row = element.row_bytes().filter(|_| self.header.encoding != Encoding::Ascii)?;
        let behind = self.remaining.checked_sub(element.count.checked_mul(row)?)?;
        (behind > 0 && self.next_element == self.header.elements.len()).then_some(behind)
    }

    /// Checks that the file can hold the header's number of rows, before memory is reserved for them.
    fn check_size(&self, element: &Element) -> Result<()> {
        let needed = match (self.header.encoding, element.row_bytes()) {
            // An ASCII value takes a digit and a separator, which the last value may lack.
            (Encoding::Ascii, _) => {
                (u128::from(element.count) * 2 * element.properties.len() as u128).saturating_sub(1)
            }
            (_, Some(row)) => u128::from(element.count) * u128::from(row),
            // Each list takes at least its count.
            (_, None) => u128::from(element.count),
        };
        if needed <= u128::from(self.remaining) {
            return Ok(());
        }
        let Element { count, name, .. } = element;
        let (at_least, left) =
            (if self.header.encoding == Encoding::Ascii { "at least " } else { "" }, self.remaining);
        let problem = format!(
            "{count} {name} elements need {at_least}{needed} bytes, {left} are left after the header"
        );
        Err(self.error(problem))
    }

    /// Calls `row` with the named properties of each row of `element`, in the order of `names`, up to the first error.
    ///
    /// A property that the element lacks is an error. The caller checks before where it can give a better error.
    pub(crate) fn for_each_row(
        &mut self,
        element: &Element,
        names: &[impl AsRef<str>],
        mut row: impl FnMut(u64, &[f64]) -> Result<()>,
    ) -> Result<()> {
        self.check_no_list(element)?;
        let columns =
            names.iter().map(|name| self.column(element, name.as_ref())).collect::<Result<Vec<_>>>()?;
        let mut values = vec![0.0; columns.len()];
        match self.header.encoding {
            Encoding::Ascii => {
                let mut text = Vec::new();
                for index in 0..element.count {
                    self.ascii_row(element, index, &columns, &mut text, &mut values)?;
                    row(index, &values)?;
                }
                Ok(())
            }
            encoding => {
                // The size is zero for elements without properties, which have no columns.
                let row_bytes = element.row_bytes().filter(|bytes| *bytes > 0);
                let Some(row_bytes) = row_bytes else { return self.skip_element(element) };
                let mut index = 0..;
                let size = (element.count, row_bytes as usize);
                regular_file::rows(self.path, &mut self.reader, size, |bytes| {
                    for (value, column) in values.iter_mut().zip(&columns) {
                        *value = decode(&bytes[column.offset..], column.scalar, encoding);
                    }
                    row(index.next().unwrap_or(0), &values)
                })?;
                self.remaining = self.remaining.saturating_sub(element.count * row_bytes);
                Ok(())
            }
        }
    }

    /// Refuses lists: rows of differing length are skipped, never read.
    pub(crate) fn check_no_list(&self, element: &Element) -> Result<()> {
        let list = element.properties.iter().find(|p| matches!(p.kind, Kind::List { .. }));
        let Some(list) = list else { return Ok(()) };
        let problem = format!("property {} of element {} is a list", shortened(&list.name), element.name);
        Err(Error::input(self.path, problem, "write the file without it"))
    }

    fn column(&self, element: &Element, name: &str) -> Result<Column> {
        let mut offset = 0;
        for (place, property) in element.properties.iter().enumerate() {
            match property.kind {
                Kind::Scalar(scalar) if property.name == name => return Ok(Column { offset, place, scalar }),
                Kind::Scalar(scalar) => offset += scalar.bytes(),
                Kind::List { .. } => break,
            }
        }
        Err(Error::input(self.path, format!("property {name} of element {} is missing", element.name), ""))
    }

    fn ascii_row(
        &mut self,
        element: &Element,
        index: u64,
        columns: &[Column],
        text: &mut Vec<u8>,
        values: &mut [f64],
    ) -> Result<()> {
        self.ascii_line(element, index, text)?;
        let place = |path_line: u64| format!("line {path_line} ({} {index})", element.name);
        let line =
            std::str::from_utf8(text).map_err(|_| self.error(format!("{} is not text", place(self.line))))?;
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        if words.len() != element.properties.len() {
            let (has, needs) = (words.len(), element.properties.len());
            return Err(self.error(format!("{} has {has} values, the header says {needs}", place(self.line))));
        }
        // Checks all values, not only the requested ones: a word among the numbers means damage.
        for (word, property) in words.iter().zip(&element.properties) {
            cost::step();
            if word.parse::<f32>().is_err() {
                let (word, name) = (&shortened(word), &property.name);
                let why = text::not_a_number(word);
                let problem = format!("{}: '{word}' for {name} is not a number{why}", place(self.line));
                return Err(self.error(problem));
            }
        }
        for (value, column) in values.iter_mut().zip(columns) {
            let word = words[column.place];
            // Rounds once, to the precision of the file's type.
            *value = match column.scalar {
                Scalar::F32 => f64::from(word.parse().unwrap_or(f32::NAN)),
                _ => word.parse().unwrap_or(f64::NAN),
            };
        }
        Ok(())
    }

    /// Reads the next line that is not blank.
    fn ascii_line(&mut self, element: &Element, index: u64, text: &mut Vec<u8>) -> Result<()> {
        loop {
            cost::step();
            text.clear();
            let read = self.reader.read_until(b'\n', text);
            let read = read.reading(self.path)?;
            self.remaining = self.remaining.saturating_sub(read as u64);
            self.line += 1;
            if read == 0 {
                let Element { name, count, .. } = element;
                return Err(self.error(format!("the data end before {name} {index} of {count}")));
            }
            if !text.trim_ascii().is_empty() {
                return Ok(());
            }
        }
    }

    fn skip_element(&mut self, element: &Element) -> Result<()> {
        self.check_size(element)?;
        match (self.header.encoding, element.row_bytes()) {
            // Rows without properties have no bytes.
            _ if element.properties.is_empty() => Ok(()),
            (Encoding::Ascii, _) => {
                let mut text = Vec::new();
                (0..element.count).try_for_each(|index| self.ascii_line(element, index, &mut text))
            }
            (_, Some(row)) => self.skip(element, element.count * row),
            (encoding, None) => {
                (0..element.count).try_for_each(|_| self.skip_binary_row_with_lists(element, encoding))
            }
        }
    }

    fn skip_binary_row_with_lists(&mut self, element: &Element, encoding: Encoding) -> Result<()> {
        for property in &element.properties {
            cost::step();
            match property.kind {
                Kind::Scalar(scalar) => self.skip(element, scalar.bytes() as u64)?,
                Kind::List { count, item } => {
                    let mut bytes = [0; 8];
                    let bytes = &mut bytes[..count.bytes()];
                    self.require(element, bytes.len() as u64)?;
                    self.reader.read_exact(bytes).reading(self.path)?;
                    self.remaining -= bytes.len() as u64;
                    let length = decode(bytes, count, encoding);
                    if !(length >= 0.0 && length.fract() == 0.0) {
                        let problem = format!("a list in element {} has length {length}", element.name);
                        return Err(self.error(problem));
                    }
                    self.skip(element, (length as u64).saturating_mul(item.bytes() as u64))?;
                }
            }
        }
        Ok(())
    }

    fn require(&self, Element { name, .. }: &Element, bytes: u64) -> Result<()> {
        let problem = || self.error(format!("the data end inside element {name}"));
        if bytes > self.remaining { Err(problem()) } else { Ok(()) }
    }

    fn skip(&mut self, element: &Element, bytes: u64) -> Result<()> {
        self.require(element, bytes)?;
        let offset = i64::try_from(bytes).map_err(|_| self.error("the data are longer than any file"))?;
        self.reader.seek_relative(offset).reading(self.path)?;
        self.remaining -= bytes;
        Ok(())
    }
}

pub(crate) fn decode(bytes: &[u8], scalar: Scalar, encoding: Encoding) -> f64 {
    fn take<const N: usize>(bytes: &[u8], encoding: Encoding) -> [u8; N] {
        let mut array = [0; N];
        array.copy_from_slice(&bytes[..N]);
        if encoding == Encoding::BinaryBigEndian {
            array.reverse();
        }
        array
    }
    match scalar {
        Scalar::I8 => f64::from(bytes[0] as i8),
        Scalar::U8 => f64::from(bytes[0]),
        Scalar::I16 => f64::from(i16::from_le_bytes(take(bytes, encoding))),
        Scalar::U16 => f64::from(u16::from_le_bytes(take(bytes, encoding))),
        Scalar::I32 => f64::from(i32::from_le_bytes(take(bytes, encoding))),
        Scalar::U32 => f64::from(u32::from_le_bytes(take(bytes, encoding))),
        Scalar::F32 => f64::from(f32::from_le_bytes(take(bytes, encoding))),
        Scalar::F64 => f64::from_le_bytes(take(bytes, encoding)),
    }
}
