//! Scenes as trees of tiles.

use super::files::{Folder, assert_says, names, refusal};
use crate::common::splats::scene;
use ashsplat::scene::{Camera, Gaussians, Intrinsics, Projection, Similarity, WorldFrame};
use ashsplat::{Error, Result};
use ashsplat_files::Progress;
use ashsplat_files::splats::{self, ReadOptions, WriteOptions};
use ashsplat_files::tiles::{self, Demand, TILESET_FILE, TileOptions, Tiling, Tree};
use glam::{DVec3, Quat, Vec3, vec3};
use serde_json::Value;
use std::cell::Cell;
use std::fs;
use std::path::{Path, PathBuf};

const KEEP: ReadOptions = ReadOptions { drop_invalid: false, max_host_memory: None };

/// A scene's file, and a folder for its tiles.
struct TestFolder {
    own: Folder,
    scene: Gaussians,
}

impl TestFolder {
    fn new(scene: Gaussians) -> TestFolder {
        let own = Folder::new();
        splats::write(own.join("scene.ply"), &scene, &WriteOptions::default()).unwrap();
        TestFolder { own, scene }
    }

    fn folder(&self, name: &str) -> PathBuf {
        self.own.join(name)
    }

    /// Each merge has an error of 2 units and is recorded in `told`.
    fn tiled(&self, name: &str, max_gaussians: usize, told: &mut Vec<(usize, usize)>) -> Result<Tiling> {
        let mut measure = |finer: &Gaussians, merged: &Gaussians| {
            told.push((finer.len(), merged.len()));
            Ok(2.0)
        };
        let (input, options) = (self.folder("scene.ply"), TileOptions { max_gaussians, packed: false });
        tiles::write(&input, &self.folder(name), &options, &KEEP, &mut measure, &Progress::default())
    }
}

fn tree(scene: Gaussians, max_gaussians: usize) -> (TestFolder, Tree) {
    let place = TestFolder::new(scene);
    place.tiled("tiles", max_gaussians, &mut Vec::new()).unwrap();
    let tree = Tree::open(place.folder("tiles")).unwrap();
    (place, tree)
}

