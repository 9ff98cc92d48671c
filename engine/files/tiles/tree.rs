//! Trees of tiles that [`super::write`] has written: which tiles a camera wants, within a number of Gaussians.

use std::collections::{BTreeSet, BinaryHeap};
use std::path::{Path, PathBuf};

use glam::{DMat4, DVec3, Vec3, vec3};
use serde::Deserialize;

use super::document::{turned, turned_origin};
use crate::regular_file;
use crate::splats::{self, FARTHEST, ReadOptions, Scene};
use ashsplat::scene::{Bounds, Camera, NEAR_PLANE, Projection, Similarity, WorldFrame};
use ashsplat::{Error, Result};

/// Beyond the box of a tile in a picture, pixels: the low-pass filter widens Gaussians.
const MARGIN: f64 = 2.0;

/// The description in the folder.
pub const TILESET_FILE: &str = "tileset.json";

/// A tree of tiles in a folder.
#[derive(Clone, Debug)]
pub struct Tree {
    folder: PathBuf,
    tiles: Vec<Tile>,
    /// Origin of the files' positions.
    file_origin: DVec3,
    /// Where bounds, errors and the Gaussians that are read lie.
    frame: WorldFrame,
}

/// A tile.
#[derive(Clone, Debug, PartialEq)]
pub struct Tile {
    /// Its file's name in the folder.
    pub name: String,
    /// What it and those below it reach, world units, this crate's frame.
    pub bounds: Bounds,
    /// How much its picture differs from that of the finest tiles, world units: see the guide's chapter on tiles.
    pub error: f64,
    /// Its Gaussians.
    pub gaussians: usize,
    /// The tiles that take its place.
    pub children: Vec<usize>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct TileJson {
    refine: String,
    #[serde(default)]
    transform: Option<[f64; 16]>,
    bounding_volume: BoxJson,
    geometric_error: f64,
    content: ContentJson,
    extras: ExtrasJson,
    #[serde(default)]
    children: Vec<TileJson>,
}

/// The file.
#[derive(Deserialize)]
struct TilesetJson {
    root: TileJson,
}

#[derive(Deserialize)]
struct BoxJson {
    r#box: [f64; 12],
}

#[derive(Deserialize)]
struct ContentJson {
    uri: String,
}

#[derive(Deserialize)]
struct ExtrasJson {
    gaussians: u32,
}

impl Tree {
    /// Reads the description of a tree, and no tile yet.
    ///
    /// # Errors
    /// [`Error::Io`]; [`Error::Input`] for a description that [`super::write`] has not written, for files outside of the folder, and
    /// for numbers that make no sense.
    pub fn open(folder: impl AsRef<Path>) -> Result<Tree> {
        let folder = folder.as_ref();
        let path = folder.join(TILESET_FILE);
        let text = regular_file::read_json(&path)?;
        let foreign = |problem: &dyn std::fmt::Display| {
            let problem = format!("is no tree of Gaussians: {problem}");
            Error::input(&path, problem, "give one that `ashsplat tiles` has written, or one .glb of it")
        };
        // A tile within a tile is two levels; the parser ends at 128.
        let TilesetJson { root } = serde_json::from_slice(&text).map_err(|e| foreign(&e))?;
        let (mut tiles, mut names, mut origin) = (Vec::<Tile>::new(), BTreeSet::new(), DVec3::ZERO);
        // Those that are not in the list yet, each with the one above it; the next is the last.
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
                return Err(Error::input(&path, problem, "write the tree again with `ashsplat tiles`"));
            }
            open.extend(json.children.into_iter().rev().map(|child| (Some(index), child)));
        }
        let frame = WorldFrame { origin, unit: 1.0 };
        Ok(Tree { folder: folder.to_owned(), tiles, file_origin: origin, frame })
    }

    /// Where the tiles' coordinates lie within those of the scene's file.
    pub fn frame(&self) -> WorldFrame {
        self.frame
    }

    /// The tree in the frame in which it is drawn, as [`Scene::in_world_frame`].
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

    /// Gaussians of the finest tiles: those of the scene.
    pub fn gaussians(&self) -> usize {
        self.tiles.iter().filter(|tile| tile.children.is_empty()).map(|tile| tile.gaussians).sum()
    }

    /// The tiles to be drawn for a camera, ascending: those in its picture, as fine as so many Gaussians allow, and finest where the error
    /// is largest in pixels. The coarsest tile is drawn however many it has; nothing, where it is not in the picture.
    pub fn cut(&self, camera: &Camera, budget: usize) -> Vec<usize> {
        self.cut_among(&Demand::of(camera, budget), |_| true)
    }

    /// The tiles of a cut and those on the way to them: a tile comes after the one above it, and sooner where the error of that is larger
    /// in pixels. In this order they are to be loaded for [`Tree::cut_among`].
    pub fn wanted(&self, demand: &Demand<'_>) -> Vec<usize> {
        self.wanted_among(demand, |_| true)
    }

    /// Same as [`Tree::wanted`], where some tiles will never be there, because they cannot be read say: nothing is wanted that could
    /// only be drawn beside or below one of them.
    pub fn wanted_among(&self, demand: &Demand<'_>, is_possible: impl Fn(usize) -> bool) -> Vec<usize> {
        self.refined(demand, &is_possible).1
    }

    /// Same as [`Tree::cut`], of the tiles that are there: while one of those that would take a tile's place is not, the tile itself is drawn.
    /// Without the coarsest tile there is nothing.
    pub fn cut_among(&self, demand: &Demand<'_>, is_there: impl Fn(usize) -> bool) -> Vec<usize> {
        self.refined(demand, &is_there).0
    }

    /// The tiles that are drawn, and those and what they have replaced.
    fn refined(&self, demand: &Demand<'_>, is_there: &dyn Fn(usize) -> bool) -> (Vec<usize>, Vec<usize>) {
        let near =
            |index: &usize| demand.cameras.iter().any(|c| sees(c, self.tiles[*index].bounds, demand.border));
        if !near(&0) || !is_there(0) {
            return (Vec::new(), Vec::new());
        }
        let (mut drawn, mut used) = (Vec::new(), self.tiles[0].gaussians);
        let mut visited = vec![0];
        let mut open = BinaryHeap::from([self.candidate(demand, 0)]);
        while let Some(Candidate { index, .. }) = open.pop() {
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

    /// The file of a tile; None for a tile that is not in the tree.
    pub fn path(&self, tile: usize) -> Option<PathBuf> {
        self.tiles.get(tile).map(|tile| self.folder.join(&tile.name))
    }

    /// Reads a tile.
    ///
    /// # Errors
    /// Same as [`splats::read`]; [`Error::Input`] for a file with another number of Gaussians.
    pub fn read(&self, tile: usize, options: &ReadOptions) -> Result<Scene> {
        let (Some(path), Some(tile)) = (self.path(tile), self.tiles.get(tile)) else {
            return Err(Error::argument("tile", format!("{tile} is none of {}", self.tiles.len())));
        };
        let mut scene = splats::read(&path, options)?;
        let found = scene.header.count;
        if found != tile.gaussians as u64 {
            let problem = format!("has {found} Gaussians, {TILESET_FILE} says {}", tile.gaussians);
            return Err(Error::input(path, problem, "write the tree again with `ashsplat tiles`"));
        }
        let from = WorldFrame { origin: self.file_origin + scene.frame.origin, ..scene.frame };
        scene.gaussians.transform(&Similarity::between(&from, &self.frame));
        scene.frame = self.frame;
        Ok(scene)
    }

    /// How urgently a tile is to be refined.
    fn candidate(&self, demand: &Demand<'_>, index: usize) -> Candidate {
        let bounds = self.tiles[index].bounds;
        let seen = |camera: &&Camera| demand.border == 0.0 || sees(camera, bounds, 0.0);
        let largest = |cameras: &mut dyn Iterator<Item = &Camera>| {
            cameras.map(|camera| self.pixels(camera, index)).max_by(f64::total_cmp)
        };
        match largest(&mut demand.cameras.iter().filter(seen)) {
            Some(pixels) => Candidate { seen: true, pixels, index },
            None => {
                Candidate { seen: false, pixels: largest(&mut demand.cameras.iter()).unwrap_or(0.0), index }
            }
        }
    }

    /// The error of a tile in pixels, where it is nearest.
    fn pixels(&self, camera: &Camera, index: usize) -> f64 {
        let Tile { bounds, error, .. } = &self.tiles[index];
        let eye = camera.position();
        let distance = match camera.projection {
            Projection::Perspective => eye.distance(eye.clamp(bounds.min, bounds.max)).max(NEAR_PLANE),
            Projection::Orthographic => 1.0,
        };
        error * f64::from(camera.fx.max(camera.fy)) / f64::from(distance)
    }
}

/// For what tiles are chosen.
#[derive(Clone, Copy, Debug)]
pub struct Demand<'a> {
    /// Tiles are chosen that one of them sees, and by the largest error in any of their pictures.
    pub cameras: &'a [Camera],
    /// Gaussians of all tiles that are drawn, at most.
    pub budget: usize,
    /// What lies beyond a picture by less than so many of its widths and heights is drawn too, so that a camera that turns finds it
    /// there. It is refined after what lies in the picture. 0 draws the pictures alone.
    pub border: f64,
}

