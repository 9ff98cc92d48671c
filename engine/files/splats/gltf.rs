//! Reads glTF and GLB with `KHR_gaussian_splatting` (ratified form: linear scales, quaternions x, y, z, w).
//!
//! glTF's y points up, and its z towards the viewer of a scene's front: x and y are opposite to this crate's.

mod document;

use std::collections::BTreeMap;
use std::ops::Range;
use std::path::Path;

use glam::DVec3;

use super::spz::Spz;
use super::{BLOCK, Format, Header, Opened, ReadOptions, Sink, is_kernel_size};
use crate::cost;
use crate::regular_file::damaged;
use ashsplat::scene::gaussians::{MAX_SH_DEGREE, sh_coefficients};
use ashsplat::scene::{Gaussians, Similarity, WorldFrame};
use ashsplat::{Error, Result};
pub(super) use document::similarity;
use document::{Accessor, Buffer, Buffers, Compression, Document, Mesh, Primitive, SplatsExtension};

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
const MOST_PARTS: usize = 1 << 16;
/// Number of Gaussians that may be placed any number of times, however few the file has.
const FREE_GAUSSIANS: u64 = 1 << 20;
/// Largest number of uses of each byte of the file, if there are more Gaussians than these.
const MOST_USES: u64 = 16;

/// A primitive of Gaussians at a node.
struct Part {
    placement: Similarity,
    header: Header,
    /// Number of bytes in the file.
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
            let copies = header.count > FREE_GAUSSIANS && used / MOST_USES > held
                || uses.get(&(mesh_index, index)).is_some_and(|&uses| uses > MOST_USES);
            if copies || parts.len() > MOST_PARTS {
                let (count, places) = (header.count, parts.len());
                let problem = format!(
                    "places the same Gaussians again and again: {count} or more at {places} places from {held} bytes"
                );
                let remedy = format!("place each at most {MOST_USES} times, at {MOST_PARTS} places in all");
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
