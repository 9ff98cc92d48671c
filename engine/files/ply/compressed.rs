//! PlayCanvas' compressed PLY: 16 bytes for each Gaussian, relative to the box of its chunk of 256, and a byte for
//! each higher SH value.
//!
//! Format: PlayCanvas, "Compressed PLY" (developer.playcanvas.com), and the behaviour of splat-transform.

use std::io::{self, Write};
use std::ops::Range;
use std::path::Path;

use glam::{DVec3, Vec3};

use super::file::{Element, Marks, PADDING, PlyFile};
use super::{restore_frame, write_frame};
use crate::regular_file::OnFile;
use crate::splats::{Blocks, Format, Header, MAX_COMPRESSED_LOG_SCALE, Opened, Outline, Produce, Sink};
use crate::{atomic, host_memory};
use ashsplat::scene::gaussians::{MAX_SH_DEGREE, sh_coefficients};
use ashsplat::scene::sh::C0;
use ashsplat::scene::{Gaussians, median_ball};
use ashsplat::{Error, Result};

/// Gaussians that share one box.
const CHUNK: usize = 256;

/// The boxes' properties, in the order in which this crate uses and writes them.
const CHUNK_PROPERTIES: [[&str; 3]; 6] = [
    ["min_x", "min_y", "min_z"],
    ["max_x", "max_y", "max_z"],
    ["min_scale_x", "min_scale_y", "min_scale_z"],
    ["max_scale_x", "max_scale_y", "max_scale_z"],
    ["min_r", "min_g", "min_b"],
    ["max_r", "max_g", "max_b"],
];

const VERTEX_PROPERTIES: [&str; 4] = ["packed_position", "packed_rotation", "packed_scale", "packed_color"];
/// Range of the higher SH values: -4 to 4.
const SH_RANGE: f32 = 8.0;

type Chunk = [f32; 18];

pub(crate) fn open(path: &Path) -> Result<Opened<'_>> {
    let mut file = PlyFile::open(path)?;
    let chunk = file.seek_element("chunk")?;
    let chunks = read_chunks(&mut file, &chunk)?;
    let vertex = file.seek_element("vertex")?;
    if let Some(name) = VERTEX_PROPERTIES.iter().find(|name| !vertex.has(name)) {
        let problem = format!("property {name} of element vertex is missing");
        return Err(Error::input(path, problem, "write the file again"));
    }
    let (count, found, needed) = (vertex.count, chunk.count, vertex.count.div_ceil(CHUNK as u64));
    if found != needed {
        return Err(file.error(format!("has {found} chunks, its {count} vertices need {needed}")));
    }
    let (sh_degree, sh) = read_sh(path, vertex.count)?;
    let corners = |chunk: &Chunk| DVec3::new(chunk[0].into(), chunk[1].into(), chunk[2].into());
    let restored = restore_frame(path, &mut file.header, || chunks.iter().map(corners).collect());
    let mut warnings: Vec<String> = file.header.marks.warning().into_iter().collect();
    warnings.extend(restored);
    let infinite = chunks.iter().filter(|chunk| chunk[6..12].iter().any(|v| v.is_infinite())).count();
    if infinite > 0 {
        let all = chunks.len();
        warnings.push(format!("sizes are lost in {infinite} of {all} chunks: their range is infinite"));
    }
    let padding = file.header.padding.iter().map(|&(_, count)| count).fold(0, u64::saturating_add);
    let count = vertex.count.saturating_sub(padding);
    let header = Header { warnings, ..file.header.of_gaussians(Format::CompressedPly, count, sh_degree) };
    let padding = std::mem::take(&mut file.header.padding);
    let is_padding =
        move |row: u64| padding.iter().any(|&(first, count)| row >= first && row - first < count);
    let higher = sh_coefficients(sh_degree) - 1;
    let produce = move |sink: &mut Sink<'_>| {
        let mut blocks = Blocks::new(sh_degree, count, sink);
        file.for_each_row(&vertex, &VERTEX_PROPERTIES, |index, row| {
            if is_padding(index) {
                return Ok(());
            }
            let index = index as usize;
            let packed = [row[0], row[1], row[2], row[3]].map(|value| value as u32);
            let block = blocks.next()?;
            push(&chunks[index / CHUNK], packed, block);
            let rest = &sh[index * 3 * higher..(index + 1) * 3 * higher];
            block.sh.extend(
                (0..higher).map(|k| std::array::from_fn(|channel| unpack_sh(rest[channel * higher + k]))),
            );
            Ok(())
        })?;
        blocks.finish()
    };
    Ok((header, Box::new(produce)))
}

