//! Reads glTF and GLB with `KHR_gaussian_splatting` (ratified form: linear scales, quaternions x, y, z, w).
//!
//! glTF's y points up, and its z towards the viewer of a scene's front: x and y are opposite to this crate's.

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

use crate::ply::{Encoding, Scalar, decode};
use crate::regular_file::{OnFile, damaged, u32_at};
use crate::splats::spz::Spz;
use crate::splats::{BLOCK, Format, Header, Opened, ReadOptions, Sink, is_kernel_size};
use crate::{cost, host_memory, regular_file};
use ashsplat::scene::gaussians::{MAX_SH_DEGREE, sh_coefficients};
use ashsplat::scene::{Gaussians, Similarity, WorldFrame};
use ashsplat::{Error, Result};

/// Axes of glTF that are opposite to those of this crate's frame.
pub(super) const MIRRORED: [bool; 3] = [true, true, false];
pub(crate) const EXTENSION: &str = "KHR_gaussian_splatting";
/// The extension that packs its attributes as an SPZ.
pub(crate) const PACKED_EXTENSION: &str = "KHR_gaussian_splatting_compression_spz_2";
/// Least distance of a stored opacity from 0 and 1, whose logits are infinite.
const OPACITY_MARGIN: f64 = 3e-8;
/// Largest rounding error of an opacity beyond 0 and 1.
const OPACITY_SLACK: f32 = 1e-3;
/// Largest number of placed primitives.
const MAX_PARTS: usize = 1 << 16;
/// Number of Gaussians that may be placed any number of times, however few the file has.
const FREE_GAUSSIANS: u64 = 1 << 20;
/// Largest number of uses of each byte of the file, if there are more Gaussians than these.
const MAX_USES: u64 = 16;

/// A primitive of Gaussians at a node.
struct Part {
    placement: Similarity,
    header: Header,
    bytes: u64,
    rows: Rows,
}

enum Rows {
    Plain(PlainRows),
    /// An SPZ. `has_own_axes` tells SPZ's axes from glTF's (see [`super::gltf_write::write_packed`]).
    Packed {
        spz: Spz,
        has_own_axes: bool,
    },
}

struct PlainRows {
    position: Accessor,
    rotation: Accessor,
    scale: Accessor,
    opacity: Accessor,
    sh: Vec<Accessor>,
}

