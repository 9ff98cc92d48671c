//! PLY: Gaussians in the layout of the reference implementation, and coloured points.
//!
//! Written: binary little endian, `x y z nx ny nz f_dc_* f_rest_* opacity scale_* rot_*`, normals 0, `f_rest`
//! channel-major (all red coefficients, then green, then blue), scales as logarithms, opacity as a logit,
//! quaternions w first. Read: by property name, in any order, encoding and scalar type.

mod compressed;
mod file;

use std::collections::HashSet;
use std::io::{self, Write};
use std::ops::Range;
use std::path::Path;

use glam::DVec3;

use crate::regular_file::OnFile;
use crate::splats::{BLOCK, Blocks, Format, Header, Opened, Outline, Produce, Sink, WriteOptions, in_blocks};
use crate::{atomic, cameras_json, host_memory};
use ashsplat::scene::gaussians::{MAX_SH_DEGREE, sh_coefficients};
use ashsplat::scene::sh::{rgb_to_sh_dc, sh_dc_to_rgb};
use ashsplat::scene::{Gaussians, PointCloud, SourcePoints, WorldFrame, filtered, median_ball};
use ashsplat::{Error, Result};
use file::{DISKS, Element, FILTER, Marks, ORIGIN, PlyFile, PlyHeader, RenderMode, UNIT};

pub(super) use compressed::{
    morton_order, open as open_compressed, pack_unorm, rotation_of_shares, shares_of_rotation, typical_step,
    write_blocks as write_compressed_blocks,
};
pub use file::Encoding;
pub(crate) use file::{Scalar, decode};

pub(crate) fn claimed_points(path: &Path) -> Result<u64> {
    Ok(PlyFile::open(path)?.header.elements.iter().find(|e| e.name == "vertex").map_or(0, |e| e.count))
}

/// True if a PLY is PlayCanvas' compressed kind.
pub(crate) fn is_compressed(path: &Path) -> Result<bool> {
    let file = PlyFile::open(path)?;
    Ok(file.header.elements.iter().any(|e| e.name == "vertex" && e.has("packed_position")))
}

/// Opens a file of Gaussians in the layout of the reference implementation.
pub(crate) fn open(path: &Path) -> Result<Opened<'_>> {
    let mut file = PlyFile::open(path)?;
    let element = file.seek_element("vertex")?;
    let mut layout = Layout::new(path, &element)?;
    file.check_no_list(&element)?;
    // Rows that cannot be read are reported when all are.
    let sample = first_rows(path, &layout.names[..SH_REST]).unwrap_or_default();
    let position = |row: &[f64; SH_REST]| DVec3::new(row[0], row[1], row[2]);
    let positions = || sample.iter().map(position).collect::<Vec<_>>();
    let restored = restore_frame(path, &mut file.header, positions);
    let marks = &file.header.marks;
    let mut warnings: Vec<String> = marks.warning().into_iter().collect();
    if layout.is_flat && warnings.is_empty() {
        warnings.push(DISKS.into());
    }
    warnings.extend(restored);
    if layout.filtered && marks.mode == RenderMode::Default && marks.kernel_size.is_none() {
        warnings.push(format!(
                "{FILTER} is applied, but nothing says how the scene was antialiased: one of Mip-Splatting needs `--antialiasing \
                 --kernel-size 0.1`"
            ));
    }
    let named_axis = |up| format!("names its vertical axis: `--up {up}` makes orbits and the page follow it");
    warnings.extend(marks.up.map(named_axis));
    if let Some([red, green, blue]) = layout.rgb {
        let white = white(path, &element, [red, green, blue])?;
        layout.white = Some(white);
        warnings.push(format!("has no f_dc: its {red} {green} {blue} (0 to {white}) are used as colours"));
    }
    warnings.extend(unused_properties(&element, &layout));
    warnings.extend(raw_values_doubtful(&sample, layout.rgb.is_none() && !layout.is_flat));
    let count = element.count;
    warnings.extend(file.bytes_behind(&element).map(|bytes| {
        format!(
            "{bytes} bytes behind the {count} Gaussians of its header are not read: are two files joined?"
        )
    }));
    let double_positions = ["x", "y", "z"].iter().any(|name| element.scalar(name) == Some(Scalar::F64));
    let shift = if double_positions { WorldFrame::around(&positions()).origin } else { DVec3::ZERO };
    let header = Header {
        is_2dgs: marks.mode == RenderMode::Disks || layout.is_flat,
        origin: file.header.origin + shift,
        double_positions,
        warnings,
        ..file.header.of_gaussians(Format::Ply, element.count, layout.sh_degree)
    };
    let produce = move |sink: &mut Sink<'_>| {
        let mut blocks = Blocks::new(layout.sh_degree, element.count, sink);
        file.for_each_row(&element, &layout.names, |_, row| {
            layout.push(row, shift, blocks.next()?);
            Ok(())
        })?;
        blocks.finish()
    };
    Ok((header, Box::new(produce)))
}

