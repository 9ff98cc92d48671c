//! Writes glTF and GLB with `KHR_gaussian_splatting`: one primitive, one buffer view for each attribute.

use std::fs;
use std::io::{self, SeekFrom};
use std::path::{Path, PathBuf};

use glam::{BVec3, DVec3};
use percent_encoding::{AsciiSet, NON_ALPHANUMERIC, percent_decode_str, utf8_percent_encode};
use serde_json::{Value, json};

use super::gltf::{EXTENSION, MIRRORED, PACKED_EXTENSION, mirrored};
use super::{Format, Outline, Produce, spz};
use crate::atomic::{self, Output};
use crate::regular_file::{self, OnFile};
use ashsplat::scene::gaussians::sh_coefficients;
use ashsplat::scene::sh::sh_dc_to_rgb;
use ashsplat::scene::{Bounds, Gaussians};
use ashsplat::{Error, Result};

const FLOAT: u32 = 5126;
const UNSIGNED_BYTE: u32 = 5121;
const ARRAY_BUFFER: u32 = 34_962;

/// Appends the bytes of one Gaussian's attribute.
type Put = Box<dyn Fn(&Gaussians, usize, &mut Vec<u8>)>;

/// One attribute of all Gaussians, stored contiguously.
struct Plane {
    name: String,
    components: usize,
    component_type: u32,
    put: Put,
}

impl Plane {
    fn floats<const N: usize>(name: &str, value: impl Fn(&Gaussians, usize) -> [f32; N] + 'static) -> Self {
        let put: Put = Box::new(move |all, index, bytes| {
            bytes.extend(value(all, index).map(f32::to_le_bytes).as_flattened())
        });
        Self { name: name.into(), components: N, component_type: FLOAT, put }
    }

    fn row_bytes(&self) -> u64 {
        if self.component_type == FLOAT { 4 * self.components as u64 } else { self.components as u64 }
    }
}

/// Writes Gaussians block by block, each attribute at its place. A `.gltf` gets a new `.bin`; then the old one goes.
pub(super) fn write(path: &Path, format: Format, outline: &Outline, produce: &mut Produce<'_>) -> Result<()> {
    let bounds = bounds_of(path, outline)?;
    let planes = planes(outline.sh_degree);
    let binary_bytes = planes.iter().map(|plane| plane.row_bytes()).sum::<u64>() * outline.count;
    let mut document = document(outline, bounds, &planes);
    if format == Format::Gltf {
        // With a new name, an earlier scene stays whole until the .gltf is replaced.
        let (old, new) = (named_binary(path), free_binary(path));
        let name = new.file_name().unwrap_or_default().to_string_lossy().into_owned();
        document["buffers"] =
            json!([{ "uri": utf8_percent_encode(&name, ESCAPED).to_string(), "byteLength": binary_bytes }]);
        atomic::write_seekable(&new, |writer| write_planes(&new, writer, 0, outline, &planes, produce))?;
        let written = atomic::write(path, |writer| writer.write_all(document.to_string().as_bytes()));
        if let Some(unused) = if written.is_ok() { old } else { Some(new) } {
            fs::remove_file(unused).ok();
        }
        return written;
    }
    document["buffers"] = json!([{ "byteLength": binary_bytes }]);
    let head = glb_head(&document, binary_bytes)?;
    atomic::write_seekable(path, |writer| {
        writer.write_all(&head).writing(path)?;
        write_planes(path, writer, head.len() as u64, outline, &planes, produce)
    })
}

fn free_binary(path: &Path) -> PathBuf {
    let mut binary = path.with_extension("bin");
    let mut number = 0;
    while binary.symlink_metadata().is_ok() {
        number += 1;
        binary = path.with_extension(format!("{number}.bin"));
    }
    binary
}

/// The binary that an earlier `.gltf` of this crate names.
fn named_binary(path: &Path) -> Option<PathBuf> {
    /// Longer files are not from this crate.
    const MAX_BYTES: u64 = 1 << 16;
    let text = regular_file::read_at_most(path, MAX_BYTES).ok()??;
    let document: Value = serde_json::from_slice(&text).ok()?;
    let is_own = document["asset"]["generator"].as_str()?.starts_with("ashsplat ");
    let stem = path.file_stem()?.to_str()?;
    let uri = percent_decode_str(document["buffers"][0]["uri"].as_str()?).decode_utf8_lossy();
    let rest = uri.strip_prefix(stem)?.strip_suffix(".bin")?;
    let is_numbered = rest.is_empty() || rest.strip_prefix('.')?.parse::<u32>().is_ok();
    (is_own && is_numbered).then(|| path.with_file_name(format!("{stem}{rest}.bin")))
}

/// The box around the means, which an accessor needs.
fn bounds_of(path: &Path, outline: &Outline) -> Result<Bounds> {
    let problem = "glTF cannot hold a scene without Gaussians";
    outline.bounds.ok_or_else(|| Error::input(path, problem, "choose another format"))
}

