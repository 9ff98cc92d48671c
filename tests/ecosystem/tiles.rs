//! Our trees of tiles in Cesium's 3D Tiles tools and Khronos' glTF validator; splat-transform's streamed SOG.

use super::playcanvas::{ball, camera, render};
use super::{compare, read, text};
use ashsplat::scene::Gaussians;
use ashsplat_files::Progress;
use ashsplat_files::splats::{self, ConvertOptions, Target, WriteOptions};
use ashsplat_files::tiles::{self, TileOptions};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::Command;

pub const TRIALS: [(&str, super::Check); 3] = [
    ("gltf_validator_accepts_our_tiles_ply", |modules, _| {
        each_tree(|tree, packed| the_validator_accepts(modules, tree, packed))
    }),
    ("tiles_tools_read_our_tree_ply", |modules, _| each_tree(|tree, _| the_tools_read(modules, tree))),
    ("splat_transform_writes_streamed_sog", |modules, _| its_streamed_sog_is_read(modules)),
];

/// Runs a check with a tree of plain tiles, and one with SPZ.
fn each_tree(check: impl Fn(&Path, bool)) {
    let folder = tempfile::tempdir().unwrap();
    for packed in [false, true] {
        check(&tree_of_the_ball(folder.path(), packed), packed);
    }
}

pub fn tree_of_the_ball(folder: &Path, packed: bool) -> PathBuf {
    let (scene, tree) = (folder.join("scene.ply"), folder.join(if packed { "packed" } else { "plain" }));
    splats::write(&scene, &ball(), &WriteOptions::default()).unwrap();
    let options = TileOptions { max_gaussians: 1000, packed };
    let mut measure = |_: &Gaussians, _: &Gaussians| Ok(0.05);
    tiles::write(&scene, &tree, &options, &Default::default(), &mut measure, &Progress::NONE).unwrap();
    tree
}

/// A streamed SOG that splat-transform writes is read at its finest level.
fn its_streamed_sog_is_read(modules: &Path) {
    let folder = tempfile::tempdir().unwrap();
    let level = |number: usize| folder.path().join(format!("lod{number}.ply"));
    // Without higher SH degrees, whose codebooks take minutes.
    splats::write(level(0), &ball().with_sh_degree(0), &WriteOptions::default()).unwrap();
    let options = ConvertOptions { decimate: Some(Target::Share(0.25)), ..Default::default() };
    splats::convert(&level(0), &level(1), &options).unwrap();
    let meta = folder.path().join("out/lod-meta.json");
    let [fine, coarse] = [level(0), level(1)];
    super::splat_transform(
        modules,
        &["-g", "cpu", text(&fine), "-l", "0", text(&coarse), "-l", "1", text(&meta)],
    );
    let [ours, theirs] = [&fine, &meta].map(|path| render(&read(path), &camera()));
    let psnr = compare("splat_transform_streamed_sog", &ours, &theirs);
    assert!(psnr > 50.0, "{psnr:.2} dB");
}

fn glbs(folder: &Path) -> Vec<PathBuf> {
    let files = crate::common::files_below(folder).into_iter().map(|file| folder.join(file));
    files.filter(|file| file.extension().is_some_and(|own| own == "glb")).collect()
}

fn the_validator_accepts(modules: &Path, tree: &Path, packed: bool) {
    let tiles = glbs(tree);
    assert!(tiles.len() >= 8, "{tiles:?}");
    super::validate(modules, &tiles, packed);
}

/// Packs the tree into an archive and unpacks it, and links it below another tree, which makes the tools visit every
/// tile. Tree and tiles stay the same.
fn the_tools_read(modules: &Path, tree: &Path) {
    let modules = super::tiles_tools(modules).unwrap();
    let beside =
        |name: &str| tree.with_file_name(format!("{}_{name}", tree.file_name().unwrap().to_str().unwrap()));
    let (archive, back, below, whole) =
        (tree.with_extension("3tz"), beside("back"), beside("below"), beside("whole"));
    run(&modules, &["convert", "-i", text(&tree.join("tileset.json")), "-o", text(&archive)]);
    run(&modules, &["convert", "-i", text(&archive), "-o", text(&back)]);
    run(&modules, &["merge", "-i", text(tree), "-i", text(&back), "-o", text(&below)]);
    run(&modules, &["combine", "-i", text(&below), "-o", text(&whole)]);
    let ours = document(tree);
    assert_eq!(document(&back), ours);
    let all = document(&whole);
    let trees = all["root"]["children"].as_array().unwrap();
    for (read, folder) in trees.iter().zip([tree, &back]) {
        let name = folder.file_name().unwrap().to_str().unwrap();
        assert_eq!(as_said(read, name, &whole), as_said(&ours["root"], "", tree));
    }
    let tiles = glbs(tree);
    assert!(trees.len() == 2 && tiles.len() >= 8, "{tiles:?}");
    for copies in [&back, &whole.join(tree.file_name().unwrap()), &whole.join(back.file_name().unwrap())] {
        assert_eq!(glbs(copies).len(), tiles.len());
        for tile in &tiles {
            let copy = copies.join(tile.strip_prefix(tree).unwrap());
            assert!(std::fs::read(tile).unwrap() == std::fs::read(&copy).unwrap(), "{}", copy.display());
        }
    }
}

pub fn document(folder: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(folder.join("tileset.json")).unwrap()).unwrap()
}

/// Each tile, depth first: name of its existing file below the tree's folder, its error, and its box.
fn as_said(root: &Value, below: &str, tree: &Path) -> Vec<(String, f64, Vec<f64>)> {
    let (mut said, mut open) = (Vec::new(), vec![root]);
    while let Some(tile) = open.pop() {
        let uri = tile["content"]["uri"].as_str().unwrap();
        assert!(tree.join(uri).is_file(), "{uri}");
        let name = Path::new(uri).strip_prefix(below).unwrap().to_str().unwrap().to_owned();
        let sides = tile["boundingVolume"]["box"].as_array().unwrap();
        let sides = sides.iter().map(|side| side.as_f64().unwrap()).collect();
        said.push((name, tile["geometricError"].as_f64().unwrap(), sides));
        open.extend(tile["children"].as_array().into_iter().flatten());
    }
    said
}

fn run(modules: &Path, arguments: &[&str]) {
    let output = Command::new(modules.join(".bin/3d-tiles-tools")).args(arguments).output().expect("node");
    let said =
        [output.stdout, output.stderr].map(|said| String::from_utf8_lossy(&said).into_owned()).concat();
    // It exits with 0 even after errors.
    assert!(output.status.success() && !said.contains("ERROR"), "{arguments:?}: {said}");
}
