//! A scene as a tree of tiles in which coarser tiles are merged from finer ones: 3D Tiles 1.1 with
//! `KHR_gaussian_splatting` in GLB.

mod tree;

use std::fs::{self, File};
use std::io::Write;
use std::path::{Path, PathBuf};

use glam::{DVec3, Vec3, dvec3};
use serde_json::{Value, json};

use crate::atomic;
use crate::decimate::{covariance_of, decimate};
use crate::progress::Progress;
use crate::regular_file::{self, OnFile};
use crate::splats::{self, EXTENSION, Format, OriginSample, PACKED_EXTENSION, ReadOptions, WriteOptions};
use ashsplat::scene::gaussians::sh_coefficients;
use ashsplat::scene::{Bounds, Cells, Gaussians, Similarity};
use ashsplat::{Error, Result};

pub use tree::{Demand, TILESET_FILE, Tile as TreeTile, Tree};

/// Number of Gaussians of finer tiles that become one of the coarser tile: on surfaces, half of the resolution.
const MERGED: usize = 4;
/// Reach of a Gaussian, standard deviations: an opaque one is drawn up to √(2 ln 255).
const REACH: f64 = 3.34;
/// Largest reach of a Gaussian from its mean, world units: single precision ends soon after.
const MOST_REACH: f64 = 1e38;

/// Options for dividing a scene into tiles.
#[derive(Clone, Copy, Debug)]
pub struct TileOptions {
    /// Largest number of Gaussians in a tile.
    pub most: usize,
    /// True if the tiles' attributes are packed as SPZ version 2, with `KHR_gaussian_splatting_compression_spz_2`.
    /// CesiumJS reads no others.
    pub packed: bool,
}

impl Default for TileOptions {
    /// 50,000 Gaussians, not packed.
    fn default() -> Self {
        Self { most: 50_000, packed: false }
    }
}

/// Measures how much pictures of the merged Gaussians (second argument) differ from those of the finer ones (first),
/// in world units. The measure is the root of the squared difference from 0 to 1, integrated over the tile. Divided by a
/// pixel's size, it is the root of the squared difference of a picture, summed over pixels.
pub type Measure<'a> = dyn FnMut(&Gaussians, &Gaussians) -> Result<f64> + 'a;

/// Result of writing the tiles.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Tiling {
    /// Number of Gaussians in the scene.
    pub gaussians: u64,
    /// Number of tiles.
    pub tiles: usize,
    /// Number of tiles with the scene's own Gaussians.
    pub leaves: usize,
    /// Number of levels from the coarsest tile to the finest.
    pub levels: usize,
    /// Number of Gaussians in all tiles.
    pub written: u64,
    /// Warnings about the scene.
    pub warnings: Vec<String>,
}

/// Writes the tiles of a scene and their `tileset.json` into a new folder. The same scene gives the same bytes.
///
/// A k-d tree ([`Cells`]) divides the scene. Each cell of its finest level is a tile with the Gaussians centred there,
/// unchanged. A tile above has about four children and a quarter of their Gaussians ([`decimate`]). The host holds the
/// centres of all Gaussians, and the tiles on the path from the root to a finest one. The scene's rows lie in the
/// folder on disk meanwhile.
///
/// # Errors
/// [`Error::Input`] for more Gaussians at one place than a tile holds, for means that are too far out for SPZ, and for a
/// folder that is not empty; errors of `measure`. Nothing is left then.
pub fn write(
    input: &Path,
    folder: &Path,
    options: &TileOptions,
    read: &ReadOptions,
    measure: &mut Measure<'_>,
    progress: &Progress<'_>,
) -> Result<Tiling> {
    let is_empty = |folder: &Path| fs::read_dir(folder).is_ok_and(|mut entries| entries.next().is_none());
    if folder.symlink_metadata().is_ok() && !is_empty(folder) {
        return Err(Error::input(folder, "is there already", "give another folder, or remove it"));
    }
    // The tree is written beside the folder and renamed at the end.
    if folder.is_symlink() || folder.file_name().is_none() {
        return Err(Error::input(folder, "cannot be replaced by a new folder", "give the name of one"));
    }
    let beside = folder.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let mut builder = tempfile::Builder::new();
    // A folder's usual permissions, not the private ones of a temporary folder.
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o777));
    let unfinished = builder.prefix(".tiles").tempdir_in(beside);
    let unfinished = unfinished.on(beside, "write into")?;
    let spill = Spill::of(input, unfinished.path(), options.most, read, progress)?;
    let done =
        Tiling { gaussians: spill.means.len() as u64, warnings: spill.warnings.clone(), ..Tiling::default() };
    let mut writer =
        TileWriter { spill, input, folder: unfinished.path(), options, measure, progress, done, loss: None };
    let steps = steps(&writer.spill.means, &writer.spill.cells, options.most)?;
    let root = writer.write(&steps)?.ok_or_else(|| Error::argument("tiles", "there are none"))?;
    write_tileset(&unfinished.path().join(TILESET_FILE), &root, writer.spill.origin, options.packed)?;
    let mut done = Tiling { levels: root.levels, ..writer.done };
    done.warnings.extend(writer.loss.map(|(line, others)| match others {
        0 => line,
        others => format!("{line}; the same for {others} other tiles"),
    }));
    fs::remove_dir(unfinished.path().join(ROWS)).writing(folder)?;
    let whole = unfinished.keep();
    let renamed = if is_empty(folder) { fs::remove_dir(folder) } else { Ok(()) };
    renamed.and_then(|()| fs::rename(&whole, folder)).map_err(|e| {
        fs::remove_dir_all(&whole).ok();
        Error::input(folder, format!("cannot be written: {e}"), "give a folder that is not there yet")
    })?;
    Ok(done)
}

