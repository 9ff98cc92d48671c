//! Scenes as trees of tiles.

use std::cell::Cell;
use std::fs;
use std::path::{Path, PathBuf};

use ashsplat::scene::Gaussians;
use ashsplat::{Error, Result};
use ashsplat_files::Progress;
use ashsplat_files::splats::{self, ReadOptions, WriteOptions};
use ashsplat_files::tiles::{self, TileOptions, Tiling};
use serde_json::Value;

use crate::common::splats::scene;

const KEEP: ReadOptions = ReadOptions { drop_invalid: false, max_host_memory: None };

/// A scene's file, and where its tiles go.
struct Place {
    own: tempfile::TempDir,
    scene: Gaussians,
}

impl Place {
    fn new(scene: Gaussians) -> Place {
        let own = tempfile::tempdir().unwrap();
        splats::write(own.path().join("scene.ply"), &scene, &WriteOptions::default()).unwrap();
        Place { own, scene }
    }

    fn folder(&self, name: &str) -> PathBuf {
        self.own.path().join(name)
    }

    /// Each merge differs by 2 units, and is told.
    fn tiled(&self, name: &str, most: usize, told: &mut Vec<(usize, usize)>) -> Result<Tiling> {
        let mut measure = |finer: &Gaussians, merged: &Gaussians| {
            told.push((finer.len(), merged.len()));
            Ok(2.0)
        };
        let (input, options) = (self.folder("scene.ply"), TileOptions { most, packed: false });
        tiles::write(&input, &self.folder(name), &options, &KEEP, &mut measure, &Progress::default())
    }

    /// The names in it.
    fn names(&self) -> Vec<String> {
        let entries = fs::read_dir(self.own.path()).unwrap();
        let mut names: Vec<String> =
            entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }
}

fn tileset(folder: &Path) -> Value {
    serde_json::from_slice(&fs::read(folder.join("tileset.json")).unwrap()).unwrap()
}

/// Smallest and largest corner, z up.
fn corners(tile: &Value) -> [[f64; 3]; 2] {
    let numbers: Vec<f64> =
        tile["boundingVolume"]["box"].as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect();
    let side = |sign: f64| [0, 1, 2].map(|axis| numbers[axis] + sign * numbers[3 + 4 * axis]);
    [side(-1.0), side(1.0)]
}

fn children(tile: &Value) -> &[Value] {
    tile["children"].as_array().map_or(&[], Vec::as_slice)
}

/// What the tiles of a tree hold, and whether each is what it says.
fn leaves_of(tile: &Value, folder: &Path, most: usize, found: &mut Vec<Gaussians>) -> usize {
    let own = splats::read(folder.join(tile["content"]["uri"].as_str().unwrap()), &KEEP).unwrap().gaussians;
    assert!((1..=most).contains(&own.len()), "{} of {most}", own.len());
    assert_eq!(tile["extras"]["gaussians"].as_u64(), Some(own.len() as u64));
    assert_eq!(tile["refine"], "REPLACE");
    let [min, max] = corners(tile);
    for mean in &own.means {
        // From right, down, forward to z up, as a viewer turns y-up glTF: (x, y, z) to (x, -z, y).
        let gltf = [-mean[0], -mean[1], mean[2]].map(f64::from);
        let turned = [gltf[0], -gltf[2], gltf[1]];
        let inside = (0..3).all(|axis| (min[axis]..=max[axis]).contains(&turned[axis]));
        assert!(inside, "{turned:?} is not in {min:?} to {max:?}");
    }
    let error = |tile: &Value| tile["geometricError"].as_f64().unwrap();
    let squares: f64 = children(tile).iter().map(|child| error(child).powi(2)).sum();
    let expected = if children(tile).is_empty() { 0.0 } else { (squares + 4.0).sqrt() };
    assert!((error(tile) - expected).abs() < 1e-9, "{} where {expected} was due", error(tile));
    for child in children(tile) {
        let [low, high] = corners(child);
        // Centres and halves are rounded.
        let inside = (0..3).all(|axis| min[axis] <= low[axis] + 1e-4 && high[axis] <= max[axis] + 1e-4);
        assert!(inside, "{low:?} to {high:?} is not in {min:?} to {max:?}");
    }
    if children(tile).is_empty() {
        found.push(own);
        return 1;
    }
    1 + children(tile).iter().map(|child| leaves_of(child, folder, most, found)).sum::<usize>()
}

/// Comparable Gaussians: what glTF keeps to the bit.
fn rows<'a>(scenes: impl IntoIterator<Item = &'a Gaussians>) -> Vec<Vec<u32>> {
    let row = |scene: &Gaussians, index: usize| {
        let floats = [&scene.means[index][..], scene.sh_of(index).as_flattened()].concat();
        floats.iter().map(|value| value.to_bits()).collect::<Vec<u32>>()
    };
    let mut all: Vec<Vec<u32>> =
        scenes.into_iter().flat_map(|scene| (0..scene.len()).map(|index| row(scene, index))).collect();
    all.sort_unstable();
    all
}