pub(super) fn open(path: &Path, format: Format, options: &ReadOptions) -> Result<Opened<'static>> {
    let (document, mut buffers) = Document::open(path, format, options.max_host_memory)?;
    let mut header = Header::new(format, 0, 0);
    let shown = path.display();
    for name in document.unread_extensions() {
        header.warnings.push(format!("{shown}: requires {name}, which is not read"));
    }
    let mut parts = Vec::new();
    let (held, mut used, mut others) = (buffers.bytes(), 0_u64, 0);
    let mut uses: BTreeMap<(usize, usize), u64> = BTreeMap::new();
    // Many nodes may share a mesh, which may have many other primitives.
    let splats: Vec<Vec<_>> = document.meshes.iter().map(splats_of).collect();
    for (mesh_index, placement) in document.placed_meshes(path)? {
        let Some(mesh) = splats.get(mesh_index) else {
            let problem = format!("a node has mesh {mesh_index}, there are {}", document.meshes.len());
            return Err(damaged(path, problem));
        };
        others += document.meshes[mesh_index].primitives.len() - mesh.len();
        for &(index, primitive, extension) in mesh {
            cost::step();
            let place = &format!("mesh {mesh_index}, primitive {index}");
            let mut warn = |what: String| header.warnings.push(format!("{shown}: {place}: {what}"));
            match extension.color_space.as_deref() {
                None | Some("srgb_rec709_display") => {}
                Some("lin_rec709_display") => warn("colours are linear; they are used as they are".into()),
                Some(other) => warn(format!("colours of the space {other:?} are used as sRGB")),
            }
            if let Some(kernel) = extension.kernel.as_deref().filter(|&kernel| kernel != "ellipse") {
                warn(format!("the kernel {kernel:?} is drawn as an ellipse"));
            }
            header.antialiased |= extension.extras.antialiased;
            header.distance_order |= extension.extras.distance_order;
            let kernel_size = extension.extras.kernel_size.map(|size| size as f32);
            header.kernel_size = kernel_size.filter(is_kernel_size).or(header.kernel_size);
            let (document, buffers) = (&document, &buffers);
            let attributes = Attributes { path, place, document, buffers, primitive, extension };
            let part = attributes.part(placement)?;
            *uses.entry((mesh_index, index)).or_insert(0) += u64::from(part.rows.are_packed());
            header.warnings.extend(part.header.warnings.iter().cloned());
            header.antialiased |= part.header.antialiased;
            used = used.saturating_add(part.bytes);
            header.count = header.count.saturating_add(part.header.count);
            parts.push(part);
            // A few bytes could claim any number of Gaussians, placed at many nodes. Packed ones are unpacked for
            // each node.
            let copies = header.count > FREE_GAUSSIANS && used / MAX_USES > held
                || uses.get(&(mesh_index, index)).is_some_and(|&uses| uses > MAX_USES);
            if copies || parts.len() > MAX_PARTS {
                let (count, places) = (header.count, parts.len());
                let problem = format!(
                    "places the same Gaussians again and again: {count} or more at {places} places from {held} bytes"
                );
                let remedy = format!("place each at most {MAX_USES} times, at {MAX_PARTS} places in all");
                return Err(Error::input(path, problem, remedy));
            }
        }
    }
    if parts.is_empty() {
        let problem = format!("has no Gaussians (no placed primitive with {EXTENSION})");
        return Err(Error::input(path, problem, "is it a mesh?"));
    }
    if others > 0 {
        header.warnings.push(format!("{shown}: {others} primitives that are no Gaussians are not used"));
    }
    header.sh_degree = parts.iter().map(|part| part.header.sh_degree).max().unwrap_or(0);
    let placements: Vec<Similarity> = parts.iter().map(|part| part.placement).collect();
    let path = path.to_owned();
    let mut read = move |origin: DVec3, sink: &mut Sink<'_>| {
        let blocks = |part: &mut Part| part.read(&path, &mut buffers, origin, sink);
        parts.iter_mut().try_for_each(blocks)
    };
    let origin = origin_of(&placements, &mut read);
    header.origin = origin;
    Ok((header, Box::new(move |sink| read(origin, sink))))
}

/// Chooses an origin near the first block of Gaussians if a node moves its Gaussians; zero otherwise. `read` passes the
/// Gaussians relative to an origin.
pub(super) fn origin_of(
    placements: &[Similarity],
    mut read: impl FnMut(DVec3, &mut Sink<'_>) -> Result<()>,
) -> DVec3 {
    let moved = placements.iter().find(|placement| placement.translation != DVec3::ZERO);
    let Some(near) = moved.map(|placement| mirrored(placement.translation)) else { return DVec3::ZERO };
    let mut points = Vec::new();
    // The error stops the reading after the first block. The main reader reports any other error again.
    drop(read(near, &mut |block| {
        points = block.means.iter().map(|mean| near + DVec3::from_array(mean.map(f64::from))).collect();
        Err(Error::Interrupted)
    }));
    WorldFrame::around(&points).origin
}

/// Moves Gaussians from a node of glTF's axes to this crate's, relative to an origin.
pub(super) fn placed(mut block: Gaussians, placement: &Similarity, origin: DVec3) -> Gaussians {
    let translation = placement.translation - mirrored(origin);
    block.transform(&Similarity { translation, ..*placement });
    block.mirror(MIRRORED);
    block
}

/// Converts a point from glTF's axes to this crate's, and back.
pub(crate) fn mirrored(point: DVec3) -> DVec3 {
    DVec3::from_array(std::array::from_fn(|axis| if MIRRORED[axis] { -point[axis] } else { point[axis] }))
}

/// The primitives of Gaussians in a mesh, with their indices.
fn splats_of(mesh: &Mesh) -> Vec<(usize, &Primitive, &SplatsExtension)> {
    let own = |(index, primitive)| {
        cost::step();
        let primitive: &Primitive = primitive;
        Some((index, primitive, primitive.extensions.splats.as_deref()?))
    };
    mesh.primitives.iter().enumerate().filter_map(own).collect()
}

struct Attributes<'a> {
    path: &'a Path,
    place: &'a str,
    document: &'a Document,
    buffers: &'a Buffers,
    primitive: &'a Primitive,
    extension: &'a SplatsExtension,
}