/// Folder of the scene's rows until their tile is written.
const ROWS: &str = "rows";

/// The scene's rows on disk, by cells of the finest level, and what stays in memory of them.
struct Spill {
    means: Vec<[f32; 3]>,
    /// Origin of the means, source coordinates.
    origin: DVec3,
    warnings: Vec<String>,
    folder: PathBuf,
    cells: Cells,
    sh_degree: u32,
    antialiased: bool,
    kernel_size: Option<f32>,
}

impl Spill {
    fn of(
        input: &Path,
        folder: &Path,
        most: usize,
        read: &ReadOptions,
        progress: &Progress<'_>,
    ) -> Result<Spill> {
        let mut reader = splats::open(input, read)?;
        let header = reader.header.clone();
        let (mut means, mut sample) = (Vec::new(), OriginSample::default());
        let step = OriginSample::step(header.count);
        reader.blocks(&mut |block| {
            sample.add(&block, step);
            means.extend(block.means);
            progress.check()
        })?;
        let origin = sample.origin(header.origin);
        let shift = Similarity { translation: header.origin - origin, ..Default::default() };
        for mean in &mut means {
            *mean = shift.apply(DVec3::from_array(mean.map(f64::from))).as_vec3().to_array();
        }
        let warnings = header.warnings.iter().cloned().chain(reader.warnings.drain(..)).collect();
        if means.is_empty() {
            return Err(Error::input(input, "has no Gaussians", "give a trained scene"));
        }
        // Means are finite, and there is at least one, so too many are at one place.
        let cells = Cells::divide(&means, most).map_err(|e| {
            Error::input(input, format!("cannot be divided: {e}"), "give more --max-gaussians")
        })?;
        let folder = folder.join(ROWS);
        fs::create_dir(&folder).on(&folder, "create")?;
        let splats::Header { sh_degree, antialiased, kernel_size, .. } = header;
        let spill = Spill { means, origin, warnings, folder, cells, sh_degree, antialiased, kernel_size };
        splats::open(input, read)?.blocks(&mut |mut block| {
            progress.check()?;
            block.transform(&shift);
            spill.add(&block)
        })?;
        Ok(spill)
    }

    fn path(&self, cell: usize) -> PathBuf {
        self.folder.join(cell.to_string())
    }

    /// Appends a block's rows to the files of their cells. A single file is open at a time.
    fn add(&self, block: &Gaussians) -> Result<()> {
        let mut by_cell: Vec<(usize, usize)> = (0..block.len())
            .filter_map(|row| Some((self.cells.at(Vec3::from_array(block.means[row]))?, row)))
            .collect();
        by_cell.sort_unstable();
        for rows in by_cell.chunk_by(|a, b| a.0 == b.0) {
            let mut bytes = Vec::new();
            for &(_, row) in rows {
                let floats = [&block.means[row][..], &block.quats[row], &block.log_scales[row]].concat();
                bytes.extend_from_slice(bytemuck::cast_slice(&floats));
                bytes.extend_from_slice(bytemuck::bytes_of(&block.opacity_logits[row]));
                bytes.extend_from_slice(bytemuck::cast_slice(block.sh_of(row)));
            }
            let path = self.path(rows[0].0);
            let file = File::options().append(true).create(true).open(&path);
            file.and_then(|mut file| file.write_all(&bytes)).writing(&path)?;
        }
        Ok(())
    }