fn count(tree: &Tree, tiles: &[usize]) -> usize {
    tiles.iter().map(|&tile| tree.tiles()[tile].gaussians).sum()
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

fn leaves_of(tile: &Value, folder: &Path, max_gaussians: usize, found: &mut Vec<Gaussians>) -> usize {
    let own = splats::read(folder.join(tile["content"]["uri"].as_str().unwrap()), &KEEP).unwrap().gaussians;
    assert!((1..=max_gaussians).contains(&own.len()), "{} of {max_gaussians}", own.len());
    assert_eq!(tile["extras"]["gaussians"].as_u64(), Some(own.len() as u64));
    assert_eq!(tile["refine"], "REPLACE");
    let [min, max] = corners(tile);
    for index in 0..own.len() {
        let [w, x, y, z] = own.quats[index];
        let (mean, turn) = (Vec3::from_array(own.means[index]), Quat::from_xyzw(x, y, z, w).normalize());
        // Ends of the visible extent of an opaque Gaussian, along its own axes.
        let ends = (0..3).flat_map(|axis| {
            let end = 3.3 * own.log_scales[index][axis].exp() * (turn * Vec3::AXES[axis]);
            [mean - end, mean + end]
        });
        for place in ends {
            // From right, down, forward to z up, as a viewer turns y-up glTF: (x, y, z) to (x, -z, y).
            let gltf = [-place[0], -place[1], place[2]].map(f64::from);
            let turned = [gltf[0], -gltf[2], gltf[1]];
            let inside = (0..3).all(|axis| (min[axis]..=max[axis]).contains(&turned[axis]));
            assert!(inside, "{turned:?} is not in {min:?} to {max:?}");
        }
    }
    let error = |tile: &Value| tile["geometricError"].as_f64().unwrap();
    let squares: f64 = children(tile).iter().map(|child| error(child).powi(2)).sum();
    let expected = if children(tile).is_empty() { 0.0 } else { (squares + 4.0).sqrt() };
    assert!((error(tile) - expected).abs() < 1e-9, "{} where {expected} was due", error(tile));
    for child in children(tile) {
        let [low, high] = corners(child);
        let inside = (0..3).all(|axis| min[axis] <= low[axis] + 1e-9 && high[axis] <= max[axis] + 1e-9);
        assert!(inside, "{low:?} to {high:?} is not in {min:?} to {max:?}");
    }
    if children(tile).is_empty() {
        found.push(own);
        return 1;
    }
    1 + children(tile).iter().map(|child| leaves_of(child, folder, max_gaussians, found)).sum::<usize>()
}

/// The values of Gaussians that glTF keeps to the bit.
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
    let place = TestFolder::new(scene(3000, 2));
    let mut told = Vec::new();
    let done = place.tiled("tiles", 100, &mut told).unwrap();
    let (folder, mut found) = (place.folder("tiles"), Vec::new());
    let document = tileset(&folder);
    let tiles = leaves_of(&document["root"], &folder, 100, &mut found);
    assert_eq!(rows(&found), rows([&place.scene]));
    assert!(found.iter().all(|tile| tile.sh_degree == 2));
    assert_eq!((done.gaussians, done.tiles, done.leaves), (3000, tiles, found.len()));
    assert!(done.leaves >= 30 && done.levels >= 3, "{done:?}");
    // Each inner tile was compared with its children, and has a quarter of their Gaussians.
    assert_eq!(told.len(), done.tiles - done.leaves);
    assert!(told.iter().all(|&(finer, merged)| merged == (finer / 4).min(100)), "{told:?}");
    let merged: usize = told.iter().map(|&(_, merged)| merged).sum();
    assert_eq!(done.written, 3000 + merged as u64);
    // Only the tiles and their description.
    assert_eq!(fs::read_dir(&folder).unwrap().count(), tiles + 1);
    assert_eq!(names(&place.own), ["scene.ply", "tiles"]);
    let nothing = document["geometricError"].as_f64().unwrap();
    assert!(nothing >= document["root"]["geometricError"].as_f64().unwrap());
    assert_eq!(document["asset"]["version"], "1.1");
}

#[test]
fn the_same_scene_gives_the_same_bytes() {
    let place = TestFolder::new(scene(900, 1));
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
    let place = TestFolder::new(scene(50, 0));
    let done = place.tiled("tiles", 50, &mut Vec::new()).unwrap();
    assert_eq!((done.tiles, done.leaves, done.levels, done.written), (1, 1, 1, 50));
    let root = &tileset(&place.folder("tiles"))["root"];
    assert!(children(root).is_empty() && root["geometricError"] == 0.0);
}