fn read_chunks(file: &mut PlyFile<'_>, element: &Element) -> Result<Vec<Chunk>> {
    // In older files, all colours are 0 to 1.
    let used = if element.has(CHUNK_PROPERTIES[4][0]) { 6 } else { 4 };
    let mut chunks = Vec::with_capacity(usize::try_from(element.count).unwrap_or(0));
    file.for_each_row(element, CHUNK_PROPERTIES[..used].as_flattened(), |_, row| {
        let mut chunk: Chunk = [0.0; 18];
        chunk[15..].fill(1.0);
        for (value, &read) in chunk.iter_mut().zip(row) {
            *value = read as f32;
        }
        chunks.push(chunk);
        Ok(())
    })?;
    Ok(chunks)
}

/// Reads the optional element `sh`, which follows the vertices: its degree, and its rows, channel-major, one byte for
/// each value.
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

/// The three smaller components in 10 bits each, and the index of the omitted one.
fn unpack_rotation(value: u32) -> [f32; 4] {
    rotation_of_shares((value >> 30) as usize, [20, 10, 0].map(|shift| unorm(value >> shift, 10)))
}

/// Quaternion (w, x, y, z) whose component `omitted` is positive and the largest. The others are shares of the range from
/// -√½ to √½.
pub(crate) fn rotation_of_shares(omitted: usize, shares: [f64; 3]) -> [f32; 4] {
    let small = shares.map(|share| (share - 0.5) * std::f64::consts::SQRT_2);
    let largest = (1.0 - small.iter().map(|v| v * v).sum::<f64>()).max(0.0).sqrt();
    let mut small = small.into_iter();
    std::array::from_fn(|i| {
        let component = if i == omitted { Some(largest) } else { small.next() };
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

/// Distance of an outlier from the median, in median distances. It would share a chunk with 255 positions, whose steps
/// would grow to this much of the scene's radius, divided by 1023.
const OUTLIER: f64 = 8.0;
/// Same as [`OUTLIER`] for colours, which have 8 bits: 255 steps.
const COLOR_OUTLIER: f64 = 32.0;
/// Largest number of groups with chunks of their own; outliers may have outliers themselves.
const MAX_GROUPS: usize = 8;
/// Bits of the opacity in a packed colour.
const OPACITY: u32 = 0xff;

/// Writes Gaussians along a space-filling curve, so that the 256 Gaussians of a chunk lie close together.
pub(crate) fn write_blocks(path: &Path, outline: &Outline, produce: &mut Produce<'_>) -> Result<()> {
    // Beside the Gaussians, their order and their packed form.
    let all = outline.in_memory(path, 132, produce)?;
    let rows = Rows::of(&all);
    atomic::write_seekable(path, |mut writer| write_sorted(&mut writer, &all, &rows, outline).writing(path))
}

fn write_sorted(writer: &mut impl Write, all: &Gaussians, rows: &Rows, outline: &Outline) -> io::Result<()> {
    let higher = 3 * (sh_coefficients(all.sh_degree) - 1);
    write_header(writer, rows, higher, outline)?;
    let mut packed = Vec::with_capacity(rows.order.len());
    for indices in rows.order.chunks(CHUNK) {
        let boxes = boxes_around(all, indices);
        for value in boxes.as_flattened().as_flattened() {
            writer.write_all(&value.to_le_bytes())?;
        }
        packed.extend(indices.iter().map(|&index| pack(all, index, &boxes)));
    }
    for row in rows.padding.iter().cloned().flatten() {
        let [.., color] = &mut packed[row];
        *color &= !OPACITY;
    }
    for value in packed.as_flattened() {
        writer.write_all(&value.to_le_bytes())?;
    }
    let mut row = Vec::with_capacity(higher);
    for &index in &rows.order {
        row.clear();
        let sh = &all.sh_of(index)[1..];
        (0..3).for_each(|channel| row.extend(sh.iter().map(|coefficient| pack_sh(coefficient[channel]))));
        writer.write_all(&row)?;
    }
    Ok(())
}

/// Index of the Gaussian in each row.
struct Rows {
    order: Vec<usize>,
    /// Rows that only fill chunks: transparent copies of the previous row.
    padding: Vec<Range<usize>>,
}

impl Rows {
    /// Orders each group along a space-filling curve, beginning at the first row of a chunk.
    fn of(all: &Gaussians) -> Self {
        let (mut order, mut padding) = (Vec::with_capacity(all.len()), Vec::new());
        for group in groups(all) {
            let filled = order.len();
            if let Some(&last) = order.last().filter(|_| !filled.is_multiple_of(CHUNK)) {
                order.resize(filled.next_multiple_of(CHUNK), last);
                padding.push(filled..order.len());
            }
            let means: Vec<[f32; 3]> = group.iter().map(|&index| all.means[index]).collect();
            order.extend(morton_order(&means).into_iter().map(|place| group[place]));
        }
        Self { order, padding }
    }
}

/// Steps of the positions in the median of the chunks that these Gaussians come into. Only means and base colours are read.
pub(crate) fn typical_step(all: &Gaussians) -> f64 {
    const LEVELS: [f64; 3] = [2047.0, 1023.0, 2047.0];
    let step = |indices: &[usize]| {
        let [min, max] = extremes(indices.iter().map(|&i| all.means[i]));
        (0..3).map(|axis| f64::from(max[axis] - min[axis]) / LEVELS[axis]).fold(0.0, f64::max)
    };
    let mut steps: Vec<f64> = Rows::of(all).order.chunks(CHUNK).map(step).collect();
    steps.sort_unstable_by(f64::total_cmp);
    steps.get(steps.len() / 2).copied().unwrap_or(0.0)
}

/// Splits Gaussians by the magnitude of positions and colours: first those near the median, then the outliers.
fn groups(all: &Gaussians) -> Vec<Vec<usize>> {
    let mean = |&index: &usize| Vec3::from_array(all.means[index]).as_dvec3();
    let color = |&index: &usize| Vec3::from_array(color(all, index)).as_dvec3();
    let mut groups = Vec::new();
    let mut rest: Vec<usize> = (0..all.len()).collect();
    while groups.len() + 1 < MAX_GROUPS {
        let balls = [
            (median_ball(&rest.iter().map(mean).collect::<Vec<_>>()), OUTLIER),
            (median_ball(&rest.iter().map(color).collect::<Vec<_>>()), COLOR_OUTLIER),
        ];
        let is_beyond = |(ball, factor): (Option<(DVec3, f64)>, f64), value: DVec3| {
            ball.is_some_and(|(center, radius)| value.distance(center) > factor * radius)
        };
        let is_near = |index: &usize| !is_beyond(balls[0], mean(index)) && !is_beyond(balls[1], color(index));
        let (near, outliers): (Vec<usize>, Vec<usize>) = rest.into_iter().partition(is_near);
        groups.push(near);
        if outliers.is_empty() {
            return groups;
        }
        rest = outliers;
    }
    groups.push(rest);
    groups
}

fn write_header(writer: &mut impl Write, rows: &Rows, higher: usize, outline: &Outline) -> io::Result<()> {
    let count = rows.order.len();
    writeln!(writer, "ply\nformat binary_little_endian 1.0")?;
    Marks::write(writer, outline)?;
    write_frame(writer, &outline.options.frame)?;
    for rows in &rows.padding {
        writeln!(writer, "comment {PADDING} {} {}", rows.start, rows.len())?;
    }
    writeln!(writer, "element chunk {}", count.div_ceil(CHUNK))?;
    CHUNK_PROPERTIES.iter().flatten().try_for_each(|name| writeln!(writer, "property float {name}"))?;
    writeln!(writer, "element vertex {count}")?;
    VERTEX_PROPERTIES.iter().try_for_each(|name| writeln!(writer, "property uint {name}"))?;
    if higher > 0 {
        writeln!(writer, "element sh {count}")?;
        (0..higher).try_for_each(|i| writeln!(writer, "property uchar f_rest_{i}"))?;
    }
    writeln!(writer, "end_header")
}

/// The boxes around a chunk's means, log-scales and colours, in the order of [`CHUNK_PROPERTIES`].
type Boxes = [[[f32; 3]; 2]; 3];

fn boxes_around(all: &Gaussians, indices: &[usize]) -> Boxes {
    let log_scales = extremes(indices.iter().map(|&i| all.log_scales[i]));
    [
        extremes(indices.iter().map(|&i| all.means[i])),
        log_scales.map(|corner| corner.map(|v| v.clamp(-MAX_COMPRESSED_LOG_SCALE, MAX_COMPRESSED_LOG_SCALE))),
        extremes(indices.iter().map(|&i| color(all, i))),
    ]
}

/// Packs a Gaussian in the order of [`VERTEX_PROPERTIES`].
fn pack(all: &Gaussians, index: usize, [means, log_scales, colors]: &Boxes) -> [u32; 4] {
    let [r, g, b] = within(color(all, index), colors).map(|t| pack_unorm(t, 8));
    let opacity = pack_unorm(f64::from(all.opacity(index)), 8);
    [
        pack_11_10_11(within(all.means[index], means)),
        pack_rotation(all.quats[index]),
        pack_11_10_11(within(all.log_scales[index], log_scales)),
        r << 24 | g << 16 | b << 8 | opacity,
    ]
}

fn color(all: &Gaussians, index: usize) -> [f32; 3] {
    all.sh_of(index)[0].map(|dc| (f64::from(dc) * C0 + 0.5) as f32)
}

fn extremes(values: impl Iterator<Item = [f32; 3]>) -> [[f32; 3]; 2] {
    values.fold([[f32::INFINITY; 3], [f32::NEG_INFINITY; 3]], |[min, max], value| {
        [std::array::from_fn(|i| min[i].min(value[i])), std::array::from_fn(|i| max[i].max(value[i]))]
    })
}

/// Position of a value between two corners, 0 to 1 on each axis.
fn within(value: [f32; 3], [min, max]: &[[f32; 3]; 2]) -> [f64; 3] {
    std::array::from_fn(|i| {
        let (value, min, max) = (f64::from(value[i]), f64::from(min[i]), f64::from(max[i]));
        if max > min { ((value - min) / (max - min)).clamp(0.0, 1.0) } else { 0.0 }
    })
}

pub(crate) fn pack_unorm(value: f64, bits: u32) -> u32 {
    let largest = (1 << bits) - 1;
    ((value * f64::from(largest) + 0.5).floor().max(0.0) as u32).min(largest)
}

fn pack_11_10_11([x, y, z]: [f64; 3]) -> u32 {
    pack_unorm(x, 11) << 21 | pack_unorm(y, 10) << 11 | pack_unorm(z, 11)
}

fn pack_rotation(quat: [f32; 4]) -> u32 {
    let (omitted, shares) = shares_of_rotation(quat);
    shares.into_iter().fold(omitted as u32, |packed, share| packed << 10 | pack_unorm(share, 10))
}

/// Index of the largest component of a quaternion, and the others as [`rotation_of_shares`] takes them.
pub(crate) fn shares_of_rotation(quat: [f32; 4]) -> (usize, [f64; 3]) {
    let quat = quat.map(f64::from);
    let length = quat.iter().map(|q| q * q).sum::<f64>().sqrt();
    let quat = if length > 0.0 { quat.map(|q| q / length) } else { [1.0, 0.0, 0.0, 0.0] };
    let largest = (1..4).fold(0, |best, i| if quat[i].abs() > quat[best].abs() { i } else { best });
    // The omitted component must be positive.
    let sign = if quat[largest] < 0.0 { -1.0 } else { 1.0 };
    let other = |at: usize| quat[if at < largest { at } else { at + 1 }];
    (largest, [0, 1, 2].map(|at| sign * other(at) * std::f64::consts::FRAC_1_SQRT_2 + 0.5))
}

fn pack_sh(value: f32) -> u8 {
    ((value / SH_RANGE + 0.5) * 256.0).clamp(0.0, 255.0) as u8
}

const MORTON_BITS: u32 = 21;

/// Indices of points along the Z-order (Morton) curve through the cube around them; coincident points keep their order. Its cells
/// are cubes: those of a long, flat scene would otherwise be as long as the scene.
pub(crate) fn morton_order(points: &[[f32; 3]]) -> Vec<usize> {
    let [min, max] = extremes(points.iter().copied());
    let size = (0..3).map(|axis| f64::from(max[axis]) - f64::from(min[axis])).fold(0.0, f64::max);
    let code = |point: &[f32; 3]| {
        (0..3).fold(0, |code, axis| {
            let share = if size > 0.0 { (f64::from(point[axis]) - f64::from(min[axis])) / size } else { 0.0 };
            let cell = (share * f64::from((1u32 << MORTON_BITS) - 1)) as u64;
            code | spread(cell) << axis
        })
    };
    let codes: Vec<u64> = points.iter().map(code).collect();
    let mut order: Vec<usize> = (0..points.len()).collect();
    order.sort_by_key(|&index| codes[index]);
    order
}

/// Inserts two zero bits after each of the lower 21 bits.
fn spread(value: u64) -> u64 {
    let mut v = value & 0x1f_ffff;
    v = (v | v << 32) & 0x001f_0000_0000_ffff;
    v = (v | v << 16) & 0x001f_0000_ff00_00ff;
    v = (v | v << 8) & 0x100f_00f0_0f00_f00f;
    v = (v | v << 4) & 0x10c3_0c30_c30c_30c3;
    (v | v << 2) & 0x1249_2492_4924_9249
}
