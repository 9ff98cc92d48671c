//! Numbers in glTF's buffers.

use std::collections::BTreeSet;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::ops::Range;
use std::path::PathBuf;

use super::document::Document;
use crate::cost;
use ashsplat::{Error, Result};

/// Largest stride in glTF, bytes.
const MAX_STRIDE: u64 = 252;

/// The open buffers.
pub(super) struct Buffers(pub(super) Vec<Buffer>);

impl Buffers {
    /// Total bytes of the buffers; a file that several buffers name counts once.
    pub(super) fn bytes(&self) -> u64 {
        let mut files = BTreeSet::new();
        let counts = |buffer: &&Buffer| match buffer {
            Buffer::File { path, .. } => files.insert(path.clone()),
            Buffer::Memory(_) => true,
        };
        self.0.iter().filter(counts).map(Buffer::bytes).sum()
    }
}

/// Storage of one buffer.
pub(super) enum Buffer {
    File { path: PathBuf, file: File, offset: u64, bytes: u64 },
    Memory(Vec<u8>),
}

impl Buffer {
    pub(super) fn bytes(&self) -> u64 {
        match self {
            Self::File { bytes, .. } => *bytes,
            Self::Memory(data) => data.len() as u64,
        }
    }

    /// Reads bytes. The caller has checked the range against [`Buffer::bytes`].
    fn read(&mut self, at: u64, data: &mut [u8]) -> Result<()> {
        match self {
            Self::File { path, file, offset, .. } => file
                .seek(SeekFrom::Start(*offset + at))
                .and_then(|_| file.read_exact(data))
                .map_err(|source| Error::io(path, "read", source)),
            Self::Memory(all) => {
                data.copy_from_slice(&all[at as usize..at as usize + data.len()]);
                Ok(())
            }
        }
    }
}

/// The type of one number.
#[derive(Clone, Copy, PartialEq)]
enum Component {
    I8,
    U8,
    I16,
    U16,
    F32,
}

impl Component {
    fn size(self) -> usize {
        match self {
            Component::I8 | Component::U8 => 1,
            Component::I16 | Component::U16 => 2,
            Component::F32 => 4,
        }
    }
}

/// Rows of numbers, checked to lie within their buffer.
pub(super) struct Accessor {
    buffer: usize,
    offset: u64,
    stride: u64,
    count: usize,
    components: usize,
    component: Component,
    normalized: bool,
}

impl Accessor {
    /// The accessor with this index. The error text says what is wrong with it.
    pub(super) fn new(
        document: &Document,
        buffers: &Buffers,
        index: usize,
        components: usize,
    ) -> Result<Self, String> {
        let accessor = document.accessors.get(index).ok_or_else(|| format!("accessor {index} is missing"))?;
        let (component, size) = match accessor.component_type {
            5120 => (Component::I8, 1),
            5121 => (Component::U8, 1),
            5122 => (Component::I16, 2),
            5123 => (Component::U16, 2),
            5126 => (Component::F32, 4),
            other => return Err(format!("accessor {index} has component type {other}")),
        };
        let kind = ["SCALAR", "VEC2", "VEC3", "VEC4"][components - 1];
        if accessor.kind != kind {
            return Err(format!("accessor {index} is {}, not {kind}", accessor.kind));
        }
        let Some(view_index) = accessor.buffer_view.filter(|_| accessor.sparse.is_none()) else {
            return Err(format!("accessor {index} is sparse, which is not read"));
        };
        let view = document
            .buffer_views
            .get(view_index)
            .ok_or_else(|| format!("buffer view {view_index} is missing"))?;
        let packed = view.extensions.keys().next();
        if let Some(extension) = packed {
            return Err(format!("its buffer view is compressed ({extension}), which is not read"));
        }
        let buffer =
            buffers.0.get(view.buffer).ok_or_else(|| format!("buffer {} is missing", view.buffer))?;
        let row = components as u64 * size;
        let stride = view.byte_stride.unwrap_or(row);
        // With rows far apart, many primitives could read the whole file for little data.
        if stride > MAX_STRIDE {
            return Err(format!("its buffer view has a stride of {stride} bytes; {MAX_STRIDE} are possible"));
        }
        let needed = match accessor.count {
            0 => Some(accessor.byte_offset),
            count => (count - 1)
                .checked_mul(stride)
                .and_then(|b| b.checked_add(row)?.checked_add(accessor.byte_offset)),
        };
        if stride < row || needed.is_none_or(|needed| needed > view.byte_length) {
            let (count, length) = (accessor.count, view.byte_length);
            return Err(format!("{count} rows of {row} bytes do not fit its buffer view of {length} bytes"));
        }
        if view.byte_offset.checked_add(view.byte_length).is_none_or(|end| end > buffer.bytes()) {
            return Err(format!("its buffer view ends behind its buffer of {} bytes", buffer.bytes()));
        }
        Ok(Self {
            buffer: view.buffer,
            offset: view.byte_offset + accessor.byte_offset,
            stride,
            count: accessor.count as usize,
            components,
            component,
            normalized: accessor.normalized,
        })
    }

    /// Number of rows.
    pub(super) fn count(&self) -> usize {
        self.count
    }

    /// Bytes of all numbers.
    pub(super) fn bytes(&self) -> u64 {
        self.count as u64 * (self.components * self.component.size()) as u64
    }

    /// Reads the numbers of some rows.
    pub(super) fn read(&self, buffers: &mut Buffers, rows: Range<usize>) -> Result<Vec<f32>> {
        let mut values = Vec::with_capacity(rows.len() * self.components);
        if rows.is_empty() {
            return Ok(values);
        }
        let size = self.component.size();
        let bytes = (rows.len() as u64 - 1) * self.stride + (self.components * size) as u64;
        let mut data = vec![0; bytes as usize];
        buffers.0[self.buffer].read(self.offset + rows.start as u64 * self.stride, &mut data)?;
        for row in data.chunks(self.stride as usize) {
            cost::step();
            values.extend(row.chunks_exact(size).take(self.components).map(|bytes| self.decode(bytes)));
        }
        Ok(values)
    }

    fn decode(&self, bytes: &[u8]) -> f32 {
        let scale =
            |value: f32, largest: f32| if self.normalized { (value / largest).max(-1.0) } else { value };
        match (self.component, bytes) {
            (Component::I8, &[a]) => scale(f32::from(a as i8), 127.0),
            (Component::U8, &[a]) => scale(f32::from(a), 255.0),
            (Component::I16, &[a, b]) => scale(f32::from(i16::from_le_bytes([a, b])), 32_767.0),
            (Component::U16, &[a, b]) => scale(f32::from(u16::from_le_bytes([a, b])), 65_535.0),
            (_, &[a, b, c, d]) => f32::from_le_bytes([a, b, c, d]),
            _ => f32::NAN,
        }
    }
}