/// Names unused properties, such as those of moving Gaussians or of Gaussians with another shape.
fn unused_properties(element: &Element, layout: &Layout) -> Option<String> {
    let changes = |name: &&str| {
        ["trbf_", "motion_", "omega_", "rot_r", "quadrant_", "f_offset_", "f_anchor_"]
            .iter()
            .any(|start| name.starts_with(start))
            || ["t", "scale_t", "scale_3"].contains(name)
    };
    // Point viewers use the normals and colours beside `f_dc`.
    const FOR_POINTS: [&str; 10] = ["nx", "ny", "nz", "red", "green", "blue", "alpha", "r", "g", "b"];
    let is_unused = |name: &&str| !FOR_POINTS.contains(name) && !layout.names.iter().any(|own| own == name);
    let names = element.properties.iter().map(|property| property.name.as_str());
    let unused: Vec<&str> = names.filter(is_unused).collect();
    if let Some(first) = unused.iter().find(|name| changes(name)) {
        return Some(format!(
            "property {first} is not used: Gaussians that move or have another shape are drawn as if at rest"
        ));
    }
    let rest = unused.len().saturating_sub(3);
    let more = if rest > 0 { format!(" and {rest} more") } else { String::new() };
    let named = unused.iter().take(3).copied().collect::<Vec<_>>().join(", ");
    (!unused.is_empty()).then(|| format!("{named}{more}: such properties are not used"))
}

/// These properties of the first vertices, which are a sample of the whole file.
fn first_rows(path: &Path, names: &[String]) -> Result<Vec<[f64; SH_REST]>> {
    let mut file = PlyFile::open(path)?;
    let vertex = file.seek_element("vertex")?;
    let first = Element { count: vertex.count.min(BLOCK as u64), ..vertex };
    let mut rows = Vec::new();
    file.for_each_row(&first, names, |_, row| {
        rows.extend(row.first_chunk());
        Ok(())
    })?;
    Ok(rows)
}

/// Names values to which a program seems to have applied sigmoid, exponential or SH already.
fn raw_values_doubtful(sample: &[[f64; SH_REST]], has_all: bool) -> Option<String> {
    let values =
        |columns: Range<usize>| sample.iter().flat_map(move |row| row[columns.clone()].iter().copied());
    let range = |columns: Range<usize>| {
        let empty = [f64::INFINITY, f64::NEG_INFINITY];
        values(columns).fold(empty, |[min, max], value| [min.min(value), max.max(value)])
    };
    // Logits and SH coefficients of trained scenes go far beyond 0 and 1.
    let is_share = |[min, max]: [f64; 2]| min >= 0.0 && max <= 1.0 && max - min > 0.5;
    let [opacity, color, scale] = [OPACITY..SCALE, SH_DC..SH_REST, SCALE..QUATERNION].map(range);
    let mut found = Vec::new();
    if is_share(opacity) {
        found.push("opacities all lie between 0 and 1, but are taken as logits");
    }
    if has_all && (is_share(color) || color[0] >= 0.0 && color[1] > 10.0) {
        found.push("f_dc looks like colours, but is taken as SH coefficients");
    }
    // Taken as logarithms, these values would make every Gaussian at least a unit large, and most of them hardly larger.
    let are_small = || values(SCALE..QUATERNION).sum::<f64>() < sample.len() as f64 * 3.0;
    if has_all && scale[0] >= 0.0 && scale[1] > scale[0] && are_small() {
        found.push("scales look like sizes, but are taken as their logarithms");
    }
    let is_likely = sample.len() >= 16 && !found.is_empty();
    is_likely.then(|| format!("{}: if that is wrong, export raw values", found.join("; ")))
}

