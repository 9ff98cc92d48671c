//! Writes compressed PLY.

use std::io::{self, Write};
use std::ops::Range;
use std::path::Path;

use super::compressed::{CHUNK, CHUNK_PROPERTIES, SH_RANGE, VERTEX_PROPERTIES};
use super::header::{Marks, PADDING};
use super::morton;
use super::write::write_frame;
use crate::splats::{MAX_COMPRESSED_LOG_SCALE, Outline, Produce, row_bytes};
use crate::{atomic, host_memory};
use ashsplat::scene::Gaussians;
use ashsplat::scene::gaussians::sh_coefficients;
use ashsplat::scene::median_ball;
use ashsplat::scene::sh::C0;
use ashsplat::{Error, Result};
use glam::{DVec3, Vec3};

/// Distance of an outlier from the median, in median distances. It would share a chunk with 255 positions, whose steps
/// would grow to this much of the scene's radius, divided by 1023.
const OUTLIER: f64 = 8.0;

/// [`OUTLIER`] for colours, whose steps are a 255th.
const COLOR_OUTLIER: f64 = 32.0;

/// Largest number of groups with chunks of their own; outliers may have outliers themselves.
const MAX_GROUPS: usize = 8;

/// Bits of the opacity in a packed colour.
const OPACITY: u32 = 0xff;

/// Writes Gaussians along a space-filling curve, so that the 256 Gaussians of a chunk lie close together.
pub(crate) fn write_blocks(path: &Path, outline: &Outline, produce: &mut Produce<'_>) -> Result<()> {
    // Beside the Gaussians, their order and their packed form.
    host_memory::check_writing(path, outline.count.saturating_mul(row_bytes(outline.sh_degree) + 132))?;
    let mut all = Gaussians { sh_degree: outline.sh_degree, ..Default::default() };
    produce(&mut |block| {
        all.append(&block);
        Ok(())
    })?;
    let rows = Rows::of(&all);
    atomic::write_seekable(path, |mut writer| {
        write_sorted(&mut writer, &all, &rows, outline).map_err(|e| Error::io(path, "write", e))
    })
}

fn write_sorted(writer: &mut impl Write, all: &Gaussians, rows: &Rows, outline: &Outline) -> io::Result<()> {
    let higher = 3 * (sh_coefficients(all.sh_degree) - 1);
    write_header(writer, rows, higher, outline)?;
    let mut packed = Vec::with_capacity(rows.order.len());
    for indices in rows.order.chunks(CHUNK) {
        let chunk = Chunk::around(all, indices);
        for value in chunk.values().as_flattened() {
            writer.write_all(&value.to_le_bytes())?;
        }
        packed.extend(indices.iter().map(|&index| chunk.pack(all, index)));
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
            order.extend(morton::order(&means).into_iter().map(|place| group[place]));
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
    write_frame(writer, &outline.frame)?;
    for rows in &rows.padding {
        writeln!(writer, "comment {PADDING} {} {}", rows.start, rows.len())?;
    }
    writeln!(writer, "element chunk {}", count.div_ceil(CHUNK))?;
    CHUNK_PROPERTIES.iter().try_for_each(|name| writeln!(writer, "property float {name}"))?;
    writeln!(writer, "element vertex {count}")?;
    VERTEX_PROPERTIES.iter().try_for_each(|name| writeln!(writer, "property uint {name}"))?;
    if higher > 0 {
        writeln!(writer, "element sh {count}")?;
        (0..higher).try_for_each(|i| writeln!(writer, "property uchar f_rest_{i}"))?;
    }
    writeln!(writer, "end_header")
}

/// The boxes around a chunk's means, log-scales and colours.
struct Chunk {
    mean: [[f32; 3]; 2],
    log_scale: [[f32; 3]; 2],
    color: [[f32; 3]; 2],
}

impl Chunk {
    fn around(all: &Gaussians, indices: &[usize]) -> Self {
        Self {
            mean: extremes(indices.iter().map(|&i| all.means[i])),
            log_scale: extremes(indices.iter().map(|&i| all.log_scales[i]))
                .map(|corner| corner.map(|v| v.clamp(-MAX_COMPRESSED_LOG_SCALE, MAX_COMPRESSED_LOG_SCALE))),
            color: extremes(indices.iter().map(|&i| color(all, i))),
        }
    }

    /// Values in the order of [`CHUNK_PROPERTIES`].
    fn values(&self) -> [[f32; 3]; 6] {
        let Self { mean: [m0, m1], log_scale: [s0, s1], color: [c0, c1] } = *self;
        [m0, m1, s0, s1, c0, c1]
    }

    /// Packs a Gaussian in the order of [`VERTEX_PROPERTIES`].
    fn pack(&self, all: &Gaussians, index: usize) -> [u32; 4] {
        let [r, g, b] = within(color(all, index), &self.color).map(|t| pack_unorm(t, 8));
        let opacity = pack_unorm(f64::from(all.opacity(index)), 8);
        [
            pack_11_10_11(within(all.means[index], &self.mean)),
            pack_rotation(all.quats[index]),
            pack_11_10_11(within(all.log_scales[index], &self.log_scale)),
            r << 24 | g << 16 | b << 8 | opacity,
        ]
    }
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

fn pack_unorm(value: f64, bits: u32) -> u32 {
    let largest = (1 << bits) - 1;
    ((value * f64::from(largest) + 0.5).floor().max(0.0) as u32).min(largest)
}

fn pack_11_10_11([x, y, z]: [f64; 3]) -> u32 {
    pack_unorm(x, 11) << 21 | pack_unorm(y, 10) << 11 | pack_unorm(z, 11)
}

fn pack_rotation(quat: [f32; 4]) -> u32 {
    let quat = quat.map(f64::from);
    let length = quat.iter().map(|q| q * q).sum::<f64>().sqrt();
    let quat = if length > 0.0 { quat.map(|q| q / length) } else { [1.0, 0.0, 0.0, 0.0] };
    let largest = (1..4).fold(0, |best, i| if quat[i].abs() > quat[best].abs() { i } else { best });
    // The omitted component must be positive.
    let sign = if quat[largest] < 0.0 { -1.0 } else { 1.0 };
    let others = (0..4).filter(|&i| i != largest);
    others.fold(largest as u32, |packed, i| {
        packed << 10 | pack_unorm(sign * quat[i] * std::f64::consts::FRAC_1_SQRT_2 + 0.5, 10)
    })
}

fn pack_sh(value: f32) -> u8 {
    ((value / SH_RANGE + 0.5) * 256.0).clamp(0.0, 255.0) as u8
}