    /// Reads a cell's rows, in the order of the scene, and removes them from the disk.
    fn take(&self, cell: usize) -> Result<Gaussians> {
        let path = self.path(cell);
        let bytes = regular_file::read(&path, 3)?;
        fs::remove_file(&path).on(&path, "remove")?;
        let floats: Vec<f32> = bytemuck::pod_collect_to_vec(&bytes);
        let width = 11 + 3 * sh_coefficients(self.sh_degree);
        let mut all = Gaussians::with_capacity(self.sh_degree, floats.len() / width);
        for row in floats.chunks_exact(width) {
            all.means.push([row[0], row[1], row[2]]);
            all.quats.push([row[3], row[4], row[5], row[6]]);
            all.log_scales.push([row[7], row[8], row[9]]);
            all.opacity_logits.push(row[10]);
            all.sh.extend_from_slice(row[11..].as_chunks::<3>().0);
        }
        Ok(all)
    }
}

/// One of the tiles to be written, in an order in which children come before their parents.
enum Step {
    /// The cell of the finest level.
    Leaf(usize),
    /// Parent of this many of the last tiles without a parent.
    Above(usize),
}

/// The steps to all tiles. The same division ends earlier for larger cells, so that each consists of whole smaller ones.
fn steps(means: &[[f32; 3]], finest: &Cells, mut most: usize) -> Result<Vec<Step>> {
    let mut inside: Vec<Vec3> = vec![Vec3::NAN; finest.bounds().len()];
    for mean in means.iter().copied().map(Vec3::from_array) {
        if let Some(cell) = finest.at(mean) {
            inside[cell] = mean;
        }
    }
    // Each tree with a place inside of it.
    let mut trees: Vec<(Vec<Step>, Vec3)> =
        inside.into_iter().enumerate().map(|(cell, place)| (vec![Step::Leaf(cell)], place)).collect();
    while trees.len() > 1 {
        most = most.saturating_mul(MERGED);
        let coarser = Cells::divide(means, most)?;
        let mut below: Vec<Vec<(Vec<Step>, Vec3)>> = coarser.bounds().iter().map(|_| Vec::new()).collect();
        for (tree, place) in trees {
            if let Some(cell) = coarser.at(place) {
                below[cell].push((tree, place));
            }
        }
        trees = below.into_iter().filter_map(joined).collect();
    }
    Ok(trees.pop().map(|(steps, _)| steps).unwrap_or_default())
}

/// Joins several trees under one parent; a single one is returned unchanged.
fn joined(mut own: Vec<(Vec<Step>, Vec3)>) -> Option<(Vec<Step>, Vec3)> {
    if own.len() < 2 {
        return own.pop();
    }
    let (count, place) = (own.len(), own[0].1);
    let below = own.into_iter().flat_map(|(steps, _)| steps);
    Some((below.chain([Step::Above(count)]).collect(), place))
}

struct TileWriter<'a, 'm> {
    spill: Spill,
    input: &'a Path,
    folder: &'a Path,
    options: &'a TileOptions,
    measure: &'a mut Measure<'m>,
    progress: &'a Progress<'a>,
    done: Tiling,
    /// The first warning about losses in a tile, and the number of further tiles with losses.
    loss: Option<(String, usize)>,
}

impl TileWriter<'_, '_> {
    /// Writes all tiles. Returns the coarsest.
    fn write(&mut self, steps: &[Step]) -> Result<Option<Tile>> {
        let mut written = Vec::new();
        for step in steps {
            let built = match *step {
                Step::Leaf(cell) => self.tile(self.spill.take(cell)?, Vec::new(), 0.0, steps.len())?,
                Step::Above(count) => self.above(written.split_off(written.len() - count), steps.len())?,
            };
            written.push(built);
        }
        Ok(written.pop().map(|(_, root)| root))
    }

    fn above(&mut self, below: Vec<(Gaussians, Tile)>, total: usize) -> Result<(Gaussians, Tile)> {
        let mut finer = Gaussians::with_capacity(self.spill.sh_degree, 0);
        let mut children = Vec::new();
        for (gaussians, tile) in below {
            finer.append(&gaussians);
            children.push(tile);
        }
        let mut merged = finer.clone();
        decimate(&mut merged, (finer.len() / MERGED).clamp(1, self.options.most));
        // Squares of uncorrelated differences add up, such as those of tiles side by side.
        let squares = children.iter().map(|tile: &Tile| tile.error.powi(2)).sum::<f64>();
        let error = (squares + (self.measure)(&finer, &merged)?.powi(2)).sqrt();
        self.tile(merged, children, error, total)
    }

