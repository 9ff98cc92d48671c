//! Reads glTF and GLB with `KHR_gaussian_splatting` (ratified form: linear scales, quaternions x, y, z, w).
//!
//! glTF's y points up, and its z towards the viewer of a scene's front: x and y are opposite to those of this
//! crate's frame.

mod accessor;
mod document;
mod packed;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use accessor::{Accessor, Buffers};
use document::Document;
use packed::PackedRows;

use super::{BLOCK, Format, Header, ReadOptions, Sink, Source, is_kernel_size};
use crate::cost;
use ashsplat::scene::gaussians::{MAX_SH_DEGREE, sh_coefficients};
use ashsplat::scene::{Gaussians, Similarity, WorldFrame};
use ashsplat::{Error, Result};
use glam::DVec3;

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

/// An open glTF.
pub(super) struct Gltf {
    buffers: Buffers,
    parts: Vec<Part>,
    header: Header,
    path: PathBuf,
}

/// A primitive at a node.
struct Part {
    placement: Similarity,
    sh_degree: u32,
    rows: Rows,
}

/// Storage of a part's Gaussians.
enum Rows {
    Plain(PlainRows),
    Packed(PackedRows),
}

/// Gaussians in accessors.
struct PlainRows {
    count: usize,
    position: Accessor,
    rotation: Accessor,
    scale: Accessor,
    opacity: Accessor,
    sh: Vec<Accessor>,
}

impl Gltf {
    pub(super) fn open(path: &Path, format: Format, options: &ReadOptions) -> Result<Self> {
        let (document, buffers) = Document::open(path, format, options.max_host_memory)?;
        let mut header = Header::new(format, 0, 0);
        for name in document.unread_extensions() {
            header.warnings.push(format!("{}: requires {name}, which is not read", path.display()));
        }
        let mut parts = Vec::new();
        let (held, mut used) = (buffers.bytes(), 0_u64);
        let mut uses: BTreeMap<(usize, usize), u64> = BTreeMap::new();
        let splats: Vec<Vec<Splats<'_>>> = document.meshes.iter().map(Splats::of).collect();
        let mut others = 0;
        for (mesh_index, placement) in document.placed_meshes(path)? {
            let Some(mesh) = splats.get(mesh_index) else {
                let problem = format!("a node has mesh {mesh_index}, there are {}", document.meshes.len());
                return Err(damaged(path, problem));
            };
            others += document.meshes[mesh_index].primitives.len() - mesh.len();
            for &Splats { index, primitive, extension } in mesh {
                cost::step();
                let place = format!("mesh {mesh_index}, primitive {index}");
                let mut warn =
                    |what: String| header.warnings.push(format!("{}: {place}: {what}", path.display()));
                match extension.color_space.as_deref() {
                    None | Some("srgb_rec709_display") => {}
                    Some("lin_rec709_display") => {
                        warn("colours are linear; they are used as they are".into())
                    }
                    Some(other) => warn(format!("colours of the space {other:?} are used as sRGB")),
                }
                if let Some(kernel) = extension.kernel.as_deref().filter(|&kernel| kernel != "ellipse") {
                    warn(format!("the kernel {kernel:?} is drawn as an ellipse"));
                }
                header.antialiased |= extension.extras.antialiased;
                let kernel_size = extension.extras.kernel_size.map(|size| size as f32);
                header.kernel_size = kernel_size.filter(is_kernel_size).or(header.kernel_size);
                let packed = PackedRows::of(path, &place, (&document, &buffers), (primitive, extension))?;
                let rows = if let Some(packed) = packed {
                    *uses.entry((mesh_index, index)).or_insert(0) += 1;
                    header.warnings.extend(packed.spz.header().warnings.iter().cloned());
                    header.antialiased |= packed.spz.header().antialiased;
                    Rows::Packed(packed)
                } else {
                    Rows::Plain(
                        Attributes {
                            path,
                            place: &place,
                            document: &document,
                            buffers: &buffers,
                            primitive,
                            extension,
                        }
                        .rows()?,
                    )
                };
                used = used.saturating_add(rows.bytes());
                header.count = header.count.saturating_add(rows.count());
                parts.push(Part { placement, sh_degree: rows.sh_degree(), rows });
                // A few bytes could claim any number of Gaussians, placed at many nodes. Packed ones are unpacked for
                // each node.
                let copies = header.count > FREE_GAUSSIANS && used / MOST_USES > held
                    || uses.get(&(mesh_index, index)).is_some_and(|&uses| uses > MOST_USES);
                if copies || parts.len() > MOST_PARTS {
                    let problem = format!(
                        "places the same Gaussians again and again: {} or more at {} places from {held} bytes",
                        header.count,
                        parts.len()
                    );
                    let remedy =
                        format!("place each at most {MOST_USES} times, at {MOST_PARTS} places in all");
                    return Err(Error::input(path, problem, remedy));
                }
            }
        }
        if parts.is_empty() {
            let problem = format!("has no Gaussians (no placed primitive with {EXTENSION})");
            return Err(Error::input(path, problem, "is it a mesh?"));
        }
        if others > 0 {
            let path = path.display();
            header.warnings.push(format!("{path}: {others} primitives that are no Gaussians are not used"));
        }
        header.sh_degree = parts.iter().map(|part| part.sh_degree).max().unwrap_or(0);
        let mut gltf = Self { buffers, parts, header, path: path.to_owned() };
        gltf.header.origin = gltf.origin_of_nodes();
        Ok(gltf)
    }