/// Beginning of a GLB, before `binary_bytes` of binary data.
pub(crate) fn glb_head(document: &Value, binary_bytes: u64) -> Result<Vec<u8>> {
    let mut json = document.to_string().into_bytes();
    json.resize(json.len().next_multiple_of(4), b' ');
    let total = 12 + 8 + json.len() as u64 + 8 + binary_bytes;
    let (Ok(total), Ok(binary)) = (u32::try_from(total), u32::try_from(binary_bytes)) else {
        let limit = (u32::MAX.into(), "its format; .gltf has no such limit");
        return Err(Error::too_large("a GLB", (total, "bytes"), limit));
    };
    let mut head = Vec::new();
    head.extend(b"glTF");
    head.extend([2, total, json.len() as u32].map(u32::to_le_bytes).as_flattened());
    head.extend(b"JSON");
    head.extend(&json);
    head.extend(binary.to_le_bytes());
    head.extend(b"BIN\0");
    Ok(head)
}

fn write_planes(
    path: &Path,
    writer: &mut dyn Output,
    start: u64,
    outline: &Outline,
    planes: &[Plane],
    produce: &mut Produce<'_>,
) -> Result<()> {
    let (mut done, mut bytes) = (0, Vec::new());
    produce(&mut |mut block| {
        block.mirror(MIRRORED);
        let mut plane_start = start;
        for plane in planes {
            bytes.clear();
            (0..block.len()).for_each(|index| (plane.put)(&block, index, &mut bytes));
            let place = SeekFrom::Start(plane_start + done * plane.row_bytes());
            let written = writer.seek(place).and_then(|_| writer.write_all(&bytes));
            written.writing(path)?;
            plane_start += outline.count * plane.row_bytes();
        }
        done += block.len() as u64;
        Ok(())
    })
}

fn planes(sh_degree: u32) -> Vec<Plane> {
    let own = |name: &str| format!("{EXTENSION}:{name}");
    let color = |all: &Gaussians, index: usize, bytes: &mut Vec<u8>| {
        let byte = |value: f32| (255.0 * value.clamp(0.0, 1.0)).round() as u8;
        bytes.extend(all.sh_of(index)[0].map(|dc| byte(sh_dc_to_rgb(dc))));
        bytes.push(byte(all.opacity(index)));
    };
    let mut planes = vec![
        Plane::floats("POSITION", |all, index| all.means[index]),
        // Fallback for programs that show only points.
        Plane { name: "COLOR_0".into(), components: 4, component_type: UNSIGNED_BYTE, put: Box::new(color) },
        Plane::floats(&own("ROTATION"), |all, index| {
            let [w, x, y, z] = spz::unit(all.quats[index]);
            [x, y, z, w]
        }),
        Plane::floats(&own("SCALE"), |all, index| all.log_scales[index].map(libm::expf)),
        Plane::floats(&own("OPACITY"), |all, index| [all.opacity(index)]),
    ];
    let coefficient = |degree: u32, k: usize| {
        let first = if degree == 0 { 0 } else { sh_coefficients(degree - 1) };
        Plane::floats(&own(&format!("SH_DEGREE_{degree}_COEF_{k}")), move |all, index| {
            all.sh_of(index)[first + k]
        })
    };
    planes.extend(
        (0..=sh_degree).flat_map(|degree| (0..=2 * degree as usize).map(move |k| coefficient(degree, k))),
    );
    planes
}

fn document(outline: &Outline, bounds: Bounds, planes: &[Plane]) -> Value {
    let (mut views, mut accessors, mut attributes) = (Vec::new(), Vec::new(), serde_json::Map::new());
    let mut offset = 0;
    for (index, plane) in planes.iter().enumerate() {
        let bytes = outline.count * plane.row_bytes();
        views.push(json!({ "buffer": 0, "byteOffset": offset, "byteLength": bytes, "target": ARRAY_BUFFER }));
        offset += bytes;
        let kind = ["SCALAR", "VEC2", "VEC3", "VEC4"][plane.components - 1];
        let mut accessor = json!({
            "bufferView": index, "componentType": plane.component_type, "count": outline.count, "type": kind,
        });
        if plane.component_type == UNSIGNED_BYTE {
            accessor["normalized"] = json!(true);
        }
        if index == 0 {
            let [min, max] = mirrored_corners(bounds);
            (accessor["min"], accessor["max"]) = (json!(min), json!(max));
        }
        accessors.push(accessor);
        attributes.insert(plane.name.clone(), json!(index));
    }
    let extension = json!({
        "kernel": "ellipse", "colorSpace": "srgb_rec709_display", "sortingMethod": "cameraDistance", "projection": "perspective",
    });
    scene(outline, &[EXTENSION], (json!(views), json!(accessors)), (json!(attributes), extension))
}