    fn tile(
        &mut self,
        gaussians: Gaussians,
        children: Vec<Tile>,
        error: f64,
        total: usize,
    ) -> Result<(Gaussians, Tile)> {
        self.progress.check()?;
        let name = format!("{}.glb", self.done.tiles);
        // The root's transform places all tiles.
        let write = WriteOptions {
            format: Some(Format::Glb),
            antialiased: self.spill.antialiased,
            kernel_size: self.spill.kernel_size,
            spz_version: self.options.packed.then_some(2),
            ..WriteOptions::default()
        };
        let loss =
            splats::write_changed(self.folder.join(&name), &gaussians, &write).map_err(|e| match e {
                // The folder still has its temporary name, and the scene is the cause, so the error names the input.
                Error::Input { problem, remedy, .. } => {
                    Error::input(self.input, format!("{name}: {problem}"), remedy)
                }
                other => other,
            })?;
        match &mut self.loss {
            Some((_, others)) => *others += usize::from(loss.is_some()),
            first => *first = loss.map(|line| (format!("{name}: {line}"), 0)),
        }
        self.done.tiles += 1;
        self.done.leaves += usize::from(children.is_empty());
        self.done.written += gaussians.len() as u64;
        self.progress.step(self.done.tiles, total);
        // A tile's bounds hold those of its children, whose Gaussians may reach farther than the merged ones.
        let reach = children.iter().map(|tile: &Tile| tile.bounds).fold(reach(&gaussians), enclosing);
        let tile = Tile::new(&name, gaussians.len(), (reach, error), children);
        Ok((gaussians, tile))
    }
}

fn enclosing(a: Bounds, b: Bounds) -> Bounds {
    Bounds { min: a.min.min(b.min), max: a.max.max(b.max) }
}

/// The box that the Gaussians reach.
fn reach(all: &Gaussians) -> Bounds {
    let nothing = Bounds { min: Vec3::INFINITY, max: Vec3::NEG_INFINITY };
    let own = |index: usize| {
        let covariance = covariance_of(all, index);
        let half = [0, 1, 2].map(|axis| (REACH * covariance.col(axis)[axis].sqrt()).min(MOST_REACH) as f32);
        let (mean, half) = (Vec3::from_array(all.means[index]), Vec3::from_array(half));
        Bounds { min: mean - half, max: mean + half }
    };
    (0..all.len()).map(own).fold(nothing, enclosing)
}

pub(super) struct Tile {
    /// Reach of the tile and its children, in this crate's frame.
    pub(super) bounds: Bounds,
    /// Geometric error, world units: 0 for the scene's own Gaussians.
    pub(super) error: f64,
    /// Number of levels from this tile to the finest.
    pub(super) levels: usize,
    json: Value,
}

impl Tile {
    /// The tile of the file `name`, with its children.
    pub(super) fn new(
        name: &str,
        gaussians: usize,
        (bounds, error): (Bounds, f64),
        children: Vec<Tile>,
    ) -> Tile {
        let mut json = json!({
            "boundingVolume": { "box": box_of(bounds) },
            "geometricError": error,
            "refine": "REPLACE",
            "content": { "uri": name },
            "extras": { "gaussians": gaussians },
        });
        let levels = 1 + children.iter().map(|tile| tile.levels).max().unwrap_or(0);
        if !children.is_empty() {
            json["children"] = children.into_iter().map(|tile| tile.json).collect();
        }
        Tile { bounds, error, levels, json }
    }
}

/// Converts a point from this crate's frame to that of tiles, and back.
fn turned(point: DVec3) -> DVec3 {
    dvec3(-point.x, -point.z, -point.y)
}

/// Bounding volume of 3D Tiles: centre, then three half axes, in the frame of tiles.
fn box_of(bounds: Bounds) -> [f64; 12] {
    let [a, b] = [bounds.min, bounds.max].map(|corner| turned(corner.as_dvec3()));
    let (centre, half) = (0.5 * (a + b), 0.5 * (a - b).abs());
    [centre.x, centre.y, centre.z, half.x, 0.0, 0.0, 0.0, half.y, 0.0, 0.0, 0.0, half.z]
}

/// Writes the description of a tree whose tiles are relative to an origin.
fn write_tileset(path: &Path, root: &Tile, origin: DVec3, packed: bool) -> Result<()> {
    // Error of drawing nothing at all.
    let nothing = root.bounds.max.as_dvec3().distance(root.bounds.min.as_dvec3()).max(root.error);
    // Viewers look here before they load the first tile.
    let both = [EXTENSION, PACKED_EXTENSION];
    let used = match packed {
        true => json!({ "extensionsUsed": both, "extensionsRequired": both }),
        false => json!({ "extensionsUsed": [EXTENSION] }),
    };
    let mut document = json!({
        "asset": { "version": "1.1", "generator": concat!("ashsplat ", env!("CARGO_PKG_VERSION")) },
        "extensionsUsed": ["3DTILES_content_gltf"],
        "extensions": { "3DTILES_content_gltf": used },
        "geometricError": nothing,
        "root": root.json,
    });
    if origin != DVec3::ZERO {
        let DVec3 { x, y, z } = turned(origin);
        let columns = [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, x, y, z, 1.0];
        document["root"]["transform"] = json!(columns);
    }
    atomic::write(path, |writer| writer.write_all(format!("{document:#}\n").as_bytes()))
}