impl<'a> Demand<'a> {
    /// The picture of one camera.
    pub fn of(camera: &'a Camera, budget: usize) -> Self {
        Self { cameras: std::slice::from_ref(camera), budget, border: 0.0 }
    }
}

/// Tiles to be refined: those in a picture first, of these the worst, of equal ones the first.
struct Candidate {
    seen: bool,
    pixels: f64,
    index: usize,
}

impl Ord for Candidate {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        let pixels = self.pixels.total_cmp(&other.pixels);
        self.seen.cmp(&other.seen).then(pixels).then(other.index.cmp(&self.index))
    }
}

impl PartialOrd for Candidate {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Candidate {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other).is_eq()
    }
}

impl Eq for Candidate {}

/// Whether a part of a box can be in a picture, or beyond it by less than so many of its widths and heights: never false where one is.
fn sees(camera: &Camera, bounds: Bounds, border: f64) -> bool {
    let corners = (0..8).map(|corner: u32| {
        let side = |axis: u32| if corner >> axis & 1 == 0 { bounds.min } else { bounds.max };
        let place = vec3(side(0).x, side(1).y, side(2).z);
        (camera.camera_from_world * place + camera.translation).as_dvec3()
    });
    let corners: Vec<DVec3> = corners.collect();
    let [fx, fy, cx, cy] = [camera.fx, camera.fy, camera.cx, camera.cy].map(f64::from);
    let (width, height) = (f64::from(camera.width), f64::from(camera.height));
    let [across, down] = [width, height].map(|side| MARGIN + border * side);
    // By what pixels are multiplied.
    let depth = |p: &DVec3| match camera.projection {
        Projection::Perspective => p.z,
        Projection::Orthographic => 1.0,
    };
    // What is positive inside of each side of the pyramid or block.
    let inside: [&dyn Fn(&DVec3) -> f64; 5] = [
        &|p| p.z - f64::from(NEAR_PLANE),
        &|p| fx * p.x + (cx + across) * depth(p),
        &|p| (width - cx + across) * depth(p) - fx * p.x,
        &|p| fy * p.y + (cy + down) * depth(p),
        &|p| (height - cy + down) * depth(p) - fy * p.y,
    ];
    inside.iter().all(|inside| corners.iter().any(|corner| inside(corner) >= 0.0))
}

