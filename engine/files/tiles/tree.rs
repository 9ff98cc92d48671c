//! Selects the tiles for a camera within a budget of Gaussians, in trees that [`super::write`] has written.

use std::cmp::Reverse;
use std::collections::{BTreeSet, BinaryHeap};
use std::path::{Path, PathBuf};

use glam::{DMat4, DVec3, vec3};
use serde::Deserialize;

use super::turned;
use crate::regular_file;
use crate::splats::{self, FARTHEST, ReadOptions, Scene};
use ashsplat::scene::{Bounds, Camera, NEAR_PLANE, Similarity, WorldFrame};
use ashsplat::{Error, Result};

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
    if json.transform.is_some() || json.refine != "REPLACE" {
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
