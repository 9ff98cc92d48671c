//! The rows of one element as numbers, in any encoding, streamed through a small buffer.

use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;

use super::header::{self, Element, Encoding, Header, Kind, Scalar, shortened};
use crate::regular_file::{self, OnFile};
use crate::{cost, text};
use ashsplat::{Error, Result};

const BUFFER_BYTES: usize = 1 << 20;

/// An open PLY file at some position in its data.
pub(crate) struct PlyFile<'a> {
    path: &'a Path,
    reader: BufReader<File>,
    pub(crate) header: Header,
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
        let header = header::parse(&mut reader, path)?;
        let (remaining, line) = (length.saturating_sub(header.bytes), header.lines);
        Ok(Self { path, reader, header, remaining, line, next_element: 0 })
    }

    pub(crate) fn error(&self, problem: impl Into<String>) -> Error {
        Error::input(self.path, problem, "the file is damaged or was cut short: write or download it again")
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
            encoding => self.binary_rows(element, |index, bytes| {
                for (value, column) in values.iter_mut().zip(&columns) {
                    *value = decode(&bytes[column.offset..], column.scalar, encoding);
                }
                row(index, &values)
            }),
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

    fn binary_rows(
        &mut self,
        element: &Element,
        mut row: impl FnMut(u64, &[u8]) -> Result<()>,
    ) -> Result<()> {
        // The size is zero for lists and elements without properties; the caller has excluded both.
        let row_bytes = element.row_bytes().unwrap_or(0) as usize;
        if row_bytes == 0 {
            return self.skip_element(element);
        }
        let rows_at_once = (BUFFER_BYTES / row_bytes).max(1) as u64;
        let mut buffer = vec![0; row_bytes * rows_at_once.min(element.count) as usize];
        let mut index = 0;
        while index < element.count {
            let rows = rows_at_once.min(element.count - index);
            let bytes = &mut buffer[..rows as usize * row_bytes];
            self.reader.read_exact(bytes).reading(self.path)?;
            self.remaining = self.remaining.saturating_sub(bytes.len() as u64);
            for bytes in bytes.chunks_exact(row_bytes) {
                cost::step();
                row(index, bytes)?;
                index += 1;
            }
        }
        Ok(())
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

/// Decodes the number at the start of `bytes`.
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
