//! PlayCanvas' compressed PLY: 16 bytes for each Gaussian, relative to the box of its chunk of 256, and a byte for
//! each higher SH value.
//!
//! Format: PlayCanvas, "Compressed PLY" (developer.playcanvas.com), and the behaviour of splat-transform.

use std::path::Path;

use super::header::Element;
use super::read::restore_frame;
use super::rows::PlyFile;
use crate::host_memory;
use crate::splats::{BLOCK, Format, Header, Sink, Source};
use ashsplat::scene::Gaussians;
use ashsplat::scene::gaussians::{MAX_SH_DEGREE, sh_coefficients};
use ashsplat::scene::sh::C0;
use ashsplat::{Error, Result};
use glam::DVec3;

/// Gaussians that share one box.
pub(super) const CHUNK: usize = 256;

/// The boxes' properties, in the order in which this crate uses and writes them.
pub(super) const CHUNK_PROPERTIES: [&str; 18] = [
    "min_x",
    "min_y",
    "min_z",
    "max_x",
    "max_y",
    "max_z",
    "min_scale_x",
    "min_scale_y",
    "min_scale_z",
    "max_scale_x",
    "max_scale_y",
    "max_scale_z",
    "min_r",
    "min_g",
    "min_b",
    "max_r",
    "max_g",
    "max_b",
];

/// Number of properties in older files, whose colours are 0 to 1.
const CHUNK_PROPERTIES_WITHOUT_COLOR: usize = 12;

pub(super) const VERTEX_PROPERTIES: [&str; 4] =
    ["packed_position", "packed_rotation", "packed_scale", "packed_color"];

/// Range of the higher SH values: -4 to 4.
pub(super) const SH_RANGE: f32 = 8.0;

type Chunk = [f32; CHUNK_PROPERTIES.len()];

/// An open compressed PLY.
pub(crate) struct CompressedPly<'a> {
    file: PlyFile<'a>,
    vertex: Element,
    chunks: Vec<Chunk>,
    /// Rows of the higher SH, channel-major, one byte for each value.
    sh: Vec<u8>,
    header: Header,
}

impl<'a> CompressedPly<'a> {
    pub(crate) fn open(path: &'a Path) -> Result<Self> {
        let mut file = PlyFile::open(path)?;
        let chunk = file.seek_element("chunk")?;
        let chunks = read_chunks(&mut file, &chunk)?;
        let vertex = file.seek_element("vertex")?;
        for name in VERTEX_PROPERTIES {
            if !vertex.has(name) {
                let problem = format!("property {name} of element vertex is missing");
                return Err(Error::input(path, problem, "write the file again"));
            }
        }
        if vertex.count.div_ceil(CHUNK as u64) != chunk.count {
            let (chunks, count) = (chunk.count, vertex.count);
            let needed = count.div_ceil(CHUNK as u64);
            let problem = format!("has {chunks} chunks, its {count} vertices need {needed}");
            return Err(file.error(problem));
        }
        let (sh_degree, sh) = read_sh(path, vertex.count)?;
        let corners = |chunk: &Chunk| DVec3::new(chunk[0].into(), chunk[1].into(), chunk[2].into());
        let restored = restore_frame(path, &mut file.header, || Ok(chunks.iter().map(corners).collect()))?;
        let mut warnings: Vec<String> = file.header.marks.warning().into_iter().collect();
        warnings.extend(restored);
        let infinite = chunks.iter().filter(|chunk| chunk[6..12].iter().any(|v| v.is_infinite())).count();
        if infinite > 0 {
            warnings.push(format!(
                "sizes are lost in {infinite} of {} chunks: their range is infinite",
                chunks.len()
            ));
        }
        let padding = file.header.padding.iter().map(|&(_, count)| count).fold(0, u64::saturating_add);
        let header = Header {
            antialiased: file.header.marks.antialiased(),
            kernel_size: file.header.marks.kernel_size,
            is_2dgs: file.header.marks.is_2dgs(),
            origin: file.header.origin,
            unit: file.header.unit,
            warnings,
            ..Header::new(Format::CompressedPly, vertex.count.saturating_sub(padding), sh_degree)
        };
        Ok(Self { file, vertex, chunks, sh, header })
    }
}

fn read_chunks(file: &mut PlyFile<'_>, element: &Element) -> Result<Vec<Chunk>> {
    let colored = element.has(CHUNK_PROPERTIES[CHUNK_PROPERTIES_WITHOUT_COLOR]);
    let used = if colored { CHUNK_PROPERTIES.len() } else { CHUNK_PROPERTIES_WITHOUT_COLOR };
    let names: Vec<String> = CHUNK_PROPERTIES[..used].iter().map(|name| name.to_string()).collect();
    let mut chunks = Vec::with_capacity(usize::try_from(element.count).unwrap_or(0));
    file.for_each_row(element, &names, |_, row| {
        let mut chunk = [0.0; CHUNK_PROPERTIES.len()];
        chunk[15..].fill(1.0);
        for (value, &read) in chunk.iter_mut().zip(row) {
            *value = read as f32;
        }
        chunks.push(chunk);
        Ok(())
    })?;
    Ok(chunks)
}