#[test]
fn tiles_that_fail_leave_nothing() {
    let place = TestFolder::new(scene(900, 0));
    let (input, folder) = (place.folder("scene.ply"), place.folder("tiles"));
    let calls = Cell::new(0);
    let mut fails_late = |_: &Gaussians, _: &Gaussians| {
        calls.set(calls.get() + 1);
        if calls.get() < 3 { Ok(1.0) } else { Err(Error::argument("picture", "is lost")) }
    };
    let options = TileOptions { max_gaussians: 64, packed: false };
    let failed =
        tiles::write(&input, &folder, &options, &KEEP, &mut fails_late, &Progress::default()).unwrap_err();
    assert_says(failed.to_string(), &["is lost"]);
    let stop = std::sync::atomic::AtomicBool::new(true);
    let progress = Progress { report: None, interrupted: Some(&stop) };
    let mut measure = |_: &Gaussians, _: &Gaussians| Ok(1.0);
    let stopped = tiles::write(&input, &folder, &options, &KEEP, &mut measure, &progress).unwrap_err();
    assert!(matches!(stopped, Error::Interrupted), "{stopped}");
    // More Gaussians at one position than a tile holds.
    let mut heap = scene(70, 0);
    heap.means.fill([1.0, 2.0, 3.0]);
    splats::write(&input, &heap, &WriteOptions::default()).unwrap();
    let refused = place.tiled("tiles", 64, &mut Vec::new()).unwrap_err();
    assert_says(refused.to_string(), &["scene.ply", "70 Gaussians are at", "--max-gaussians"]);
    // Farther away than SPZ can store.
    let mut far = scene(70, 0);
    far.means[3] = [1e15, 0.0, 0.0];
    splats::write(&input, &far, &WriteOptions::default()).unwrap();
    let packed = TileOptions { max_gaussians: 64, packed: true };
    let refused = tiles::write(&input, &folder, &packed, &KEEP, &mut measure, &Progress::NONE);
    assert_says(refusal(&input, refused), &["too far out for SPZ"]);
    // Coarse, with a warning.
    far.means[3] = [6e6, 0.0, 0.0];
    splats::write(&input, &far, &WriteOptions::default()).unwrap();
    let coarse = place.folder("coarse");
    let done = tiles::write(&input, &coarse, &packed, &KEEP, &mut measure, &Progress::NONE).unwrap();
    assert!(done.warnings.len() == 1 && done.warnings[0].contains("rounded to steps of 1.0"), "{done:?}");
    fs::remove_dir_all(coarse).unwrap();
    assert_eq!(names(&place.own), ["scene.ply"]);
    // A folder with contents stays unchanged.
    fs::create_dir(&folder).unwrap();
    fs::write(folder.join("note"), "mine").unwrap();
    let refused = place.tiled("tiles", 64, &mut Vec::new()).unwrap_err();
    assert_says(refused.to_string(), &["is there already"]);
    assert_eq!(fs::read_to_string(folder.join("note")).unwrap(), "mine");
    assert_eq!(names(&place.own), ["scene.ply", "tiles"]);
}

/// A camera outside with the whole scene of 20 units in its picture.
fn from_outside() -> Camera {
    let intrinsics = Intrinsics::from_fov_x(1.0, 400, 300);
    Camera::look_at(vec3(4.0, -9.0, -60.0), Vec3::ZERO, Vec3::NEG_Y, intrinsics)
}

/// Fails unless every leaf in the picture is drawn exactly once, by itself or by a tile above it.
fn assert_covered(tree: &Tree, cut: &[usize]) {
    let tiles = tree.tiles();
    let mut times = vec![0; tiles.len()];
    for &tile in cut {
        let mut open = vec![tile];
        while let Some(index) = open.pop() {
            times[index] += 1;
            open.extend(&tiles[index].children);
        }
    }
    for (tile, times) in tiles.iter().zip(times).filter(|(tile, _)| tile.children.is_empty()) {
        assert_eq!(times, 1, "{}", tile.name);
    }
}