/// Reads origin and unit from the cameras.json of a model folder, for a `point_cloud/iteration_N/point_cloud.ply` that
/// lost its comments in an editor. Positions nearer to the origin than to zero are absolute and get no origin. Returns
/// a note if any was used.
pub(super) fn restore_frame(
    path: &Path,
    header: &mut PlyHeader,
    positions: impl FnOnce() -> Vec<DVec3>,
) -> Option<String> {
    if header.origin != DVec3::ZERO || header.unit.is_some() {
        return None;
    }
    let file = dunce::canonicalize(path).ok()?;
    let saved = file.ancestors().nth(2).filter(|saved| saved.ends_with("point_cloud"))?;
    let cameras = saved.parent()?.join("cameras.json");
    let frame = cameras_json::frame_of(&cameras)?;
    let DVec3 { x, y, z } = frame.origin;
    let is_relative =
        median_ball(&positions()).is_some_and(|(center, _)| center.length() <= center.distance(frame.origin));
    let mut used = Vec::new();
    if is_relative && frame.origin != DVec3::ZERO {
        header.origin = frame.origin;
        used.push(format!("origin {x},{y},{z}"));
    }
    if frame.unit != 1.0 {
        header.unit = Some(frame.unit);
        used.push(format!("unit {}", frame.unit));
    }
    let line = || format!("names no {}: {} has it", used.join(" and "), cameras.display());
    (!used.is_empty()).then(line)
}

/// Property names of colours; the last are those of Gaussians.
const COLORS: [[&str; 3]; 4] = [
    ["red", "green", "blue"],
    ["r", "g", "b"],
    ["diffuse_red", "diffuse_green", "diffuse_blue"],
    ["f_dc_0", "f_dc_1", "f_dc_2"],
];

/// Reads coloured points: x y z and a colour, by name; white if there are no colours. Colours are 0 to 255; floats of
/// at most 1 are shares of 255, 16-bit values above 255 shares of 65,535. Gaussians get the colours of their constant
/// SH coefficients. Points at positions that are not finite are dropped. Adds warnings about Gaussians, and about points
/// without colours or finite positions.
pub fn read_points(path: impl AsRef<Path>, warnings: &mut Vec<String>) -> Result<SourcePoints> {
    let path = path.as_ref();
    let mut file = PlyFile::open(path)?;
    let element = file.seek_element("vertex")?;
    if !element.has("x") {
        return Err(missing_properties(path, &element, false));
    }
    let color = COLORS.into_iter().find(|names| names.iter().all(|name| element.has(name)));
    let of_gaussians = color == Some(COLORS[3]);
    if of_gaussians {
        warnings.push(format!("{}: holds Gaussians, taken as points with their colours", path.display()));
    }
    if color.is_none() {
        warnings.push(format!("{}: the points have no colours and start white", path.display()));
    }
    let names: Vec<_> = ["x", "y", "z"].into_iter().chain(color.into_iter().flatten()).collect();
    host_memory::check_free(path, element.count.saturating_mul(39))?;
    let file_origin = file.header.origin;
    let mut points = SourcePoints::default();
    points.positions.reserve(capacity(&element));
    let mut colors: Vec<[f32; 3]> = Vec::with_capacity(capacity(&element));
    let mut dropped = 0;
    file.for_each_row(&element, &names, |_, row| {
        let position = file_origin + DVec3::new(row[0], row[1], row[2]);
        if !position.as_vec3().is_finite() {
            dropped += 1;
            return Ok(());
        }
        points.positions.push(position);
        colors
            .push(row.get(3..6).map_or([255.0; 3], |color| [color[0], color[1], color[2]].map(|c| c as f32)));
        Ok(())
    })?;
    let scalar = color.and_then(|[first, ..]| element.scalar(first));
    let largest = colors.as_flattened().iter().copied().fold(0.0, f32::max);
    let byte = |value: f32| match scalar {
        _ if of_gaussians => 255.0 * sh_dc_to_rgb(value),
        Some(Scalar::F32 | Scalar::F64) if largest <= 1.0 => 255.0 * value,
        Some(Scalar::U16) if largest > 255.0 => value / 257.0,
        _ => value,
    };
    points.colors =
        colors.iter().map(|color| color.map(|c| byte(c).round().clamp(0.0, 255.0) as u8)).collect();
    if dropped > 0 && points.is_empty() {
        let problem = format!("none of its {dropped} points has a finite position");
        return Err(Error::input(path, problem, "export it again"));
    }
    if dropped > 0 {
        let (path, all) = (path.display(), element.count);
        warnings.push(format!(
            "{path}: {dropped} of {all} points have a position that is not finite, and are left out"
        ));
    }
    Ok(points)
}

