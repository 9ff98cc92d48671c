//! Reads the JSON of a glTF, and finds its buffers and the numbers in them.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::ops::Range;
use std::path::{Component, Path, PathBuf};

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use glam::{DMat4, DQuat, DVec3};
use percent_encoding::percent_decode_str;
use serde::de::IgnoredAny;
use serde::{Deserialize, Deserializer};

use super::Format;
use crate::ply::{Encoding, Scalar, decode};
use crate::regular_file::{self, OnFile, damaged, u32_at};
use crate::{cost, host_memory};
use ashsplat::scene::Similarity;
use ashsplat::{Error, Result};

/// Largest relative deviation of a node's axes from orthogonal and equal length.
const SHAPE_TOLERANCE: f64 = 1e-4;
const GLB_JSON: u32 = 0x4e4f_534a;
const GLB_BINARY: u32 = 0x004e_4942;

/// The used parts of the JSON.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase", default)]
#[derive(Default)]
pub(super) struct Document {
    extensions_required: Vec<String>,
    buffers: Vec<BufferJson>,
    pub(super) buffer_views: Vec<BufferView>,
    pub(super) accessors: Vec<AccessorJson>,
    pub(super) meshes: Vec<Mesh>,
    nodes: Vec<NodeSlot>,
    scenes: Vec<SceneJson>,
    scene: Option<usize>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct BufferJson {
    uri: Option<String>,
    byte_length: u64,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct BufferView {
    pub(super) buffer: usize,
    #[serde(default)]
    pub(super) byte_offset: u64,
    pub(super) byte_length: u64,
    pub(super) byte_stride: Option<u64>,
    #[serde(default)]
    pub(super) extensions: BTreeMap<String, IgnoredAny>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct AccessorJson {
    pub(super) buffer_view: Option<usize>,
    #[serde(default)]
    pub(super) byte_offset: u64,
    pub(super) component_type: u32,
    #[serde(default)]
    pub(super) normalized: bool,
    pub(super) count: u64,
    #[serde(rename = "type")]
    pub(super) kind: String,
    pub(super) sparse: Option<IgnoredAny>,
}

#[derive(Deserialize)]
pub(super) struct Mesh {
    pub(super) primitives: Vec<Primitive>,
}

#[derive(Deserialize)]
pub(super) struct Primitive {
    pub(super) attributes: BTreeMap<String, usize>,
    #[serde(default)]
    pub(super) extensions: PrimitiveExtensions,
}

#[derive(Deserialize, Default)]
pub(super) struct PrimitiveExtensions {
    #[serde(rename = "KHR_gaussian_splatting")]
    pub(super) splats: Option<Box<SplatsExtension>>,
}

#[derive(Deserialize, Default)]
#[serde(rename_all = "camelCase", default)]
pub(super) struct SplatsExtension {
    pub(super) kernel: Option<String>,
    pub(super) color_space: Option<String>,
    pub(super) extras: SplatsExtras,
    /// Compressions by name.
    pub(super) extensions: BTreeMap<String, Compression>,
}

#[derive(Deserialize, Default)]
#[serde(default)]
pub(super) struct SplatsExtras {
    pub(super) antialiased: bool,
    pub(super) kernel_size: Option<f64>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Compression {
    pub(super) buffer_view: Option<usize>,
}

/// A node; `None` for an empty one, so that millions of `{}` take little memory.
struct NodeSlot(Option<Box<Node>>);

impl<'de> Deserialize<'de> for NodeSlot {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let node = Node::deserialize(deserializer)?;
        Ok(Self((node != Node::default()).then(|| Box::new(node))))
    }
}

impl NodeSlot {
    fn children(&self) -> &[usize] {
        self.0.as_ref().map_or(&[], |node| &node.children)
    }
}

#[derive(Deserialize, Default, PartialEq)]
#[serde(default)]
struct Node {
    mesh: Option<usize>,
    children: Vec<usize>,
    matrix: Option<Box<[f64; 16]>>,
    translation: Option<Box<[f64; 3]>>,
    rotation: Option<Box<[f64; 4]>>,
    scale: Option<Box<[f64; 3]>>,
}

#[derive(Deserialize)]
struct SceneJson {
    #[serde(default)]
    nodes: Vec<usize>,
}

impl Document {
    pub(super) fn open(path: &Path, format: Format, limit: Option<u64>) -> Result<(Self, Buffers)> {
        let (mut file, bytes) = regular_file::open(path)?;
        let (json, binary) = if format == Format::Glb {
            glb_chunks(path, &mut file, bytes, limit)?
        } else {
            host_memory::check(path, bytes, limit)?;
            let mut json = host_memory::reserved(path, bytes)?;
            file.by_ref().take(bytes).read_to_end(&mut json).reading(path)?;
            (json, None)
        };
        regular_file::check_json(path, &json, limit)?;
        let document: Self = serde_json::from_slice(&json)
            .map_err(|e| damaged(path, format!("the JSON is not a glTF: {e}")))?;
        let mut binary =
            binary.map(|(offset, bytes)| Buffer::File { path: path.to_owned(), file, offset, bytes });
        let mut buffers = Vec::new();
        for (index, json) in document.buffers.iter().enumerate() {
            let buffer = match &json.uri {
                Some(uri) => open_uri(path, index, uri)?,
                None => binary.take().ok_or_else(|| damaged(path, format!("buffer {index} has no data")))?,
            };
            if json.byte_length > buffer.bytes() {
                let (says, has) = (json.byte_length, buffer.bytes());
                return Err(damaged(path, format!("buffer {index} should have {says} bytes, has {has}")));
            }
            buffers.push(buffer);
        }
        Ok((document, Buffers(buffers)))
    }

    /// Required extensions that would change the picture and are not supported.
    pub(super) fn unread_extensions(&self) -> impl Iterator<Item = &String> {
        let is_read = |name: &&String| {
            [super::EXTENSION, super::PACKED_EXTENSION].contains(&name.as_str())
                || ["KHR_materials_", "KHR_texture_"].iter().any(|start| name.starts_with(start))
        };
        self.extensions_required.iter().filter(move |name| !is_read(name))
    }

    /// The meshes of the scene, each with its placement in the world.
    pub(super) fn placed_meshes(&self, path: &Path) -> Result<Vec<(usize, Similarity)>> {
        if self.nodes.is_empty() {
            return Ok((0..self.meshes.len()).map(|mesh| (mesh, Similarity::default())).collect());
        }
        let mut is_child = vec![false; self.nodes.len()];
        for &child in self.nodes.iter().flat_map(NodeSlot::children) {
            cost::step();
            is_child.get_mut(child).into_iter().for_each(|known| *known = true);
        }
        let roots: Vec<usize> = match self.scenes.get(self.scene.unwrap_or(0)) {
            Some(scene) => scene.nodes.clone(),
            None => (0..self.nodes.len()).filter(|&index| !is_child[index]).collect(),
        };
        let mut placed = Vec::new();
        // For each node on the path to the current one: its unvisited children, and its placement.
        let mut open = vec![(roots.iter(), Similarity::default())];
        let mut seen = vec![false; self.nodes.len()];
        while let Some((children, parent)) = open.last_mut() {
            cost::step();
            let Some(&index) = children.next() else {
                open.pop();
                continue;
            };
            let NodeSlot(node) =
                self.nodes.get(index).ok_or_else(|| damaged(path, format!("node {index} is missing")))?;
            if std::mem::replace(&mut seen[index], true) {
                return Err(damaged(path, format!("node {index} has two parents, or is its own")));
            }
            let Some(node) = node else { continue };
            let own = node.placement().ok_or_else(|| {
                let problem =
                    format!("node {index}: its transform shears, mirrors, or scales the axes differently");
                Error::input(path, problem, "apply the transform before writing the file")
            })?;
            let place = parent.after(&own);
            placed.extend(node.mesh.map(|mesh| (mesh, place)));
            open.push((node.children.iter(), place));
        }
        Ok(placed)
    }
}

impl Node {
    /// The node's transform; `None` if it is not a similarity.
    fn placement(&self) -> Option<Similarity> {
        let scale = self.scale.as_deref().map_or(DVec3::ONE, |&scale| scale.into());
        let rotation = self.rotation.as_deref().map(|&xyzw| DQuat::from_array(xyzw).normalize());
        let place = self.translation.as_deref().map_or(DVec3::ZERO, |&place| place.into());
        let parts =
            || DMat4::from_scale_rotation_translation(scale, rotation.unwrap_or(DQuat::IDENTITY), place);
        let matrix = self.matrix.as_deref().map_or_else(parts, DMat4::from_cols_array);
        similarity(matrix)
    }
}

/// The similarity of a matrix; `None` if it is none.
pub(in super::super) fn similarity(matrix: DMat4) -> Option<Similarity> {
    if matrix == DMat4::IDENTITY {
        return Some(Similarity::default());
    }
    let axes = glam::DMat3::from_mat4(matrix);
    let scale = axes.determinant().cbrt();
    let rotation = axes * (1.0 / scale);
    let orthonormal = (rotation * rotation.transpose()).abs_diff_eq(glam::DMat3::IDENTITY, SHAPE_TOLERANCE);
    let usable = matrix.is_finite() && scale > 0.0 && orthonormal;
    usable.then(|| Similarity {
        rotation: DQuat::from_mat3(&rotation).normalize(),
        scale,
        translation: matrix.w_axis.truncate(),
    })
}

/// The JSON of a GLB, and the offset and length of its binary chunk.
type Chunks = (Vec<u8>, Option<(u64, u64)>);

fn glb_chunks(path: &Path, file: &mut File, bytes: u64, limit: Option<u64>) -> Result<Chunks> {
    let mut head = [0; 20];
    if bytes < head.len() as u64 {
        return Err(damaged(path, format!("ends after {bytes} bytes, inside its header")));
    }
    file.read_exact(&mut head).reading(path)?;
    let [version, length, json_bytes, json_kind] = [4, 8, 12, 16].map(|at| u32_at(&head, at));
    if &head[..4] != b"glTF" || version != 2 {
        return Err(damaged(path, "is no binary glTF of version 2"));
    }
    if u64::from(length) > bytes || u64::from(json_bytes) + 20 > bytes {
        return Err(damaged(path, format!("the header says {length} bytes, the file has {bytes}")));
    }
    if json_kind != GLB_JSON {
        return Err(damaged(path, "its first chunk is not JSON"));
    }
    host_memory::check(path, json_bytes.into(), limit)?;
    let mut json = vec![0; json_bytes as usize];
    file.read_exact(&mut json).reading(path)?;
    let at = 20 + u64::from(json_bytes);
    let mut chunk = [0; 8];
    if at + 8 > bytes || file.read_exact(&mut chunk).is_err() {
        return Ok((json, None));
    }
    let [length, kind] = [0, 4].map(|at| u32_at(&chunk, at));
    if kind == GLB_BINARY && at + 8 + u64::from(length) > bytes {
        let left = bytes - at - 8;
        return Err(damaged(path, format!("the binary chunk should have {length} bytes, {left} are left")));
    }
    Ok((json, (kind == GLB_BINARY).then_some((at + 8, u64::from(length)))))
}

fn open_uri(path: &Path, index: usize, uri: &str) -> Result<Buffer> {
    if let Some((_, data)) = uri.strip_prefix("data:").and_then(|rest| rest.split_once(";base64,")) {
        let data = STANDARD.decode(data).map_err(|e| damaged(path, format!("buffer {index}: {e}")))?;
        return Ok(Buffer::Memory(data));
    }
    let name = percent_decode_str(uri).decode_utf8_lossy().into_owned();
    let inside = |c: Component<'_>| matches!(c, Component::Normal(_) | Component::CurDir);
    if uri.contains("://") || name.contains(['\\', '\0']) || !Path::new(&name).components().all(inside) {
        let problem = format!("buffer {index}: {uri:?} leads out of the file's folder");
        return Err(Error::input(path, problem, "buffers must be files beside or below it"));
    }
    let path = path.with_file_name(name);
    let (file, bytes) = regular_file::open(&path)?;
    Ok(Buffer::File { path, file, offset: 0, bytes })
}

/// Largest stride in glTF, bytes.
const MAX_STRIDE: u64 = 252;

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
            Self::File { path, file, offset, .. } => {
                file.seek(SeekFrom::Start(*offset + at)).and_then(|_| file.read_exact(data)).reading(path)
            }
            Self::Memory(all) => {
                data.copy_from_slice(&all[at as usize..at as usize + data.len()]);
                Ok(())
            }
        }
    }
}