/// Reads the degree and the bytes of the optional element `sh`, which follows the vertices.
fn read_sh(path: &Path, count: u64) -> Result<(u32, Vec<u8>)> {
    let mut file = PlyFile::open(path)?;
    if !file.header.elements.iter().any(|e| e.name == "sh") {
        return Ok((0, Vec::new()));
    }
    let element = file.seek_element("sh")?;
    let values = element.properties.len();
    let degree = (1..=MAX_SH_DEGREE).find(|&d| values == 3 * (sh_coefficients(d) - 1));
    let Some(degree) = degree else {
        return Err(file.error(format!("{values} properties of element sh fit no SH degree")));
    };
    if element.count != count {
        return Err(file.error(format!("has {count} vertices, but {} rows of sh", element.count)));
    }
    let names: Vec<String> = (0..values).map(|i| format!("f_rest_{i}")).collect();
    let mut bytes = host_memory::reserved(path, count.saturating_mul(values as u64))?;
    file.for_each_row(&element, &names, |_, row| {
        bytes.extend(row.iter().map(|&value| value as u8));
        Ok(())
    })?;
    Ok((degree, bytes))
}

impl Source for CompressedPly<'_> {
    fn header(&self) -> &Header {
        &self.header
    }

    fn row_name(&self) -> &'static str {
        "vertex"
    }

    fn blocks(&mut self, sink: &mut Sink<'_>) -> Result<()> {
        let names = VERTEX_PROPERTIES.map(str::to_owned);
        let (chunks, sh) = (&self.chunks, &self.sh);
        let degree = self.header.sh_degree;
        let higher = sh_coefficients(degree) - 1;
        let mut block = Gaussians { sh_degree: degree, ..Default::default() };
        let padding = self.file.header.padding.clone();
        let is_padding = |row: u64| padding.iter().any(|&(first, count)| row >= first && row - first < count);
        self.file.for_each_row(&self.vertex, &names, |index, row| {
            if is_padding(index) {
                return Ok(());
            }
            let index = index as usize;
            let packed = [row[0], row[1], row[2], row[3]].map(|value| value as u32);
            push(&chunks[index / CHUNK], packed, &mut block);
            let rest = &sh[index * 3 * higher..(index + 1) * 3 * higher];
            block.sh.extend(
                (0..higher).map(|k| std::array::from_fn(|channel| unpack_sh(rest[channel * higher + k]))),
            );
            if block.len() < BLOCK {
                return Ok(());
            }
            sink(std::mem::replace(&mut block, Gaussians { sh_degree: degree, ..Default::default() }))
        })?;
        sink(block)
    }
}

/// Appends a Gaussian without its higher SH.
fn push(chunk: &Chunk, [position, rotation, scale, color]: [u32; 4], block: &mut Gaussians) {
    let [x, y, z] = unpack_11_10_11(position);
    block.means.push([(x, 0), (y, 1), (z, 2)].map(|(t, axis)| lerp(chunk[axis], chunk[axis + 3], t)));
    block.quats.push(unpack_rotation(rotation));
    let [x, y, z] = unpack_11_10_11(scale);
    block.log_scales.push([(x, 6), (y, 7), (z, 8)].map(|(t, axis)| lerp(chunk[axis], chunk[axis + 3], t)));
    let [r, g, b, opacity] = [24, 16, 8, 0].map(|shift| unorm(color >> shift, 8));
    let dc = |t: f64, at: usize| ((f64::from(lerp(chunk[at], chunk[at + 3], t)) - 0.5) / C0) as f32;
    block.sh.push([dc(r, 12), dc(g, 13), dc(b, 14)]);
    block.opacity_logits.push(-((1.0 / opacity - 1.0).ln()) as f32);
}

fn lerp(min: f32, max: f32, t: f64) -> f32 {
    // An end of the range may be infinite.
    if t == 0.0 || t == 1.0 {
        return if t == 0.0 { min } else { max };
    }
    (f64::from(min) * (1.0 - t) + f64::from(max) * t) as f32
}

fn unorm(value: u32, bits: u32) -> f64 {
    let largest = (1 << bits) - 1;
    f64::from(value & largest) / f64::from(largest)
}

fn unpack_11_10_11(value: u32) -> [f64; 3] {
    [unorm(value >> 21, 11), unorm(value >> 11, 10), unorm(value, 11)]
}

/// The three smaller components in 10 bits each, and the index of the omitted one, in the order w, x, y, z.
fn unpack_rotation(value: u32) -> [f32; 4] {
    let small = [20, 10, 0].map(|shift| (unorm(value >> shift, 10) - 0.5) * std::f64::consts::SQRT_2);
    let largest = (1.0 - small.iter().map(|v| v * v).sum::<f64>()).max(0.0).sqrt();
    let mut small = small.into_iter();
    std::array::from_fn(|i| {
        let component = if i as u32 == value >> 30 { Some(largest) } else { small.next() };
        component.unwrap_or(0.0) as f32
    })
}

fn unpack_sh(byte: u8) -> f32 {
    let share = match byte {
        0 => 0.0,
        255 => 1.0,
        _ => (f32::from(byte) + 0.5) / 256.0,
    };
    (share - 0.5) * SH_RANGE
}