#[test]
fn a_cut_of_the_tree_is_as_fine_as_its_budget() {
    let (place, tree) = tree(scene(3000, 0), 100);
    assert_eq!(tree.gaussians(), 3000);
    let camera = from_outside();
    let count = |cut: &[usize]| count(&tree, cut);
    assert_eq!(tree.cut(&camera, 0), [0]);
    let mut last = 0;
    for budget in [100, 300, 1000, 2000, 3000] {
        let cut = tree.cut(&camera, budget);
        assert_covered(&tree, &cut);
        assert!((last..=budget).contains(&count(&cut)), "{} of {budget}", count(&cut));
        // A tile's children have at most four times its Gaussians.
        assert!(4 * count(&cut) >= budget, "{} of {budget}", count(&cut));
        last = count(&cut);
    }
    assert_eq!(last, 3000);
    let all = tree.cut(&camera, usize::MAX);
    assert!(all.iter().all(|&tile| tree.tiles()[tile].children.is_empty()));
    let read: Vec<Gaussians> = all.iter().map(|&tile| tree.read(tile, &KEEP).unwrap().gaussians).collect();
    assert_eq!(rows(&read), rows([&place.scene]));
    assert!(tree.read(tree.tiles().len(), &KEEP).is_err());
    let mut wanted = tree.wanted(&Demand::of(&camera, usize::MAX));
    for (place, &tile) in wanted.iter().enumerate() {
        assert!(tree.tiles()[tile].children.iter().all(|child| !wanted[..place].contains(child)));
    }
    // All tiles are about equally far away, so they are wanted level by level, not one corner down to its leaves.
    let half =
        wanted[..wanted.len() / 2].iter().filter(|&&tile| tree.tiles()[tile].children.is_empty()).count();
    assert!(half < all.len() / 2, "{half} of {}", all.len());
    wanted.sort_unstable();
    assert_eq!(wanted, (0..tree.tiles().len()).collect::<Vec<_>>());
    // Tiles loaded in this order are drawn at some point, each after its parent.
    let wanted = tree.wanted(&Demand::of(&camera, 700));
    for loaded in 1..=wanted.len() {
        let cut = tree.cut_among(&Demand::of(&camera, 700), |tile| wanted[..loaded].contains(&tile));
        assert_covered(&tree, &cut);
        assert!(loaded < wanted.len() || cut == tree.cut(&camera, 700));
    }
    // Missing tiles are replaced by those above them.
    for there in 0..tree.tiles().len() {
        let cut = tree.cut_among(&Demand::of(&camera, usize::MAX), |tile| tile <= there);
        assert_covered(&tree, &cut);
        assert!(cut.iter().all(|&tile| tile <= there));
    }
    assert!(tree.cut_among(&Demand::of(&camera, 3000), |_| false).is_empty());
}

/// With both kinds of cameras, near tiles are finer, and tiles out of view are not drawn.
#[test]
fn a_cut_is_finer_where_it_is_nearer_and_leaves_out_what_is_not_seen() {
    let (_place, tree) = tree(scene(3000, 0), 50);
    let intrinsics = Intrinsics::from_fov_x(1.0, 400, 300);
    let near = Camera::look_at(vec3(0.0, 0.0, -13.0), Vec3::ZERO, Vec3::NEG_Y, intrinsics);
    let drawn: Vec<_> = tree.cut(&near, 1200).into_iter().map(|tile| &tree.tiles()[tile]).collect();
    let depth = |finest: bool| {
        let own = drawn.iter().filter(|tile| tile.children.is_empty() == finest);
        let middles: Vec<f32> = own.map(|tile| 0.5 * (tile.bounds.min.z + tile.bounds.max.z)).collect();
        assert!(middles.len() > 2, "{finest}: {middles:?}");
        middles.iter().sum::<f32>() / middles.len() as f32
    };
    assert!(depth(true) + 2.0 < depth(false), "{} {}", depth(true), depth(false));
    let away = Camera::look_at(vec3(0.0, 0.0, -60.0), vec3(0.0, 0.0, -100.0), Vec3::NEG_Y, intrinsics);
    assert!(tree.cut(&away, 3000).is_empty());
    // Parallel rays around x = 6, one unit wide: exactly the leaves that reach there are drawn.
    let wide = Intrinsics { fx: 400.0, fy: 10.0, cx: 200.0, cy: 150.0, width: 400, height: 300 };
    let slice = Camera::look_at(vec3(6.0, 0.0, -60.0), vec3(6.0, 0.0, 0.0), Vec3::NEG_Y, wide);
    let slice = Camera { projection: Projection::Orthographic, ..slice };
    let drawn = tree.cut(&slice, 3000);
    let reaches = |index: &usize| {
        let bounds = tree.tiles()[*index].bounds;
        bounds.min.x < 6.5 && bounds.max.x > 5.5 && bounds.max.y > -15.0 && bounds.min.y < 15.0
    };
    let finest: Vec<usize> =
        (0..tree.tiles().len()).filter(|&tile| tree.tiles()[tile].children.is_empty()).collect();
    let expected: Vec<usize> = finest.iter().copied().filter(reaches).collect();
    assert!((4..3 * finest.len() / 4).contains(&expected.len()), "{} of {}", expected.len(), finest.len());
    assert_eq!(drawn, expected);
}