/// Number of rows to reserve. The header's count has been checked against the file's size.
fn capacity(element: &Element) -> usize {
    usize::try_from(element.count).unwrap_or(0)
}

/// Column layout of a row: `x y z opacity scale_* rot_* f_dc_* f_rest_*`.
struct Layout {
    names: Vec<String>,
    sh_degree: u32,
    /// True if the row's last value is the size of a 3D filter.
    filtered: bool,
    /// Properties with the colours in place of `f_dc`, and their value for white.
    rgb: Option<[&'static str; 3]>,
    white: Option<f64>,
    /// True if `scale_2` is missing; `scale_1` is in its column.
    is_flat: bool,
}

const OPACITY: usize = 3;
const SCALE: usize = 4;
const QUATERNION: usize = 7;
const SH_DC: usize = 11;
const SH_REST: usize = 14;
const REQUIRED: [&str; SH_REST] = [
    "x", "y", "z", "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3", "f_dc_0",
    "f_dc_1", "f_dc_2",
];
impl Layout {
    fn new(path: &Path, element: &Element) -> Result<Self> {
        let mut fixed = REQUIRED;
        let has_none = |names: &[&str]| !names.iter().any(|name| element.has(name));
        // Gaussians without `f_dc` have colours of the first two names.
        let rgb = COLORS.into_iter().take(2).find(|rgb| rgb.iter().all(|name| element.has(name)));
        let rgb = rgb.filter(|_| has_none(&REQUIRED[SH_DC..]));
        if let Some(rgb) = rgb {
            fixed[SH_DC..].copy_from_slice(&rgb);
        }
        let is_flat = has_none(&["scale_2"]);
        if is_flat {
            fixed[SCALE + 2] = "scale_1";
        }
        if fixed.iter().any(|name| !element.has(name)) {
            return Err(missing_properties(path, element, rgb.is_some()));
        }
        let names = element.properties.iter().map(|p| p.name.as_str());
        let rest: HashSet<&str> = names.filter(|name| name.starts_with("f_rest_")).collect();
        let gap = (0..rest.len()).find(|i| !rest.contains(format!("f_rest_{i}").as_str()));
        let rest = rest.len();
        let degree = (0..=MAX_SH_DEGREE).find(|&d| rest == 3 * (sh_coefficients(d) - 1));
        match (gap, degree) {
            (None, Some(sh_degree)) => {
                let rest = (0..rest).map(|i| format!("f_rest_{i}"));
                let filter = element.has(FILTER).then(|| FILTER.to_owned());
                let names = fixed.iter().map(|name| name.to_string()).chain(rest).chain(filter).collect();
                Ok(Self { names, sh_degree, filtered: element.has(FILTER), rgb, white: None, is_flat })
            }
            (Some(gap), _) => {
                let problem = format!("property f_rest_{gap} is missing, though there are {rest} of f_rest");
                Err(Error::input(path, problem, "write the file again with all of them"))
            }
            (None, None) if rest == 72 => {
                let remedy = "export it with degree 3 at most";
                Err(Error::input(path, "has SH of degree 4 (72 f_rest properties)", remedy))
            }
            (None, None) => {
                let problem = format!("{rest} f_rest properties fit no SH degree");
                Err(Error::input(path, problem, "degrees 0 to 3 have 0, 9, 24 and 45"))
            }
        }
    }