impl Attributes<'_> {
    fn part(&self, placement: Similarity) -> Result<Part> {
        if let Some(packed) = self.extension.extensions.get(PACKED_EXTENSION) {
            let (header, mut spz, bytes) = self.packed(packed)?;
            let has_own_axes = self.extension.kernel.is_some();
            spz.mirrored = spz.mirrored.map(|is_mirrored| is_mirrored && has_own_axes);
            return Ok(Part { placement, header, bytes, rows: Rows::Packed { spz, has_own_axes } });
        }
        let own = |name: &str| format!("{EXTENSION}:{name}");
        let rows = PlainRows {
            position: self.required("POSITION", 3)?,
            rotation: self.required(&own("ROTATION"), 4)?,
            scale: self.required(&own("SCALE"), 3)?,
            opacity: self.required(&own("OPACITY"), 1)?,
            sh: self.sh(&own)?,
        };
        let all = || [&rows.position, &rows.rotation, &rows.scale, &rows.opacity].into_iter().chain(&rows.sh);
        let count = rows.position.count;
        if let Some(odd) = all().map(|accessor| accessor.count).find(|&other| other != count) {
            let problem = format!("{}: {count} positions, but {odd} of another attribute", self.place);
            return Err(damaged(self.path, problem));
        }
        let bytes = all().map(Accessor::bytes).sum();
        let header = Header::new(Format::Gltf, count as u64, rows.sh_degree());
        Ok(Part { placement, header, bytes, rows: Rows::Plain(rows) })
    }

    /// The SPZ of a packed primitive, and its number of bytes.
    fn packed(&self, packed: &Compression) -> Result<(Header, Spz, u64)> {
        let Self { path, place, document, .. } = *self;
        let wrong = |problem: &str| damaged(path, format!("{place}: {PACKED_EXTENSION}: {problem}"));
        let view = packed.buffer_view.and_then(|index| document.buffer_views.get(index));
        let view = view.ok_or_else(|| wrong("its buffer view is missing"))?;
        let buffer = self.buffers.0.get(view.buffer).ok_or_else(|| wrong("its buffer is missing"))?;
        if view.byte_offset.checked_add(view.byte_length).is_none_or(|end| end > buffer.bytes()) {
            return Err(wrong("its buffer view ends behind its buffer"));
        }
        let Buffer::File { path: file, offset, .. } = buffer else {
            let problem = format!("{place}: an SPZ inside the JSON is not read");
            return Err(Error::input(path, problem, "write it as .glb, or with a .bin"));
        };
        let (header, spz) = Spz::inside(file, offset + view.byte_offset, view.byte_length)?;
        let found = header.count;
        let positions = self.primitive.attributes.get("POSITION").and_then(|&at| document.accessors.get(at));
        match positions.map_or(found, |accessor| accessor.count) {
            expected if expected != found => {
                Err(wrong(&format!("{found} Gaussians, where {expected} are due")))
            }
            _ => Ok((header, spz, view.byte_length)),
        }
    }

    fn sh(&self, own: &dyn Fn(&str) -> String) -> Result<Vec<Accessor>> {
        let mut sh = vec![self.required(&own("SH_DEGREE_0_COEF_0"), 3)?];
        for degree in 1..=MAX_SH_DEGREE {
            let names: Vec<String> =
                (0..=2 * degree).map(|k| own(&format!("SH_DEGREE_{degree}_COEF_{k}"))).collect();
            if !names.iter().any(|name| self.primitive.attributes.contains_key(name)) {
                break;
            }
            for name in &names {
                sh.push(self.required(name, 3)?);
            }
        }
        Ok(sh)
    }

    fn required(&self, name: &str, components: usize) -> Result<Accessor> {
        let Some(&index) = self.primitive.attributes.get(name) else {
            let problem = format!("{}: has no attribute {name}", self.place);
            let packed = self.extension.extensions.keys().next();
            let remedy = match packed {
                Some(packed) => {
                    format!("its compression {packed} is not read: unpack it with another program")
                }
                None => "write it in the ratified form of the extension".into(),
            };
            return Err(Error::input(self.path, problem, remedy));
        };
        let problem = |problem: String| damaged(self.path, format!("{}: {name}: {problem}", self.place));
        Accessor::new(self.document, self.buffers, index, components).map_err(problem)
    }
}