#[test]
fn trees_of_others_are_refused() {
    let place = TestFolder::new(scene(200, 0));
    place.tiled("tiles", 50, &mut Vec::new()).unwrap();
    let (folder, good) = (place.folder("tiles"), tileset(&place.folder("tiles")));
    let refused = |change: &dyn Fn(&mut Value), word: &str| {
        let mut document = good.clone();
        change(&mut document);
        fs::write(folder.join(TILESET_FILE), document.to_string()).unwrap();
        let error = Tree::open(&folder).expect_err(word).to_string();
        assert_says(&error, &[TILESET_FILE, word]);
    };
    refused(&|d| d["root"]["content"]["uri"] = "../0.glb".into(), "must lie beside it");
    refused(&|d| d["root"]["content"]["uri"] = "..".into(), "must lie beside it");
    refused(&|d| d["root"]["geometricError"] = (-1.0).into(), "the error is -1");
    refused(&|d| d["root"]["boundingVolume"] = serde_json::json!({ "sphere": [0, 0, 0, 1] }), "box");
    refused(&|d| d["root"]["boundingVolume"]["box"][3] = (-1.0).into(), "not finite");
    refused(&|d| d["root"]["children"][1]["extras"] = Value::Null, "no tree of Gaussians");
    refused(&|d| *d = Value::Null, "no tree of Gaussians");
    refused(
        &|d| d["root"]["transform"] = serde_json::json!([2, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]),
        "more than move",
    );
    refused(&|d| d["root"]["children"][0]["refine"] = "ADD".into(), "add to those above");
    refused(&|d| d["root"]["boundingVolume"]["box"][4] = 0.5.into(), "turned");
    refused(&|d| d["root"]["children"][1] = d["root"]["children"][0].clone(), "twice");
    // A number that differs from the file's.
    let mut document = good.clone();
    document["root"]["extras"]["gaussians"] = 7.into();
    fs::write(folder.join(TILESET_FILE), document.to_string()).unwrap();
    assert_says(Tree::open(&folder).unwrap().read(0, &KEEP).unwrap_err().to_string(), &["says 7"]);
}

#[test]
fn enormous_gaussians_have_finite_boxes() {
    let mut large = scene(90, 0);
    large.log_scales.fill([87.0; 3]);
    let place = TestFolder::new(large);
    place.tiled("tiles", 40, &mut Vec::new()).unwrap();
    let text = fs::read_to_string(place.folder("tiles").join(TILESET_FILE)).unwrap();
    assert!(!text.contains("null"), "{text}");
    assert!(Tree::open(place.folder("tiles")).unwrap().tiles()[0].bounds.max.x > 1e34);
}