    /// An origin for positions that nodes place far away, from the first Gaussians.
    fn origin_of_nodes(&mut self) -> DVec3 {
        let Some(placed) = self.parts.iter().find(|part| part.placement.translation != DVec3::ZERO) else {
            return DVec3::ZERO;
        };
        let near = mirrored(placed.placement.translation);
        self.header.origin = near;
        let mut points = Vec::new();
        // The error stops the reading after the first block. The main reader reports any other error again.
        drop(self.blocks(&mut |block| {
            points = block.means.iter().map(|mean| near + DVec3::from_array(mean.map(f64::from))).collect();
            Err(Error::Interrupted)
        }));
        WorldFrame::around(&points).origin
    }
}

/// Converts a point from glTF's axes to this crate's, and back.
pub(super) fn mirrored(point: DVec3) -> DVec3 {
    DVec3::from_array(std::array::from_fn(|axis| if MIRRORED[axis] { -point[axis] } else { point[axis] }))
}

fn damaged(path: &Path, problem: impl Into<String>) -> Error {
    Error::input(path, problem, "the file is damaged or cut short: write or download it again")
}

/// A primitive of Gaussians and its index in its mesh. Many nodes may share a mesh, which may have many other
/// primitives.
struct Splats<'a> {
    index: usize,
    primitive: &'a document::Primitive,
    extension: &'a document::SplatsExtension,
}

impl<'a> Splats<'a> {
    fn of(mesh: &'a document::Mesh) -> Vec<Self> {
        let own = |(index, primitive): (usize, &'a document::Primitive)| {
            cost::step();
            Some(Self { index, primitive, extension: primitive.extensions.splats.as_deref()? })
        };
        mesh.primitives.iter().enumerate().filter_map(own).collect()
    }
}

/// The attributes of one primitive.
struct Attributes<'a> {
    path: &'a Path,
    place: &'a str,
    document: &'a Document,
    buffers: &'a Buffers,
    primitive: &'a document::Primitive,
    extension: &'a document::SplatsExtension,
}

