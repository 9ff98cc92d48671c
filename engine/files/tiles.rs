//! A scene as a tree of tiles in which coarser tiles are merged from finer ones: 3D Tiles 1.1 with
//! `KHR_gaussian_splatting` in GLB. [`write()`] writes one, a [`Tree`] chooses the tiles for a camera.

mod streamed_sog;

use std::cmp::Reverse;
use std::collections::{BTreeSet, BinaryHeap};
use std::fs::{self, File};
use std::io::Write;
use std::path::{Path, PathBuf};

use glam::{DMat4, DVec3, Vec3, dvec3, vec3};
use serde::{Deserialize, Serialize};
use serde_json::json;

use crate::decimate::{covariance_of, decimate};
use crate::progress::Progress;
use crate::regular_file::OnFile;
use crate::splats::{
    EXTENSION, FARTHEST, Format, OriginSample, PACKED_EXTENSION, ReadOptions, Scene, WriteOptions,
};
use crate::{atomic, regular_file, splats};
use ashsplat::scene::gaussians::sh_coefficients;
use ashsplat::scene::{Bounds, Camera, Cells, Gaussians, NEAR_PLANE, Similarity, WorldFrame};
use ashsplat::{Error, Result};

pub use streamed_sog::write_streamed_sog;

/// Number of Gaussians of finer tiles that become one of the coarser tile: on surfaces, half of the resolution.
const MERGED: usize = 4;
/// Reach of a Gaussian, standard deviations: an opaque one is drawn up to √(2 ln 255).
const REACH: f64 = 3.34;
/// Largest reach of a Gaussian from its mean, world units: single precision ends soon after.
const MAX_REACH: f64 = 1e38;

/// Options for dividing a scene into tiles.
#[derive(Clone, Copy, Debug)]
pub struct TileOptions {
    /// Largest number of Gaussians in a tile.
    pub max_gaussians: usize,
    /// True if the tiles' attributes are packed as SPZ version 2, with `KHR_gaussian_splatting_compression_spz_2`.
    /// CesiumJS reads no others.
    pub packed: bool,
}

impl Default for TileOptions {
    /// 50,000 Gaussians, not packed.
    fn default() -> Self {
        Self { max_gaussians: 50_000, packed: false }
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
    in_new_folder(folder, |folder| {
        let spill = Spill::of(input, folder, options.max_gaussians, read, progress)?;
        let done = Tiling {
            gaussians: spill.means.len() as u64,
            warnings: spill.warnings.clone(),
            ..Tiling::default()
        };
        let losses = PartLosses::default();
        let mut writer = TileWriter { spill, input, folder, options, measure, progress, done, losses };
        let steps = steps(&writer.spill.means, &writer.spill.cells, options.max_gaussians)?;
        let root = writer.write(&steps)?.ok_or_else(|| Error::argument("tiles", "there are none"))?;
        write_tileset(&folder.join(TILESET_FILE), &root, writer.spill.origin, options.packed)?;
        let mut done = Tiling { levels: root.levels, ..writer.done };
        done.warnings.extend(Format::Glb.losses(writer.spill.sh_degree, &writer.spill.marks));
        done.warnings.extend(writer.losses.line("tiles"));
        Ok(done)
    })
}

/// Makes a folder beside its later place, and moves it there when it is whole. Its [`ROWS`] are removed.
fn in_new_folder<T>(folder: &Path, fill: impl FnOnce(&Path) -> Result<T>) -> Result<T> {
    let is_empty = |folder: &Path| fs::read_dir(folder).is_ok_and(|mut entries| entries.next().is_none());
    if folder.symlink_metadata().is_ok() && !is_empty(folder) {
        return Err(Error::input(folder, "is there already", "give another folder, or remove it"));
    }
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
    let filled = fill(unfinished.path())?;
    fs::remove_dir(unfinished.path().join(ROWS)).writing(folder)?;
    let whole = unfinished.keep();
    let renamed = if is_empty(folder) { fs::remove_dir(folder) } else { Ok(()) };
    renamed.and_then(|()| fs::rename(&whole, folder)).map_err(|e| {
        fs::remove_dir_all(&whole).ok();
        Error::input(folder, format!("cannot be written: {e}"), "give a folder that is not there yet")
    })?;
    Ok(filled)
}

/// An error of a part names the scene, which is the cause: the folder still has its temporary name.
fn of_input(input: &Path, part: &str, error: Error) -> Error {
    match error {
        Error::Input { problem, remedy, .. } => Error::input(input, format!("{part}: {problem}"), remedy),
        other => other,
    }
}

/// The first warning about losses in a part of a scene, and the number of further ones.
#[derive(Default)]
struct PartLosses(Option<(String, usize)>);

impl PartLosses {
    fn add(&mut self, part: &str, line: String) {
        match &mut self.0 {
            Some((_, others)) => *others += 1,
            first => *first = Some((format!("{part}: {line}"), 0)),
        }
    }