/// Where the root's transform moves all tiles.
fn moved(path: &Path, transform: Option<[f64; 16]>) -> Result<DVec3> {
    let Some(columns) = transform else { return Ok(DVec3::ZERO) };
    let matrix = DMat4::from_cols_array(&columns);
    let origin = turned_origin(matrix.w_axis.truncate());
    if matrix == DMat4::from_translation(matrix.w_axis.truncate()) && origin.abs().max_element() <= FARTHEST {
        return Ok(origin);
    }
    let problem = "the root's transform does more than move the tiles, which is not read";
    Err(Error::input(path, problem, "write the tree again with `ashsplat tiles`"))
}

fn checked(path: &Path, json: &TileJson) -> Result<Tile> {
    let wrong = |problem: String| {
        Error::input(
            path,
            format!("{}: {problem}", json.content.uri),
            "write the tree again with `ashsplat tiles`",
        )
    };
    let name = &json.content.uri;
    let plain = |byte: u8| byte.is_ascii_alphanumeric() || b"._-".contains(&byte);
    if name.is_empty() || name.starts_with('.') || !name.bytes().all(plain) {
        return Err(wrong("a tile's file must lie beside it".into()));
    }
    if !(json.geometric_error >= 0.0 && json.geometric_error.is_finite()) {
        return Err(wrong(format!("the error is {}", json.geometric_error)));
    }
    if json.transform.is_some() || json.refine != "REPLACE" {
        return Err(wrong("tiles that are moved, or that add to those above them, are not read".into()));
    }
    let [x, y, z, half_x, b, c, d, half_y, e, f, g, half_z] = json.bounding_volume.r#box;
    if [b, c, d, e, f, g] != [0.0; 6] {
        return Err(wrong("its box is turned, which is not read".into()));
    }
    let (centre, half) = (DVec3::new(x, y, z), DVec3::new(half_x, half_y, half_z));
    let [low, high] = [centre - half, centre + half].map(DVec3::as_vec3);
    if !(low.is_finite() && high.is_finite() && half.min_element() >= 0.0) {
        return Err(wrong("the box is not finite".into()));
    }
    let [a, b]: [Vec3; 2] = [low, high].map(turned);
    let bounds = Bounds { min: a.min(b), max: a.max(b) };
    let gaussians = json.extras.gaussians as usize;
    Ok(Tile { name: name.clone(), bounds, error: json.geometric_error, gaussians, children: Vec::new() })
}
