//! Descriptions of parts of files. Files built from them are consistent (lengths, checksums), except for deliberate
//! changes.

use arbitrary::Arbitrary;
use serde_json::Value;

/// Largest size of a file or of an unpacked part of it, bytes.
pub const MAX_BYTES: usize = 1 << 20;

/// A number that may replace the correct one.
#[derive(Arbitrary, Clone, Copy, Debug)]
pub enum Number {
    Honest,
    Near(i8),
    Zero,
    Power(u8),
    BelowPower(u8),
    Times(u8),
    Any(u64),
}

impl Number {
    pub fn of(self, honest: u64) -> u64 {
        match self {
            Self::Honest => honest,
            Self::Near(by) => honest.wrapping_add_signed(by.into()),
            Self::Zero => 0,
            Self::Power(bits) => 1 << (bits % 64),
            Self::BelowPower(bits) => (1 << (bits % 64)) - 1,
            Self::Times(by) => honest.wrapping_mul(by.into()),
            Self::Any(any) => any,
        }
    }
}

#[derive(Arbitrary, Clone, Copy, Debug)]
pub struct Patch {
    at: u16,
    from_the_end: bool,
    value: Number,
    bytes: u8,
}

/// Applies patches, little-endian.
pub fn patch(file: &mut [u8], patches: &[Patch]) {
    for patch in patches.iter().take(4) {
        let width = [1, 2, 4, 8][usize::from(patch.bytes % 4)];
        let Some(last) = file.len().checked_sub(width) else { continue };
        let at = usize::from(patch.at) % (last + 1);
        let at = if patch.from_the_end { last - at } else { at };
        let mut old = [0; 8];
        old[..width].copy_from_slice(&file[at..at + width]);
        let new = patch.value.of(u64::from_le_bytes(old)).to_le_bytes();
        file[at..at + width].copy_from_slice(&new[..width]);
    }
}

#[derive(Arbitrary, Clone, Copy, Debug)]
pub struct Filling {
    length: u32,
    seed: u8,
    /// Random bytes; otherwise all are equal and compress well.
    noise: bool,
}

impl Filling {
    /// Largest length, so that the packed bytes are at most [`MAX_BYTES`].
    pub fn max_packed(self) -> usize {
        if self.noise { MAX_BYTES } else { 4 * MAX_BYTES }
    }

    /// Returns at most `max_length` bytes.
    pub fn bytes(self, max_length: usize) -> Vec<u8> {
        // Short lengths are more frequent.
        let length = self.length as usize % (max_length.min(MAX_BYTES) + 1) >> (self.seed % 4 * 4);
        self.exactly(length)
    }

    pub fn exactly(self, length: usize) -> Vec<u8> {
        let mut state = u32::from(self.seed);
        let mut next = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 24) as u8
        };
        (0..length).map(|_| if self.noise { next() } else { self.seed }).collect()
    }
}

/// Index of a number in a JSON, and its replacement.
pub type Change = (u8, Number);

/// Changes numbers of a JSON, also those in strings.
pub fn spoil(value: &mut Value, changes: &[Change]) {
    for (which, number) in changes.iter().take(4) {
        let count = leaves(value).len().max(1);
        if let Some(leaf) = leaves(value).into_iter().nth(usize::from(*which) % count) {
            match leaf {
                Value::Number(old) => {
                    let honest = old.as_u64().unwrap_or(old.as_f64().unwrap_or(0.0) as u64);
                    *leaf = number.of(honest).into();
                }
                Value::String(old) => {
                    if let Ok(honest) = old.parse() {
                        *leaf = number.of(honest).to_string().into();
                    }
                }
                _ => {}
            }
        }
    }
}

fn leaves(value: &mut Value) -> Vec<&mut Value> {
    match value {
        Value::Array(values) => values.iter_mut().flat_map(leaves).collect(),
        Value::Object(values) => values.values_mut().flat_map(leaves).collect(),
        Value::Null | Value::Bool(_) => Vec::new(),
        leaf => vec![leaf],
    }
}

/// A file of tensors with a changed header, whose length may be false. It may be cut.
pub fn safetensors(
    (mut header, changes): (Value, &[Change]),
    tensors: &[u8],
    (length, cut, patches): (Number, Option<u16>, &[Patch]),
) -> Vec<u8> {
    spoil(&mut header, changes);
    let mut header = header.to_string().into_bytes();
    header.resize(header.len().next_multiple_of(8), b' ');
    let mut file = length.of(header.len() as u64).to_le_bytes().to_vec();
    file.extend(header);
    file.extend(tensors);
    if let Some(cut) = cut {
        file.truncate(file.len() - usize::from(cut) % file.len());
    }
    patch(&mut file, patches);
    file
}