/// Tiles that either of two cameras sees are drawn. Tiles beyond a picture's sides are drawn, too, but coarser than
/// those inside.
#[test]
fn a_cut_is_for_several_cameras_and_for_what_lies_beyond_their_pictures() {
    let (_place, tree) = tree(scene(3000, 0), 50);
    let intrinsics = Intrinsics::from_fov_x(0.5, 400, 300);
    let towards = |x: f32| Camera::look_at(Vec3::ZERO, vec3(x, 0.0, 10.0), Vec3::NEG_Y, intrinsics);
    let finest = |cut: Vec<usize>| -> Vec<usize> {
        cut.into_iter().filter(|&tile| tree.tiles()[tile].children.is_empty()).collect()
    };
    let own = [-8.0, 8.0].map(|x| tree.cut(&towards(x), usize::MAX));
    let both = Demand { cameras: &[-8.0, 8.0].map(towards), budget: usize::MAX, border: 0.0 };
    let mut either: Vec<usize> = own.concat();
    either.sort_unstable();
    either.dedup();
    assert!(either.len() > own[0].len() && either.len() > own[1].len());
    assert_eq!(tree.cut_among(&both, |_| true), either);
    // A border as wide as the picture: a camera that turns by less finds all tiles there.
    let (camera, turned) = (towards(0.0), towards(3.0));
    let wide = Demand { border: 1.0, ..Demand::of(&camera, usize::MAX) };
    let around = tree.cut_among(&wide, |_| true);
    let narrow = tree.cut(&camera, usize::MAX);
    let new = tree.cut(&turned, usize::MAX);
    assert!(new.iter().any(|tile| !narrow.contains(tile)));
    // A box may be visible without a visible Gaussian: the omitted tiles show none.
    for &tile in new.iter().filter(|tile| !around.contains(tile)) {
        for mean in tree.read(tile, &KEEP).unwrap().gaussians.means {
            let p = turned.camera_from_world * Vec3::from(mean) + turned.translation;
            let [x, y] = [turned.fx * p.x / p.z, turned.fy * p.y / p.z].map(f32::abs);
            assert!(p.z < 0.2 || x > 200.0 || y > 150.0, "{tile}: {p}");
        }
    }
    assert!(new.iter().filter(|tile| around.contains(tile)).count() > new.len() / 2);
    // With a small budget, more of the picture than of its border is finest.
    let count = |cut: &[usize]| count(&tree, cut);
    let budget = (count(&narrow) + count(&around)) / 2;
    let short = tree.cut_among(&Demand { budget, ..wide }, |_| true);
    assert!(count(&short) <= budget);
    let short = finest(short);
    let (inside, beside): (Vec<usize>, Vec<usize>) = around.iter().partition(|tile| narrow.contains(tile));
    let share = |of: &[usize]| of.iter().filter(|tile| short.contains(tile)).count() as f64 / of.len() as f64;
    assert!(share(&inside) > 2.0 * share(&beside), "{} {}", share(&inside), share(&beside));
    assert!(short.len() < around.len());
    assert!(tree.cut_among(&Demand { cameras: &[], ..wide }, |_| true).is_empty());
}

#[test]
fn trees_of_distant_scenes_have_an_origin() {
    let place = TestFolder::new(scene(900, 0));
    let utm = DVec3::new(500_000.0, 4_600_000.0, 100.0);
    let frame = WorldFrame { origin: utm, unit: 1.0 };
    let near = place.tiled("near", 200, &mut Vec::new()).unwrap();
    let options = WriteOptions { frame, ..Default::default() };
    splats::write(place.folder("scene.ply"), &place.scene, &options).unwrap();
    assert_eq!(place.tiled("far", 200, &mut Vec::new()).unwrap(), near);
    let root = &tileset(&place.folder("far"))["root"];
    assert_eq!(root["transform"][12], -500_000.0, "{root}");
    let [near, far] = ["near", "far"].map(|name| Tree::open(place.folder(name)).unwrap());
    assert_eq!((near.frame(), far.frame()), (WorldFrame::default(), frame));
    for (tile, (a, b)) in near.tiles().iter().zip(far.tiles()).enumerate() {
        assert!(a.bounds.min.distance(b.bounds.min) < 1e-3 && a.gaussians == b.gaussians, "{}", a.name);
        let [a, b] = [&near, &far].map(|tree| tree.read(tile, &KEEP).unwrap().gaussians);
        assert!(a.means.iter().zip(&b.means).all(|(a, b)| Vec3::from(*a).distance(Vec3::from(*b)) < 1e-4));
    }
    // A tiny scene is drawn in its own unit.
    let mut tiny = place.scene.clone();
    tiny.transform(&Similarity { scale: 1e-3, ..Default::default() });
    let place = TestFolder::new(tiny);
    place.tiled("tiny", 200, &mut Vec::new()).unwrap();
    let tree = Tree::open(place.folder("tiny")).unwrap().in_world_frame();
    assert!(tree.frame().unit <= 0.01, "{:?}", tree.frame());
    let size = tree.tiles()[0].bounds.size().max_element();
    assert!(size > 2.0 && tree.read(0, &KEEP).unwrap().frame == tree.frame(), "{size}");
}