/// Rows of numbers, checked to lie within their buffer.
pub(super) struct Accessor {
    buffer: usize,
    offset: u64,
    stride: u64,
    pub(super) count: usize,
    components: usize,
    component: Scalar,
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
        let component = match accessor.component_type {
            5120 => Scalar::I8,
            5121 => Scalar::U8,
            5122 => Scalar::I16,
            5123 => Scalar::U16,
            5126 => Scalar::F32,
            other => return Err(format!("accessor {index} has component type {other}")),
        };
        let kind = ["SCALAR", "VEC2", "VEC3", "VEC4"][components - 1];
        if accessor.kind != kind {
            return Err(format!("accessor {index} is {}, not {kind}", accessor.kind));
        }
        let Some(view_index) = accessor.buffer_view.filter(|_| accessor.sparse.is_none()) else {
            return Err(format!("accessor {index} is sparse, which is not read"));
        };
        let view = document.buffer_views.get(view_index);
        let view = view.ok_or_else(|| format!("buffer view {view_index} is missing"))?;
        if let Some(extension) = view.extensions.keys().next() {
            return Err(format!("its buffer view is compressed ({extension}), which is not read"));
        }
        let buffer = buffers.0.get(view.buffer);
        let buffer = buffer.ok_or_else(|| format!("buffer {} is missing", view.buffer))?;
        let row = (components * component.bytes()) as u64;
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

    pub(super) fn bytes(&self) -> u64 {
        self.count as u64 * (self.components * self.component.bytes()) as u64
    }

    pub(super) fn read(&self, buffers: &mut Buffers, rows: Range<usize>) -> Result<Vec<f32>> {
        let mut values = Vec::with_capacity(rows.len() * self.components);
        if rows.is_empty() {
            return Ok(values);
        }
        let size = self.component.bytes();
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
        let value = decode(bytes, self.component, Encoding::BinaryLittleEndian) as f32;
        let largest = match self.component {
            Scalar::I8 => 127.0,
            Scalar::U8 => 255.0,
            Scalar::I16 => 32_767.0,
            Scalar::U16 => 65_535.0,
            _ => return value,
        };
        if self.normalized { (value / largest).max(-1.0) } else { value }
    }
}
