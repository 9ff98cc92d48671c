//! Writes meshes with coloured vertices: PLY, OBJ and GLB.
//!
//! Positions are in source units, as in files of Gaussians. A comment or the node's translation names their origin if it is not
//! zero. GLB has glTF's axes and linear colours.

use std::io::{self, Write};
use std::path::Path;

use glam::{DVec3, Vec3};
use serde_json::json;

use crate::regular_file::OnFile;
use crate::splats::{glb_head, mirrored, placed_primitive};
use crate::{atomic, ply};
use ashsplat::scene::{WorldFrame, linear_from_srgb};
use ashsplat::surface::Mesh;
use ashsplat::{Error, Result};

/// File format of a mesh.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MeshFormat {
    /// Binary little endian, colours as uchar.
    Ply,
    /// Wavefront OBJ, colours behind the positions.
    Obj,
    /// Binary glTF.
    Glb,
}

impl MeshFormat {
    /// Returns the format that a file's ending names.
    ///
    /// # Errors
    /// [`Error::Input`] for another ending.
    pub fn of(path: &Path) -> Result<Self> {
        let ending = path.extension().map(|ending| ending.to_string_lossy().to_lowercase());
        match ending.as_deref() {
            Some("ply") => Ok(Self::Ply),
            Some("obj") => Ok(Self::Obj),
            Some("glb") => Ok(Self::Glb),
            _ => Err(Error::input(
                path,
                "names no format of a mesh that is written",
                "end it in .ply, .obj or .glb",
            )),
        }
    }

    /// Writes a mesh in the world coordinates of `frame`.
    pub fn write(self, path: &Path, mesh: &Mesh, frame: &WorldFrame) -> Result<()> {
        atomic::write_seekable(path, |mut writer| match self {
            Self::Ply => write_ply(&mut writer, mesh, frame).writing(path),
            Self::Obj => write_obj(&mut writer, mesh, frame).writing(path),
            Self::Glb => write_glb(path, &mut writer, mesh, frame),
        })
    }
}

/// Positions in source units from the frame's origin.
fn positions(mesh: &Mesh, frame: &WorldFrame) -> impl Iterator<Item = Vec3> {
    let unit = frame.unit;
    mesh.positions.iter().map(move |at| (unit * Vec3::from_array(*at).as_dvec3()).as_vec3())
}

fn write_ply(writer: &mut impl Write, mesh: &Mesh, frame: &WorldFrame) -> io::Result<()> {
    write!(writer, "ply\nformat binary_little_endian 1.0\n")?;
    ply::write_frame(writer, frame)?;
    writeln!(writer, "element vertex {}", mesh.positions.len())?;
    for axis in ["x", "y", "z"] {
        writeln!(writer, "property float {axis}")?;
    }
    for channel in ["red", "green", "blue"] {
        writeln!(writer, "property uchar {channel}")?;
    }
    writeln!(writer, "element face {}", mesh.triangles.len())?;
    write!(writer, "property list uchar int vertex_indices\nend_header\n")?;
    for (at, color) in positions(mesh, frame).zip(&mesh.colors) {
        writer.write_all(at.to_array().map(f32::to_le_bytes).as_flattened())?;
        writer.write_all(color)?;
    }
    for triangle in &mesh.triangles {
        writer.write_all(&[3])?;
        writer.write_all(triangle.map(u32::to_le_bytes).as_flattened())?;
    }
    Ok(())
}

fn write_obj(writer: &mut impl Write, mesh: &Mesh, frame: &WorldFrame) -> io::Result<()> {
    if frame.origin != DVec3::ZERO {
        let DVec3 { x, y, z } = frame.origin;
        writeln!(writer, "# origin {x} {y} {z}")?;
    }
    for (Vec3 { x, y, z }, color) in positions(mesh, frame).zip(&mesh.colors) {
        let [r, g, b] = color.map(|channel| f32::from(channel) / 255.0);
        writeln!(writer, "v {x} {y} {z} {r:.4} {g:.4} {b:.4}")?;
    }
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(|vertex| vertex + 1);
        writeln!(writer, "f {a} {b} {c}")?;
    }
    Ok(())
}

fn write_glb(path: &Path, writer: &mut impl Write, mesh: &Mesh, frame: &WorldFrame) -> Result<()> {
    const FLOAT: u32 = 5126;
    const UNSIGNED_SHORT: u32 = 5123;
    const UNSIGNED_INT: u32 = 5125;
    let place = |at: Vec3| mirrored(at.as_dvec3()).as_vec3();
    let low = positions(mesh, frame).map(place).reduce(Vec3::min).unwrap_or_default();
    let high = positions(mesh, frame).map(place).reduce(Vec3::max).unwrap_or_default();
    let (vertices, indices) = (mesh.positions.len() as u64, 3 * mesh.triangles.len() as u64);
    let (colors_at, indices_at, bytes) = (12 * vertices, 20 * vertices, 20 * vertices + 4 * indices);
    let primitive = json!({ "attributes": { "POSITION": 0, "COLOR_0": 1 }, "indices": 2, "material": 0 });
    let mut document = placed_primitive(primitive, frame.origin);
    document["buffers"] = json!([{ "byteLength": bytes }]);
    document["bufferViews"] = json!([
        { "buffer": 0, "byteLength": 12 * vertices, "target": 34_962 },
        { "buffer": 0, "byteOffset": colors_at, "byteLength": 8 * vertices, "target": 34_962 },
        { "buffer": 0, "byteOffset": indices_at, "byteLength": 4 * indices, "target": 34_963 },
    ]);
    document["accessors"] = json!([
        {
            "bufferView": 0, "componentType": FLOAT, "count": vertices, "type": "VEC3",
            "min": low.to_array(), "max": high.to_array(),
        },
        { "bufferView": 1, "componentType": UNSIGNED_SHORT, "normalized": true, "count": vertices, "type": "VEC4" },
        { "bufferView": 2, "componentType": UNSIGNED_INT, "count": indices, "type": "SCALAR" },
    ]);
    // Colours are lit already.
    document["extensionsUsed"] = json!(["KHR_materials_unlit"]);
    document["materials"] = json!([{ "extensions": { "KHR_materials_unlit": {} } }]);
    writer.write_all(&glb_head(&document, bytes)?).writing(path)?;
    for at in positions(mesh, frame).map(place) {
        writer.write_all(at.to_array().map(f32::to_le_bytes).as_flattened()).writing(path)?;
    }
    for color in &mesh.colors {
        let light = |channel: u8| (linear_from_srgb(f32::from(channel) / 255.0) * 65535.0).round() as u16;
        let [r, g, b] = color.map(light);
        writer.write_all([r, g, b, u16::MAX].map(u16::to_le_bytes).as_flattened()).writing(path)?;
    }
    for vertex in mesh.triangles.as_flattened() {
        writer.write_all(&vertex.to_le_bytes()).writing(path)?;
    }
    Ok(())
}