impl Attributes<'_> {
    fn rows(&self) -> Result<PlainRows> {
        let position = self.required("POSITION", 3)?;
        let own = |name: &str| format!("{EXTENSION}:{name}");
        let rows = PlainRows {
            count: position.count(),
            rotation: self.required(&own("ROTATION"), 4)?,
            scale: self.required(&own("SCALE"), 3)?,
            opacity: self.required(&own("OPACITY"), 1)?,
            sh: self.sh(&own)?,
            position,
        };
        let others = [&rows.rotation, &rows.scale, &rows.opacity].into_iter().chain(&rows.sh);
        if let Some(odd) = others.map(Accessor::count).find(|&count| count != rows.count) {
            let problem = format!("{}: {} positions, but {odd} of another attribute", self.place, rows.count);
            return Err(damaged(self.path, problem));
        }
        Ok(rows)
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

impl Source for Gltf {
    fn header(&self) -> &Header {
        &self.header
    }

    fn blocks(&mut self, sink: &mut Sink<'_>) -> Result<()> {
        let (buffers, sh_degree, origin) = (&mut self.buffers, self.header.sh_degree, self.header.origin);
        for part in &mut self.parts {
            let mut placement = part.placement;
            placement.translation -= mirrored(origin);
            let mut placed = |mut block: Gaussians| {
                block.transform(&placement);
                block.mirror(MIRRORED);
                if block.sh_degree < sh_degree {
                    block = block.with_sh_degree(sh_degree);
                }
                sink(block)
            };
            match &mut part.rows {
                Rows::Plain(rows) => {
                    for start in (0..rows.count).step_by(BLOCK) {
                        let end = (start + BLOCK).min(rows.count);
                        placed(rows.read(&self.path, buffers, start..end)?)?;
                    }
                }
                Rows::Packed(rows) => {
                    let turned = rows.has_own_axes;
                    rows.spz.blocks(&mut |mut block| {
                        if turned {
                            block.mirror(MIRRORED);
                        }
                        placed(block)
                    })?;
                }
            }
        }
        Ok(())
    }
}

impl Rows {
    fn count(&self) -> u64 {
        match self {
            Self::Plain(rows) => rows.count as u64,
            Self::Packed(rows) => rows.spz.header().count,
        }
    }

    fn sh_degree(&self) -> u32 {
        match self {
            Self::Plain(rows) => rows.sh_degree(),
            Self::Packed(rows) => rows.spz.header().sh_degree,
        }
    }

    /// Number of bytes in the file.
    fn bytes(&self) -> u64 {
        match self {
            Self::Plain(rows) => rows.bytes(),
            Self::Packed(rows) => rows.bytes,
        }
    }
}

impl PlainRows {
    fn sh_degree(&self) -> u32 {
        (0..=MAX_SH_DEGREE).find(|&degree| sh_coefficients(degree) == self.sh.len()).unwrap_or(0)
    }

    /// Number of bytes of all accessors.
    fn bytes(&self) -> u64 {
        let all = [&self.position, &self.rotation, &self.scale, &self.opacity].into_iter().chain(&self.sh);
        all.map(Accessor::bytes).sum()
    }

    fn read(&self, path: &Path, buffers: &mut Buffers, rows: std::ops::Range<usize>) -> Result<Gaussians> {
        let coefficients = self.sh.len();
        let mut block = Gaussians::with_capacity(self.sh_degree(), rows.len());
        let [mean, rotation, scale, opacity] = [&self.position, &self.rotation, &self.scale, &self.opacity];
        block.means = triples(&mean.read(buffers, rows.clone())?);
        block.quats = rotation
            .read(buffers, rows.clone())?
            .as_chunks::<4>()
            .0
            .iter()
            .map(|&[x, y, z, w]| [w, x, y, z])
            .collect();
        let sizes = scale.read(buffers, rows.clone())?;
        if sizes.iter().any(|&size| size < 0.0) {
            let problem = format!("{EXTENSION}:SCALE has values below 0");
            return Err(Error::input(
                path,
                problem,
                "write sizes, not their logarithms, as the extension says",
            ));
        }
        block.log_scales = triples(&sizes).into_iter().map(|s| s.map(f32::ln)).collect();
        let logit = |opacity: f32| {
            if !(-OPACITY_SLACK..=1.0 + OPACITY_SLACK).contains(&opacity) {
                return f32::NAN;
            }
            let opacity = f64::from(opacity).clamp(OPACITY_MARGIN, 1.0 - OPACITY_MARGIN);
            (opacity / (1.0 - opacity)).ln() as f32
        };
        block.opacity_logits = opacity.read(buffers, rows.clone())?.into_iter().map(logit).collect();
        if block.opacity_logits.iter().any(|logit| logit.is_nan()) {
            let problem = format!("{EXTENSION}:OPACITY has values outside of 0 to 1");
            let remedy = "write opacities, not their logits, as the extension says";
            return Err(Error::input(path, problem, remedy));
        }
        block.sh = vec![[0.0; 3]; rows.len() * coefficients];
        for (k, accessor) in self.sh.iter().enumerate() {
            let values = triples(&accessor.read(buffers, rows.clone())?);
            block.sh[k..].iter_mut().step_by(coefficients).zip(values).for_each(|(to, from)| *to = from);
        }
        Ok(block)
    }
}

fn triples(values: &[f32]) -> Vec<[f32; 3]> {
    values.as_chunks::<3>().0.to_vec()
}
