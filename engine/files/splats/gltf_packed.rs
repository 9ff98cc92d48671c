//! GLB whose attributes are an SPZ of version 2: `KHR_gaussian_splatting_compression_spz_2`, a draft.
//!
//! The draft and its readers differ. The draft requires SPZ's own axes (right, up, back), which a loader rotates.
//! CesiumJS (1.145) and the tiles of Cesium ion have glTF's axes instead, and name neither kernel nor colour space.
//! This module writes what CesiumJS reads. It reads both: a primitive that names its kernel follows the draft.

use std::io::{self, Seek, SeekFrom};
use std::path::Path;

use serde_json::json;

use super::gltf::{EXTENSION, MIRRORED, PACKED_EXTENSION};
use super::gltf_write::{FLOAT, UNSIGNED_BYTE, bounds_of, glb_head, mark, mirrored_corners, node};
use super::{Outline, Produce, spz_write};
use crate::atomic;
use ashsplat::{Error, Result};

/// Writes Gaussians block by block; temporary files hold them until they are packed.
pub(super) fn write(path: &Path, outline: &Outline, produce: &mut Produce<'_>) -> Result<()> {
    let bounds = bounds_of(path, outline)?;
    let mut packed = spz_write::old(path, MIRRORED, outline, produce)?;
    let io = |source| Error::io(path, "write", source);
    let bytes = packed.seek(SeekFrom::End(0)).map_err(io)?;
    packed.rewind().map_err(io)?;
    // The accessors describe the unpacked attributes and have no bytes of their own.
    let [min, max] = mirrored_corners(bounds);
    let mut accessors = vec![
        json!({ "componentType": FLOAT, "type": "VEC3", "count": outline.count, "min": min, "max": max }),
        json!({ "componentType": UNSIGNED_BYTE, "normalized": true, "type": "VEC4", "count": outline.count }),
        json!({ "componentType": FLOAT, "type": "VEC4", "count": outline.count }),
        json!({ "componentType": FLOAT, "type": "VEC3", "count": outline.count }),
    ];
    let own = |name: &str| format!("{EXTENSION}:{name}");
    let mut attributes = json!({ "POSITION": 0, "COLOR_0": 1, own("ROTATION"): 2, own("SCALE"): 3 });
    let coefficients = (1..=outline.sh_degree).flat_map(|degree| (0..=2 * degree).map(move |k| (degree, k)));
    for (degree, k) in coefficients {
        attributes[own(&format!("SH_DEGREE_{degree}_COEF_{k}"))] = json!(accessors.len());
        accessors.push(json!({ "componentType": FLOAT, "type": "VEC3", "count": outline.count }));
    }
    let mut extension = json!({ "extensions": { PACKED_EXTENSION: { "bufferView": 0 } } });
    mark(&mut extension, outline);
    let padded = bytes.next_multiple_of(4);
    let head = glb_head(
        &json!({
            "asset": { "version": "2.0", "generator": concat!("ashsplat ", env!("CARGO_PKG_VERSION")) },
            "extensionsUsed": [EXTENSION, PACKED_EXTENSION],
            "extensionsRequired": [EXTENSION, PACKED_EXTENSION],
            "scene": 0,
            "scenes": [{ "nodes": [0] }],
            "nodes": [node(outline)],
            "buffers": [{ "byteLength": padded }],
            "bufferViews": [{ "buffer": 0, "byteLength": bytes }],
            "accessors": accessors,
            "meshes": [{ "primitives": [{ "mode": 0, "attributes": attributes, "extensions": { EXTENSION: extension } }] }],
        }),
        padded,
    )?;
    atomic::write(path, |writer| {
        writer.write_all(&head)?;
        io::copy(&mut packed, writer)?;
        writer.write_all(&[0; 3][..(padded - bytes) as usize])
    })
}