    fn line(self, parts: &str) -> Option<String> {
        self.0.map(|(line, others)| match others {
            0 => line,
            others => format!("{line}; the same for {others} other {parts}"),
        })
    }
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
    /// Marks of the scene's file.
    marks: WriteOptions,
}

impl Spill {
    fn of(
        input: &Path,
        folder: &Path,
        max_gaussians: usize,
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
        let cells = Cells::divide(&means, max_gaussians).map_err(|e| {
            Error::input(input, format!("cannot be divided: {e}"), "give more --max-gaussians")
        })?;
        let folder = folder.join(ROWS);
        fs::create_dir(&folder).on(&folder, "create")?;
        let splats::Header { sh_degree, antialiased, kernel_size, distance_order, is_2dgs, .. } = header;
        let marks = WriteOptions { antialiased, kernel_size, distance_order, is_2dgs, ..Default::default() };
        let spill = Spill { means, origin, warnings, folder, cells, sh_degree, marks };
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
fn steps(means: &[[f32; 3]], finest: &Cells, mut max_gaussians: usize) -> Result<Vec<Step>> {
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
        max_gaussians = max_gaussians.saturating_mul(MERGED);
        let coarser = Cells::divide(means, max_gaussians)?;
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
    losses: PartLosses,
}

impl TileWriter<'_, '_> {
    fn write(&mut self, steps: &[Step]) -> Result<Option<TileFile>> {
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

    fn above(&mut self, below: Vec<(Gaussians, TileFile)>, total: usize) -> Result<(Gaussians, TileFile)> {
        let mut finer = Gaussians::with_capacity(self.spill.sh_degree, 0);
        let mut children = Vec::new();
        for (gaussians, tile) in below {
            finer.append(&gaussians);
            children.push(tile);
        }
        let mut merged = finer.clone();
        decimate(&mut merged, (finer.len() / MERGED).clamp(1, self.options.max_gaussians));
        // Squares of uncorrelated differences add up, such as those of tiles side by side.
        let squares = children.iter().map(|tile: &TileFile| tile.json.geometric_error.powi(2)).sum::<f64>();
        let error = (squares + (self.measure)(&finer, &merged)?.powi(2)).sqrt();
        self.tile(merged, children, error, total)
    }

    fn tile(
        &mut self,
        gaussians: Gaussians,
        children: Vec<TileFile>,
        error: f64,
        total: usize,
    ) -> Result<(Gaussians, TileFile)> {
        self.progress.check()?;
        let name = format!("{}.glb", self.done.tiles);
        // The root's transform places all tiles.
        let write = WriteOptions {
            format: Some(Format::Glb),
            spz_version: self.options.packed.then_some(2),
            ..self.spill.marks
        };
        let loss = splats::write_changed(self.folder.join(&name), &gaussians, &write)
            .map_err(|e| of_input(self.input, &name, e))?;
        if let Some(line) = loss {
            self.losses.add(&name, line);
        }
        self.done.tiles += 1;
        self.done.leaves += usize::from(children.is_empty());
        self.done.written += gaussians.len() as u64;
        self.progress.step(self.done.tiles, total);
        // A tile's bounds hold those of its children, whose Gaussians may reach farther than the merged ones.
        let bounds = children.iter().map(|tile| tile.bounds).fold(reach(&gaussians), enclosing);
        let levels = 1 + children.iter().map(|tile| tile.levels).max().unwrap_or(0);
        let json = TileJson {
            refine: REPLACE.into(),
            transform: None,
            bounding_volume: BoxJson { r#box: box_of(bounds) },
            geometric_error: error,
            content: ContentJson { uri: name },
            extras: ExtrasJson { gaussians: gaussians.len() as u32 },
            children: children.into_iter().map(|tile| tile.json).collect(),
        };
        Ok((gaussians, TileFile { bounds, levels, json }))
    }
}

fn enclosing(a: Bounds, b: Bounds) -> Bounds {
    Bounds { min: a.min.min(b.min), max: a.max.max(b.max) }
}

fn reach(all: &Gaussians) -> Bounds {
    box_around(all, |index| {
        let covariance = covariance_of(all, index);
        DVec3::from_array([0, 1, 2].map(|axis| REACH * covariance.col(axis)[axis].sqrt()))
    })
}

/// The box of Gaussians that have these half sides.
fn box_around(all: &Gaussians, half: impl Fn(usize) -> DVec3) -> Bounds {
    let nothing = Bounds { min: Vec3::INFINITY, max: Vec3::NEG_INFINITY };
    let own = |index: usize| {
        let (mean, half) = (Vec3::from_array(all.means[index]), half(index).min(DVec3::splat(MAX_REACH)));
        Bounds { min: mean - half.as_vec3(), max: mean + half.as_vec3() }
    };
    (0..all.len()).map(own).fold(nothing, enclosing)
}

/// A tile whose file is written.
struct TileFile {
    /// Reach of the tile and its children, in this crate's frame.
    bounds: Bounds,
    /// Number of levels from this tile to the finest.
    levels: usize,
    json: TileJson,
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
fn write_tileset(path: &Path, root: &TileFile, origin: DVec3, packed: bool) -> Result<()> {
    // Error of drawing nothing at all.
    let nothing =
        root.bounds.max.as_dvec3().distance(root.bounds.min.as_dvec3()).max(root.json.geometric_error);
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

/// Margin of a tile's box in a picture, pixels: the low-pass filter widens Gaussians.
const MARGIN: f64 = 2.0;
const WRITE_AGAIN: &str = "write the tree again with `ashsplat tiles`";

/// Name of the description in the folder.
pub const TILESET_FILE: &str = "tileset.json";

/// A tree of tiles in a folder.
#[derive(Clone, Debug)]
pub struct Tree {
    folder: PathBuf,
    tiles: Vec<Tile>,
    /// Origin of the files' positions.
    file_origin: DVec3,
    /// Frame of bounds, errors and the Gaussians that are read.
    frame: WorldFrame,
}

/// A tile.
#[derive(Clone, Debug, PartialEq)]
pub struct Tile {
    /// Name of the tile's file in the folder.
    pub name: String,
    /// Reach of the tile and its descendants, world units, this crate's frame.
    pub bounds: Bounds,
    /// Difference of its picture from that of the finest tiles, world units: see the guide's chapter on tiles.
    pub error: f64,
    /// Number of Gaussians.
    pub gaussians: usize,
    /// The tiles that replace it.
    pub children: Vec<usize>,
}

#[derive(Deserialize, Serialize)]
#[serde(rename_all = "camelCase")]
struct TileJson {
    refine: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    transform: Option<[f64; 16]>,
    bounding_volume: BoxJson,
    geometric_error: f64,
    content: ContentJson,
    extras: ExtrasJson,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    children: Vec<TileJson>,
}

/// [`TileJson::refine`] of tiles that replace the one above them.
const REPLACE: &str = "REPLACE";

#[derive(Deserialize)]
struct TilesetJson {
    root: TileJson,
}

#[derive(Deserialize, Serialize)]
struct BoxJson {
    r#box: [f64; 12],
}

#[derive(Deserialize, Serialize)]
struct ContentJson {
    uri: String,
}

#[derive(Deserialize, Serialize)]
struct ExtrasJson {
    gaussians: u32,
}

impl Tree {
    /// Reads the description of a tree, but no tile.
    pub fn open(folder: impl AsRef<Path>) -> Result<Tree> {
        let folder = folder.as_ref();
        let path = folder.join(TILESET_FILE);
        let text = regular_file::read_json(&path)?;
        let foreign = |problem: &dyn std::fmt::Display| {
            let problem = format!("is no tree of Gaussians: {problem}");
            Error::input(&path, problem, "give one that `ashsplat tiles` has written, or one .glb of it")
        };
        // A nested tile takes two levels of JSON; the parser allows 128.
        let TilesetJson { root } = serde_json::from_slice(&text).map_err(|e| foreign(&e))?;
        let (mut tiles, mut names, mut origin) = (Vec::<Tile>::new(), BTreeSet::new(), DVec3::ZERO);
        // Tiles that are not yet listed, each with its parent; the next one is the last.
        let mut open = vec![(None, root)];
        while let Some((above, mut json)) = open.pop() {
            if above.is_none() {
                origin = moved(&path, json.transform.take())?;
            }
            let index = tiles.len();
            tiles.push(checked(&path, &json)?);
            if let Some(above) = above {
                let above: &mut Tile = &mut tiles[above];
                above.children.push(index);
            }
            if !names.insert(json.content.uri.clone()) {
                let problem = format!("names {} twice", json.content.uri);
                return Err(Error::input(&path, problem, WRITE_AGAIN));
            }
            open.extend(json.children.into_iter().rev().map(|child| (Some(index), child)));
        }
        let frame = WorldFrame { origin, unit: 1.0 };
        Ok(Tree { folder: folder.to_owned(), tiles, file_origin: origin, frame })
    }

    /// Frame of the tiles within the coordinates of the scene's file.
    pub fn frame(&self) -> WorldFrame {
        self.frame
    }

    /// Moves the tree to its drawing frame, like [`Scene::in_world_frame`].
    pub fn in_world_frame(mut self) -> Tree {
        let corners = |Bounds { min, max }: Bounds| [min, 0.5 * min + 0.5 * max, max];
        let points = self.tiles.iter().flat_map(|tile| corners(tile.bounds));
        let around =
            WorldFrame::around_gaussians(&points.map(|point| self.frame.source(point)).collect::<Vec<_>>());
        let own = self.frame.origin;
        let frame = WorldFrame { origin: if own == DVec3::ZERO { around.origin } else { own }, ..around };
        let to = Similarity::between(&self.frame, &frame);
        for tile in &mut self.tiles {
            let [min, max] =
                [tile.bounds.min, tile.bounds.max].map(|corner| to.apply(corner.as_dvec3()).as_vec3());
            (tile.bounds, tile.error) = (Bounds { min, max }, to.scale * tile.error);
        }
        self.frame = frame;
        self
    }

    /// All tiles; the first is the coarsest.
    pub fn tiles(&self) -> &[Tile] {
        &self.tiles
    }

    /// Number of Gaussians in the finest tiles, which are those of the scene.
    pub fn gaussians(&self) -> usize {
        self.tiles.iter().filter(|tile| tile.children.is_empty()).map(|tile| tile.gaussians).sum()
    }

    /// The tiles to draw for a camera, in ascending order: those in its picture, as fine as `budget` Gaussians allow,
    /// and finest where the error in pixels is largest. The coarsest tile is drawn even beyond the budget; nothing if
    /// it is out of view.
    pub fn cut(&self, camera: &Camera, budget: usize) -> Vec<usize> {
        self.cut_among(&Demand::of(camera, budget), |_| true)
    }

    /// The tiles of a cut and their ancestors, in the order in which to load them for [`Tree::cut_among`]. A tile comes
    /// after its parent, and earlier if the parent's error in pixels is larger.
    pub fn wanted(&self, demand: &Demand<'_>) -> Vec<usize> {
        self.wanted_among(demand, |_| true)
    }

    /// Same as [`Tree::wanted`], but some tiles will never be available, for example because they cannot be read. Tiles
    /// that could only be drawn beside or below one of them are omitted.
    pub fn wanted_among(&self, demand: &Demand<'_>, is_possible: impl Fn(usize) -> bool) -> Vec<usize> {
        self.refined(demand, &is_possible).1
    }

    /// Same as [`Tree::cut`], among the available tiles: a tile is drawn itself until all tiles that replace it are
    /// available. Empty without the coarsest tile.
    pub fn cut_among(&self, demand: &Demand<'_>, is_there: impl Fn(usize) -> bool) -> Vec<usize> {
        self.refined(demand, &is_there).0
    }

    /// The tiles to draw, and those together with the tiles that they have replaced.
    fn refined(&self, demand: &Demand<'_>, is_there: &dyn Fn(usize) -> bool) -> (Vec<usize>, Vec<usize>) {
        let near =
            |index: &usize| demand.cameras.iter().any(|c| sees(c, self.tiles[*index].bounds, demand.border));
        if !near(&0) || !is_there(0) {
            return (Vec::new(), Vec::new());
        }
        let (mut drawn, mut used) = (Vec::new(), self.tiles[0].gaussians);
        let mut visited = vec![0];
        let mut open = BinaryHeap::from([self.candidate(demand, 0)]);
        while let Some((.., Reverse(index))) = open.pop() {
            let tile = &self.tiles[index];
            let finer: Vec<usize> = tile.children.iter().copied().filter(near).collect();
            let more = finer.iter().map(|&child| self.tiles[child].gaussians).sum::<usize>();
            let after = used - tile.gaussians + more;
            let all_there = finer.iter().all(|&child| is_there(child));
            if tile.children.is_empty() || after > demand.budget || !all_there {
                drawn.push(index);
                continue;
            }
            used = after;
            visited.extend(&finer);
            open.extend(finer.into_iter().map(|index| self.candidate(demand, index)));
        }
        drawn.sort_unstable();
        (drawn, visited)
    }

    /// Path of a tile's file; `None` for an index out of range.
    pub fn path(&self, tile: usize) -> Option<PathBuf> {
        self.tiles.get(tile).map(|tile| self.folder.join(&tile.name))
    }

    /// Reads a tile.
    pub fn read(&self, tile: usize, options: &ReadOptions) -> Result<Scene> {
        let (Some(path), Some(tile)) = (self.path(tile), self.tiles.get(tile)) else {
            return Err(Error::argument("tile", format!("{tile} is none of {}", self.tiles.len())));
        };
        let mut scene = splats::read(&path, options)?;
        let found = scene.header.count;
        if found != tile.gaussians as u64 {
            let problem = format!("has {found} Gaussians, {TILESET_FILE} says {}", tile.gaussians);
            return Err(Error::input(path, problem, WRITE_AGAIN));
        }
        let from = WorldFrame { origin: self.file_origin + scene.frame.origin, ..scene.frame };
        scene.gaussians.transform(&Similarity::between(&from, &self.frame));
        scene.frame = self.frame;
        Ok(scene)
    }

    /// Urgency of a tile's refinement: tiles in a picture come first, then larger errors, then smaller indices. Errors are
    /// not negative, so their bits have their order.
    fn candidate(&self, demand: &Demand<'_>, index: usize) -> (bool, u64, Reverse<usize>) {
        let bounds = self.tiles[index].bounds;
        let seen = |camera: &&Camera| demand.border == 0.0 || sees(camera, bounds, 0.0);
        let largest = |cameras: &mut dyn Iterator<Item = &Camera>| {
            cameras.map(|camera| self.pixels(camera, index).to_bits()).max()
        };
        let in_picture = largest(&mut demand.cameras.iter().filter(seen));
        let pixels = in_picture.or_else(|| largest(&mut demand.cameras.iter())).unwrap_or(0);
        (in_picture.is_some(), pixels, Reverse(index))
    }

    /// Error of a tile in pixels, at its nearest point.
    fn pixels(&self, camera: &Camera, index: usize) -> f64 {
        let Tile { bounds, error, .. } = &self.tiles[index];
        let eye = camera.position();
        let distance = eye.distance(eye.clamp(bounds.min, bounds.max)).max(NEAR_PLANE);
        error * f64::from(camera.fx.max(camera.fy)) / camera.distance_of(distance.into())
    }
}

/// Criteria for the choice of tiles.
#[derive(Clone, Copy, Debug)]
pub struct Demand<'a> {
    /// Cameras of the pictures. A tile is chosen if some camera sees it, by its largest error in any picture.
    pub cameras: &'a [Camera],
    /// Largest number of Gaussians in all drawn tiles.
    pub budget: usize,
    /// Width of a border around the picture, in picture sizes. Tiles in the border are drawn too, so that a turning
    /// camera finds them; they are refined after the tiles in the picture. 0 for none.
    pub border: f64,
}

impl<'a> Demand<'a> {
    /// Demand for the picture of one camera.
    pub fn of(camera: &'a Camera, budget: usize) -> Self {
        Self { cameras: std::slice::from_ref(camera), budget, border: 0.0 }
    }
}

/// True if part of a box may lie in a picture or in its border, in picture sizes. Never false if it does.
fn sees(camera: &Camera, bounds: Bounds, border: f64) -> bool {
    if camera.has_lens() {
        // The sides of its view are no planes.
        return true;
    }
    let corners = (0..8).map(|corner: u32| {
        let side = |axis: u32| if corner >> axis & 1 == 0 { bounds.min } else { bounds.max };
        let place = vec3(side(0).x, side(1).y, side(2).z);
        (camera.camera_from_world * place + camera.translation).as_dvec3()
    });
    let corners: Vec<DVec3> = corners.collect();
    let [fx, fy, cx, cy] = [camera.fx, camera.fy, camera.cx, camera.cy].map(f64::from);
    let (width, height) = (f64::from(camera.width), f64::from(camera.height));
    let [across, down] = [width, height].map(|side| MARGIN + border * side);
    // Factor of the pixel coordinates.
    let depth = |p: &DVec3| camera.distance_of(p.z);
    // Functions that are positive inside each side of the view's pyramid or block.
    let inside: [&dyn Fn(&DVec3) -> f64; 5] = [
        &|p| p.z - f64::from(NEAR_PLANE),
        &|p| fx * p.x + (cx + across) * depth(p),
        &|p| (width - cx + across) * depth(p) - fx * p.x,
        &|p| fy * p.y + (cy + down) * depth(p),
        &|p| (height - cy + down) * depth(p) - fy * p.y,
    ];
    inside.iter().all(|inside| corners.iter().any(|corner| inside(corner) >= 0.0))
}

/// Origin of all tiles by the root's transform.
fn moved(path: &Path, transform: Option<[f64; 16]>) -> Result<DVec3> {
    let Some(columns) = transform else { return Ok(DVec3::ZERO) };
    let matrix = DMat4::from_cols_array(&columns);
    let origin = turned(matrix.w_axis.truncate());
    if matrix == DMat4::from_translation(matrix.w_axis.truncate()) && origin.abs().max_element() <= FARTHEST {
        return Ok(origin);
    }
    let problem = "the root's transform does more than move the tiles, which is not read";
    Err(Error::input(path, problem, WRITE_AGAIN))
}

fn checked(path: &Path, json: &TileJson) -> Result<Tile> {
    let wrong = |problem: String| Error::input(path, format!("{}: {problem}", json.content.uri), WRITE_AGAIN);
    let name = &json.content.uri;
    let plain = |byte: u8| byte.is_ascii_alphanumeric() || b"._-".contains(&byte);
    if name.is_empty() || name.starts_with('.') || !name.bytes().all(plain) {
        return Err(wrong("a tile's file must lie beside it".into()));
    }
    if !(json.geometric_error >= 0.0 && json.geometric_error.is_finite()) {
        return Err(wrong(format!("the error is {}", json.geometric_error)));
    }
    if json.transform.is_some() || json.refine != REPLACE {
        return Err(wrong("tiles that are moved, or that add to those above them, are not read".into()));
    }
    let [x, y, z, half_x, b, c, d, half_y, e, f, g, half_z] = json.bounding_volume.r#box;
    if [b, c, d, e, f, g] != [0.0; 6] {
        return Err(wrong("its box is turned, which is not read".into()));
    }
    let (centre, half) = (DVec3::new(x, y, z), DVec3::new(half_x, half_y, half_z));
    let [a, b] = [centre - half, centre + half].map(|corner| turned(corner).as_vec3());
    if !(a.is_finite() && b.is_finite() && half.min_element() >= 0.0) {
        return Err(wrong("the box is not finite".into()));
    }
    let bounds = Bounds { min: a.min(b), max: a.max(b) };
    let gaussians = json.extras.gaussians as usize;
    Ok(Tile { name: name.clone(), bounds, error: json.geometric_error, gaussians, children: Vec::new() })
}