impl Part {
    /// Passes the Gaussians to a sink, relative to an origin.
    fn read(&mut self, path: &Path, buffers: &mut Buffers, origin: DVec3, sink: &mut Sink<'_>) -> Result<()> {
        let placement = &self.placement;
        match &self.rows {
            Rows::Plain(rows) => {
                let count = rows.position.count;
                let mut starts = (0..count).step_by(BLOCK);
                starts.try_for_each(|start| {
                    let block = rows.read(path, buffers, start..(start + BLOCK).min(count))?;
                    sink(placed(block, placement, origin))
                })
            }
            Rows::Packed { spz, has_own_axes } => spz.read(&mut |mut block| {
                if *has_own_axes {
                    block.mirror(MIRRORED);
                }
                sink(placed(block, placement, origin))
            }),
        }
    }
}

impl Rows {
    fn are_packed(&self) -> bool {
        matches!(self, Self::Packed { .. })
    }
}

impl PlainRows {
    fn sh_degree(&self) -> u32 {
        (0..=MAX_SH_DEGREE).find(|&degree| sh_coefficients(degree) == self.sh.len()).unwrap_or(0)
    }

    fn read(&self, path: &Path, buffers: &mut Buffers, rows: Range<usize>) -> Result<Gaussians> {
        let mut values = |accessor: &Accessor| accessor.read(buffers, rows.clone());
        let means = triples(&values(&self.position)?);
        let quats = values(&self.rotation)?;
        let quats = quats.as_chunks::<4>().0.iter().map(|&[x, y, z, w]| [w, x, y, z]).collect();
        let sizes = values(&self.scale)?;
        if sizes.iter().any(|&size| size < 0.0) {
            let remedy = "write sizes, not their logarithms, as the extension says";
            return Err(Error::input(path, format!("{EXTENSION}:SCALE has values below 0"), remedy));
        }
        let log_scales = triples(&sizes).into_iter().map(|s| s.map(libm::logf)).collect();
        let opacity_logits: Vec<f32> = values(&self.opacity)?.into_iter().map(opacity_logit).collect();
        if opacity_logits.iter().any(|logit| logit.is_nan()) {
            let remedy = "write opacities, not their logits, as the extension says";
            let problem = format!("{EXTENSION}:OPACITY has values outside of 0 to 1");
            return Err(Error::input(path, problem, remedy));
        }
        let coefficients = self.sh.len();
        let mut sh = vec![[0.0; 3]; rows.len() * coefficients];
        for (k, accessor) in self.sh.iter().enumerate() {
            let of_k = triples(&values(accessor)?);
            sh[k..].iter_mut().step_by(coefficients).zip(of_k).for_each(|(to, from)| *to = from);
        }
        Ok(Gaussians { sh_degree: self.sh_degree(), means, quats, log_scales, opacity_logits, sh })
    }
}

/// Logit of an opacity; NaN outside of 0 to 1.
pub(super) fn opacity_logit(opacity: f32) -> f32 {
    if !(-OPACITY_SLACK..=1.0 + OPACITY_SLACK).contains(&opacity) {
        return f32::NAN;
    }
    let opacity = f64::from(opacity).clamp(OPACITY_MARGIN, 1.0 - OPACITY_MARGIN);
    (opacity / (1.0 - opacity)).ln() as f32
}

fn triples(values: &[f32]) -> Vec<[f32; 3]> {
    values.as_chunks::<3>().0.to_vec()
}