    /// Appends the Gaussian of a row, shifted and with its 3D filter applied.
    fn push(&self, row: &[f64], shift: DVec3, gaussians: &mut Gaussians) {
        let (row, size) = row.split_at(row.len() - usize::from(self.filtered));
        let at = |column: usize| row[column] as f32;
        gaussians.means.push((DVec3::new(row[0], row[1], row[2]) - shift).as_vec3().to_array());
        let mut log_scale: [f32; 3] = std::array::from_fn(|axis| at(SCALE + axis));
        if self.is_flat {
            log_scale[2] = f32::NEG_INFINITY;
        }
        let (log_scale, logit) = match size {
            [] => (log_scale, at(OPACITY)),
            size => filtered(log_scale, at(OPACITY), size[0] as f32),
        };
        gaussians.opacity_logits.push(logit);
        gaussians.log_scales.push(log_scale);
        gaussians.quats.push(std::array::from_fn(|i| at(QUATERNION + i)));
        gaussians.sh.push(std::array::from_fn(|channel| match self.white {
            None => at(SH_DC + channel),
            Some(white) => rgb_to_sh_dc((row[SH_DC + channel] / white) as f32),
        }));
        let per_channel = (row.len() - SH_REST) / 3;
        let rest = |i: usize| std::array::from_fn(|channel| at(SH_REST + channel * per_channel + i));
        gaussians.sh.extend((0..per_channel).map(rest));
    }
}

/// The value of white: the type's maximum for integers, 255 for floats if a colour is far above 1.
fn white(path: &Path, element: &Element, names: [&str; 3]) -> Result<f64> {
    match element.scalar(names[0]) {
        Some(Scalar::U16) => return Ok(65535.0),
        Some(Scalar::F32 | Scalar::F64) => {}
        _ => return Ok(255.0),
    }
    let mut file = PlyFile::open(path)?;
    let element = file.seek_element(&element.name)?;
    let mut brightest = 0.0_f64;
    file.for_each_row(&element, &names, |_, row| {
        brightest = row.iter().fold(brightest, |max, &value| max.max(value));
        Ok(())
    })?;
    Ok(if brightest > 2.0 { 255.0 } else { 1.0 })
}

/// The error for a file without Gaussians. It names the kind of the file.
fn missing_properties(path: &Path, element: &Element, has_rgb: bool) -> Error {
    if element.has("packed_position") {
        let problem = "is a compressed PLY of Gaussians (packed_position)";
        return Error::input(path, problem, "`ashsplat convert` makes a plain PLY of it");
    }
    let needed = if has_rgb { &REQUIRED[..SH_DC] } else { &REQUIRED };
    let missing: Vec<&str> = needed.iter().copied().filter(|name| !element.has(name)).collect();
    let any_gaussian_property = REQUIRED[OPACITY..].iter().any(|name| element.has(name));
    if !any_gaussian_property && element.has("x") {
        let problem = format!("is a point cloud or mesh, not Gaussians (property {} is missing)", missing[0]);
        return Error::input(path, problem, "give a point_cloud.ply that training wrote");
    }
    let (noun, verb) = if missing.len() == 1 { ("property", "is") } else { ("properties", "are") };
    let problem = format!("{noun} {} of element vertex {verb} missing", missing.join(", "));
    Error::input(path, problem, "is it a file of Gaussians?")
}

/// Writes Gaussians in the layout of the reference implementation. `filters` holds the sizes of Mip-Splatting's 3D filter,
/// source units.
pub(crate) fn write_blocks(
    path: &Path,
    outline: &Outline,
    filters: Option<&[f32]>,
    produce: &mut Produce<'_>,
) -> Result<()> {
    let mut names = property_names(outline.sh_degree);
    names.extend(filters.map(|_| FILTER.to_owned()));
    let is_double = |name: &str| outline.double_positions && ["x", "y", "z"].contains(&name);
    // Positions in double precision need no origin.
    let doubles = outline.double_positions.then_some(outline.options.frame.origin);
    let origin = if outline.double_positions { DVec3::ZERO } else { outline.options.frame.origin };
    let frame = WorldFrame { origin, ..outline.options.frame };
    let header = Outline { options: WriteOptions { frame, ..outline.options }, ..*outline };
    atomic::write_seekable(path, |mut writer| {
        let scalars =
            names.iter().map(|name| (if is_double(name) { "double" } else { "float" }, name.as_str()));
        write_header(&mut writer, &header, scalars).writing(path)?;
        let (mut rows, mut filters) = (Vec::new(), filters.into_iter().flatten());
        produce(&mut |block| {
            rows.clear();
            for index in 0..block.len() {
                gaussian_row(&block, index, doubles, &mut rows);
                rows.extend(filters.next().into_iter().flat_map(|size| size.to_le_bytes()));
            }
            writer.write_all(&rows).writing(path)
        })
    })
}

/// Writes Gaussians with the sizes of Mip-Splatting's 3D filter as the property `filter_3D`, as Mip-Splatting does.
/// Reading makes the filter a part of scales and opacities.
pub fn write_filtered(
    path: impl AsRef<Path>,
    gaussians: &Gaussians,
    filters: &[f32],
    options: &WriteOptions,
) -> Result<()> {
    gaussians.check_shapes()?;
    if filters.len() != gaussians.len() {
        let problem = format!("are {}, there are {} Gaussians", filters.len(), gaussians.len());
        return Err(Error::argument("filters", problem));
    }
    let unit = options.frame.unit;
    let filters: Vec<f32> = filters.iter().map(|&size| (f64::from(size) * unit) as f32).collect();
    let outline = Outline::of(gaussians, options);
    write_blocks(path.as_ref(), &outline, Some(&filters), &mut |sink| in_blocks(gaussians, unit, sink))
}

/// Writes coloured points like the reference implementation's `input.ply`: `x y z nx ny nz` (float, normals 0) `red
/// green blue` (uchar). The points are in the world coordinates of `frame`; the file has source units from the frame's
/// origin, which its header names.
pub fn write_points(path: impl AsRef<Path>, points: &PointCloud, frame: &WorldFrame) -> Result<()> {
    let floats = ["x", "y", "z", "nx", "ny", "nz"].map(|name| ("float", name));
    let bytes = ["red", "green", "blue"].map(|name| ("uchar", name));
    let options = WriteOptions { frame: *frame, ..Default::default() };
    let outline = Outline { count: points.len() as u64, ..Outline::of(&Gaussians::default(), &options) };
    atomic::write(path, |writer| {
        write_header(&mut *writer, &outline, floats.into_iter().chain(bytes))?;
        for (position, color) in points.positions.iter().zip(&points.colors) {
            let position = position.map(|v| (frame.unit * f64::from(v)) as f32);
            for value in position.iter().chain(&[0.0; 3]) {
                writer.write_all(&value.to_le_bytes())?;
            }
            writer.write_all(color)?;
        }
        Ok(())
    })
}

fn write_header<'a>(
    mut writer: impl Write,
    outline: &Outline,
    properties: impl Iterator<Item = (&'a str, &'a str)>,
) -> io::Result<()> {
    write!(writer, "ply\nformat binary_little_endian 1.0\n")?;
    Marks::write(&mut writer, outline)?;
    write_frame(&mut writer, &outline.options.frame)?;
    writeln!(writer, "element vertex {}", outline.count)?;
    for (kind, name) in properties {
        writeln!(writer, "property {kind} {name}")?;
    }
    writeln!(writer, "end_header")
}