#[test]
fn the_finest_tiles_hold_each_gaussian_once() {
    let place = Place::new(scene(3000, 2));
    let mut told = Vec::new();
    let done = place.tiled("tiles", 100, &mut told).unwrap();
    let (folder, mut found) = (place.folder("tiles"), Vec::new());
    let document = tileset(&folder);
    let tiles = leaves_of(&document["root"], &folder, 100, &mut found);
    assert_eq!(rows(&found), rows([&place.scene]));
    assert!(found.iter().all(|tile| tile.sh_degree == 2));
    assert_eq!((done.gaussians, done.tiles, done.leaves), (3000, tiles, found.len()));
    assert!(done.leaves >= 30 && done.levels >= 3, "{done:?}");
    // Each tile above was compared with those below it, of which it has a quarter.
    assert_eq!(told.len(), done.tiles - done.leaves);
    assert!(told.iter().all(|&(finer, merged)| merged == (finer / 4).min(100)), "{told:?}");
    let merged: usize = told.iter().map(|&(_, merged)| merged).sum();
    assert_eq!(done.written, 3000 + merged as u64);
    // Nothing but the tiles and their description.
    assert_eq!(fs::read_dir(&folder).unwrap().count(), tiles + 1);
    assert_eq!(place.names(), ["scene.ply", "tiles"]);
    let nothing = document["geometricError"].as_f64().unwrap();
    assert!(nothing >= document["root"]["geometricError"].as_f64().unwrap());
    assert_eq!(document["asset"]["version"], "1.1");
}

#[test]
fn the_same_scene_gives_the_same_bytes() {
    let place = Place::new(scene(900, 1));
    fs::create_dir(place.folder("b")).unwrap();
    for name in ["a", "b"] {
        place.tiled(name, 64, &mut Vec::new()).unwrap();
    }
    let read = |name: &str| {
        let entries = fs::read_dir(place.folder(name)).unwrap().map(|entry| entry.unwrap());
        let mut files: Vec<_> =
            entries.map(|file| (file.file_name(), fs::read(file.path()).unwrap())).collect();
        files.sort();
        files
    };
    assert!(read("a") == read("b") && read("a").len() > 15);
}

#[test]
fn a_scene_that_fits_is_one_tile() {
    let place = Place::new(scene(50, 0));
    let done = place.tiled("tiles", 50, &mut Vec::new()).unwrap();
    assert_eq!((done.tiles, done.leaves, done.levels, done.written), (1, 1, 1, 50));
    let root = &tileset(&place.folder("tiles"))["root"];
    assert!(children(root).is_empty() && root["geometricError"] == 0.0);
}

#[test]
fn tiles_that_fail_leave_nothing() {
    let place = Place::new(scene(900, 0));
    let (input, folder) = (place.folder("scene.ply"), place.folder("tiles"));
    let calls = Cell::new(0);
    let mut fails_late = |_: &Gaussians, _: &Gaussians| {
        calls.set(calls.get() + 1);
        if calls.get() < 3 { Ok(1.0) } else { Err(Error::argument("picture", "is lost")) }
    };
    let options = TileOptions { most: 64, packed: false };
    let failed =
        tiles::write(&input, &folder, &options, &KEEP, &mut fails_late, &Progress::default()).unwrap_err();
    assert!(failed.to_string().contains("is lost"), "{failed}");
    let stop = std::sync::atomic::AtomicBool::new(true);
    let progress = Progress { report: None, interrupted: Some(&stop) };
    let mut measure = |_: &Gaussians, _: &Gaussians| Ok(1.0);
    let stopped = tiles::write(&input, &folder, &options, &KEEP, &mut measure, &progress).unwrap_err();
    assert!(matches!(stopped, Error::Interrupted), "{stopped}");
    // More at one place than a tile holds.
    let mut heap = scene(70, 0);
    heap.means.fill([1.0, 2.0, 3.0]);
    splats::write(&input, &heap, &WriteOptions::default()).unwrap();
    let refused = place.tiled("tiles", 64, &mut Vec::new()).unwrap_err();
    assert!(matches!(refused, Error::Argument { .. }), "{refused}");
    assert_eq!(place.names(), ["scene.ply"]);
    // A folder with something in it stays as it is.
    fs::create_dir(&folder).unwrap();
    fs::write(folder.join("note"), "mine").unwrap();
    let refused = place.tiled("tiles", 64, &mut Vec::new()).unwrap_err();
    assert!(refused.to_string().contains("is there already"), "{refused}");
    assert_eq!(fs::read_to_string(folder.join("note")).unwrap(), "mine");
    assert_eq!(place.names(), ["scene.ply", "tiles"]);
}