/// Largest relative deviation of a node's axes from orthogonal and equal length.
const SHAPE_TOLERANCE: f64 = 1e-4;
const GLB_JSON: u32 = 0x4e4f_534a;
const GLB_BINARY: u32 = 0x004e_4942;

#[derive(Deserialize)]
#[serde(rename_all = "camelCase", default)]
#[derive(Default)]
struct Document {
    extensions_required: Vec<String>,
    buffers: Vec<BufferJson>,
    buffer_views: Vec<BufferView>,
    accessors: Vec<AccessorJson>,
    meshes: Vec<Mesh>,
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
struct BufferView {
    buffer: usize,
    #[serde(default)]
    byte_offset: u64,
    byte_length: u64,
    byte_stride: Option<u64>,
    #[serde(default)]
    extensions: BTreeMap<String, IgnoredAny>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct AccessorJson {
    buffer_view: Option<usize>,
    #[serde(default)]
    byte_offset: u64,
    component_type: u32,
    #[serde(default)]
    normalized: bool,
    count: u64,
    #[serde(rename = "type")]
    kind: String,
    sparse: Option<IgnoredAny>,
}

#[derive(Deserialize)]
struct Mesh {
    primitives: Vec<Primitive>,
}

#[derive(Deserialize)]
struct Primitive {
    attributes: BTreeMap<String, usize>,
    #[serde(default)]
    extensions: PrimitiveExtensions,
}

#[derive(Deserialize, Default)]
struct PrimitiveExtensions {
    #[serde(rename = "KHR_gaussian_splatting")]
    splats: Option<Box<SplatsExtension>>,
}

#[derive(Deserialize, Default)]
#[serde(rename_all = "camelCase", default)]
struct SplatsExtension {
    kernel: Option<String>,
    color_space: Option<String>,
    extras: SplatsExtras,
    extensions: BTreeMap<String, Compression>,
}

#[derive(Deserialize, Default)]
#[serde(default)]
struct SplatsExtras {
    antialiased: bool,
    distance_order: bool,
    kernel_size: Option<f64>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Compression {
    buffer_view: Option<usize>,
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
    fn open(path: &Path, format: Format, limit: Option<u64>) -> Result<(Self, Buffers)> {
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
    fn unread_extensions(&self) -> impl Iterator<Item = &String> {
        let is_read = |name: &&String| {
            [EXTENSION, PACKED_EXTENSION].contains(&name.as_str())
                || ["KHR_materials_", "KHR_texture_"].iter().any(|start| name.starts_with(start))
        };
        self.extensions_required.iter().filter(move |name| !is_read(name))
    }

    /// The meshes of the scene, each with its placement in the world.
    fn placed_meshes(&self, path: &Path) -> Result<Vec<(usize, Similarity)>> {
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

pub(super) fn similarity(matrix: DMat4) -> Option<Similarity> {
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

const MAX_STRIDE: u64 = 252;

struct Buffers(pub(super) Vec<Buffer>);

impl Buffers {
    /// Total bytes of the buffers; a file that several buffers name counts once.
    fn bytes(&self) -> u64 {
        let mut files = BTreeSet::new();
        let counts = |buffer: &&Buffer| match buffer {
            Buffer::File { path, .. } => files.insert(path.clone()),
            Buffer::Memory(_) => true,
        };
        self.0.iter().filter(counts).map(Buffer::bytes).sum()
    }
}

enum Buffer {
    File { path: PathBuf, file: File, offset: u64, bytes: u64 },
    Memory(Vec<u8>),
}

impl Buffer {
    fn bytes(&self) -> u64 {
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
struct Accessor {
    buffer: usize,
    offset: u64,
    stride: u64,
    count: usize,
    components: usize,
    component: Scalar,
    normalized: bool,
}

impl Accessor {
    /// The accessor with this index. The error text says what is wrong with it.
    fn new(document: &Document, buffers: &Buffers, index: usize, components: usize) -> Result<Self, String> {
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

    fn bytes(&self) -> u64 {
        self.count as u64 * (self.components * self.component.bytes()) as u64
    }

    fn read(&self, buffers: &mut Buffers, rows: Range<usize>) -> Result<Vec<f32>> {
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