/// Writes the comments about the frame, unless it is the default.
pub(crate) fn write_frame(writer: &mut impl Write, frame: &WorldFrame) -> io::Result<()> {
    let DVec3 { x, y, z } = frame.origin;
    if frame.origin != DVec3::ZERO {
        writeln!(writer, "comment {ORIGIN} {x} {y} {z}")?;
    }
    if frame.unit != 1.0 {
        writeln!(writer, "comment {UNIT} {}", frame.unit)?;
    }
    Ok(())
}

fn property_names(sh_degree: u32) -> Vec<String> {
    let rest = 3 * (sh_coefficients(sh_degree) - 1);
    let fixed = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"];
    let last = ["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"];
    let rest = (0..rest).map(|i| format!("f_rest_{i}"));
    fixed.iter().map(|s| s.to_string()).chain(rest).chain(last.iter().map(|s| s.to_string())).collect()
}

/// `doubles` is the origin of positions that are written in double precision.
fn gaussian_row(gaussians: &Gaussians, index: usize, doubles: Option<DVec3>, row: &mut Vec<u8>) {
    let mean = gaussians.means[index];
    if let Some(origin) = doubles {
        let absolute = origin + DVec3::from_array(mean.map(f64::from));
        absolute.to_array().iter().for_each(|v| row.extend_from_slice(&v.to_le_bytes()));
    }
    let mut put = |value: f32| row.extend_from_slice(&value.to_le_bytes());
    let floats = if doubles.is_some() { &[][..] } else { &mean };
    floats.iter().chain(&[0.0; 3]).for_each(|&v| put(v));
    let sh = gaussians.sh_of(index);
    sh[0].iter().for_each(|&v| put(v));
    for channel in 0..3 {
        sh[1..].iter().for_each(|coefficient| put(coefficient[channel]));
    }
    put(gaussians.opacity_logits[index]);
    gaussians.log_scales[index].iter().for_each(|&v| put(v));
    gaussians.quats[index].iter().for_each(|&v| put(v));
}
