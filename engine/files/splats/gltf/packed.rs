//! Primitives whose attributes are packed as an SPZ.

use std::path::Path;

use super::accessor::{Buffer, Buffers};
use super::document::{Document, Primitive, SplatsExtension};
use super::{PACKED_EXTENSION, damaged};
use crate::splats::Source;
use crate::splats::spz::Spz;
use ashsplat::{Error, Result};

/// An SPZ. `has_own_axes` tells SPZ's axes from glTF's (see [`super::super::gltf_packed`]).
pub(super) struct PackedRows {
    pub(super) spz: Spz,
    pub(super) has_own_axes: bool,
    /// Number of bytes in the file.
    pub(super) bytes: u64,
}

impl PackedRows {
    /// The SPZ of a primitive, if it is packed. `place` names the primitive in messages.
    pub(super) fn of(
        path: &Path,
        place: &str,
        (document, buffers): (&Document, &Buffers),
        (primitive, extension): (&Primitive, &SplatsExtension),
    ) -> Result<Option<Self>> {
        let Some(packed) = extension.extensions.get(PACKED_EXTENSION) else {
            return Ok(None);
        };
        let wrong = |problem: &str| damaged(path, format!("{place}: {PACKED_EXTENSION}: {problem}"));
        let view = packed.buffer_view.and_then(|index| document.buffer_views.get(index));
        let view = view.ok_or_else(|| wrong("its buffer view is missing"))?;
        let buffer = buffers.0.get(view.buffer).ok_or_else(|| wrong("its buffer is missing"))?;
        if view.byte_offset.checked_add(view.byte_length).is_none_or(|end| end > buffer.bytes()) {
            return Err(wrong("its buffer view ends behind its buffer"));
        }
        let Buffer::File { path: file, offset, .. } = buffer else {
            let problem = format!("{place}: an SPZ inside the JSON is not read");
            return Err(Error::input(path, problem, "write it as .glb, or with a .bin"));
        };
        let spz = Spz::inside(file, offset + view.byte_offset, view.byte_length)?;
        let positions = primitive.attributes.get("POSITION").and_then(|&index| document.accessors.get(index));
        let expected = positions.map_or(spz.header().count, |accessor| accessor.count);
        if expected != spz.header().count {
            return Err(wrong(&format!("{} Gaussians, where {expected} are due", spz.header().count)));
        }
        let has_own_axes = extension.kernel.is_some();
        let spz = if has_own_axes { spz } else { spz.without_axes() };
        Ok(Some(Self { spz, has_own_axes, bytes: view.byte_length }))
    }
}