/// The document of one primitive at the Gaussians' origin, without its buffers.
fn scene(
    outline: &Outline,
    extensions: &[&str],
    (views, accessors): (Value, Value),
    (attributes, mut extension): (Value, Value),
) -> Value {
    // The extension has no fields for these marks.
    if outline.options.antialiased {
        extension["extras"]["antialiased"] = json!(true);
    }
    if outline.options.distance_order {
        extension["extras"]["distance_order"] = json!(true);
    }
    if let Some(size) = outline.options.kernel_size {
        // The shortest decimal number with the same f32.
        extension["extras"]["kernel_size"] = json!(size.to_string().parse::<f64>().ok());
    }
    let primitive = json!({ "mode": 0, "attributes": attributes, "extensions": { EXTENSION: extension } });
    let mut document = placed_primitive(primitive, outline.options.frame.origin);
    document["extensionsUsed"] = json!(extensions);
    (document["bufferViews"], document["accessors"]) = (views, accessors);
    document
}

/// The document of one primitive whose positions are relative to an origin, without buffers and accessors.
pub(crate) fn placed_primitive(primitive: Value, origin: DVec3) -> Value {
    let mut node = json!({ "mesh": 0 });
    if origin != DVec3::ZERO {
        node["translation"] = json!(mirrored(origin).to_array());
    }
    json!({
        "asset": { "version": "2.0", "generator": concat!("ashsplat ", env!("CARGO_PKG_VERSION")) },
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": [node],
        "meshes": [{ "primitives": [primitive] }],
    })
}

/// The smallest and the largest corner in glTF's axes. On a mirrored axis they swap.
fn mirrored_corners(bounds: Bounds) -> [[f64; 3]; 2] {
    let [a, b] = [bounds.min, bounds.max].map(|corner| mirrored(corner.as_dvec3()));
    let swaps = BVec3::from(MIRRORED);
    [DVec3::select(swaps, b, a), DVec3::select(swaps, a, b)].map(|corner| corner.to_array())
}

/// Characters of a file's name that a relative URI reference escapes.
const ESCAPED: &AsciiSet = &NON_ALPHANUMERIC.remove(b'-').remove(b'.').remove(b'_').remove(b'~');

/// Writes a GLB whose attributes are an SPZ of version 2: `KHR_gaussian_splatting_compression_spz_2`, a draft. Writes
/// Gaussians block by block; temporary files hold them until they are packed.
///
/// The draft and its readers differ. The draft requires SPZ's own axes (right, up, back), which a loader rotates.
/// CesiumJS (1.145) and the tiles of Cesium ion have glTF's axes instead, and name neither kernel nor colour space.
/// This function writes what CesiumJS reads. The reader reads both: a primitive that names its kernel follows the draft.
pub(super) fn write_packed(path: &Path, outline: &Outline, produce: &mut Produce<'_>) -> Result<()> {
    let bounds = bounds_of(path, outline)?;
    let mut packed = spz::old(path, 2, MIRRORED, outline, produce)?;
    let bytes = packed.metadata().writing(path)?.len();
    // The accessors describe the unpacked attributes and have no bytes of their own.
    let [min, max] = mirrored_corners(bounds);
    let floats = |kind: &str| json!({ "componentType": FLOAT, "type": kind, "count": outline.count });
    let mut accessors = vec![
        json!({ "componentType": FLOAT, "type": "VEC3", "count": outline.count, "min": min, "max": max }),
        json!({ "componentType": UNSIGNED_BYTE, "normalized": true, "type": "VEC4", "count": outline.count }),
        floats("VEC4"),
        floats("VEC3"),
    ];
    let own = |name: &str| format!("{EXTENSION}:{name}");
    let mut attributes = json!({ "POSITION": 0, "COLOR_0": 1, own("ROTATION"): 2, own("SCALE"): 3 });
    let coefficients = (1..=outline.sh_degree).flat_map(|degree| (0..=2 * degree).map(move |k| (degree, k)));
    for (degree, k) in coefficients {
        attributes[own(&format!("SH_DEGREE_{degree}_COEF_{k}"))] = json!(accessors.len());
        accessors.push(floats("VEC3"));
    }
    let padded = bytes.next_multiple_of(4);
    let views = json!([{ "buffer": 0, "byteLength": bytes }]);
    let extension = json!({ "extensions": { PACKED_EXTENSION: { "bufferView": 0 } } });
    let extensions = [EXTENSION, PACKED_EXTENSION];
    let mut document = scene(outline, &extensions, (views, json!(accessors)), (attributes, extension));
    document["extensionsRequired"] = json!(extensions);
    document["buffers"] = json!([{ "byteLength": padded }]);
    let head = glb_head(&document, padded)?;
    atomic::write(path, |writer| {
        writer.write_all(&head)?;
        io::copy(&mut packed, writer)?;
        writer.write_all(&[0; 3][..(padded - bytes) as usize])
    })
}
