//! CesiumJS in headless Chromium draws our trees of tiles as we draw their Gaussians.

use std::path::{Path, PathBuf};
use std::process::Command;

use ashsplat::scene::{Camera, Gaussians};
use ashsplat_files::{Photo, PhotoFileFormat, metrics, splats};
use glam::Vec3;
use serde_json::Value;

use super::once_more_with_patience;
use super::playcanvas::{camera, render, side_by_side};
use super::tiles::{document, tree_of_the_ball};

/// Least PSNR between its picture and ours of the same tiles, dB.
const LEAST_PSNR: f64 = 35.0;

pub const TRIALS: [(&str, super::Check); 1] =
    [("cesium_shows_our_tiles_ply", |modules, _| shows_the_tree(modules))];

/// It draws all leaves if no error is allowed, and the root if the root's error is.
fn shows_the_tree(modules: &Path) {
    let folder = tempfile::tempdir().unwrap();
    // The root's error is about 20 pixels at the camera's distance; an empty picture would have about 900.
    let tree = tree_of_the_ball(folder.path(), true);
    let document = document(&tree);
    let all = names(&document["root"], false);
    let finest = names(&document["root"], true);
    assert!(finest.len() >= 6 && all.len() > finest.len() + 1, "{all:?}");
    let coarsest = vec![document["root"]["content"]["uri"].as_str().unwrap().to_owned()];
    for (name, error, expected) in [("finest", 0.01, finest), ("coarsest", 200.0, coarsest)] {
        let camera = camera();
        let picture = folder.path().join("cesium.png");
        let mut gaussians = Gaussians { sh_degree: 3, ..Default::default() };
        for tile in &expected {
            gaussians.append(&splats::read(tree.join(tile), &Default::default()).unwrap().gaussians);
        }
        let ours = render(&gaussians, &camera);
        let kept = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("cesium_{name}.png"));
        once_more_with_patience(8, |still_frames| {
            let drawn = draw(modules, &tree, &camera, (error, still_frames), &picture);
            if drawn != expected {
                return Err(format!("{name}: {drawn:?} are drawn in place of {expected:?}"));
            }
            let theirs = Photo::read(&picture, [0.0; 3]).unwrap();
            side_by_side(&ours, &theirs).write_png(&kept).unwrap();
            let psnr = metrics::psnr(&ours.to_f32(), &theirs.to_f32()).unwrap();
            println!("{name}: {} tiles, {psnr:.2} dB, {}", drawn.len(), kept.display());
            if psnr >= LEAST_PSNR { Ok(()) } else { Err(format!("{psnr:.2} dB: see {}", kept.display())) }
        });
    }
}

/// Sorted tiles of a tree: the leaves only, or all.
fn names(root: &Value, finest: bool) -> Vec<String> {
    let (mut names, mut open) = (Vec::new(), vec![root]);
    while let Some(tile) = open.pop() {
        let children = tile["children"].as_array().map_or(&[][..], Vec::as_slice);
        if children.is_empty() || !finest {
            names.push(tile["content"]["uri"].as_str().unwrap().to_owned());
        }
        open.extend(children);
    }
    names.sort();
    names
}

/// Draws a tree with CesiumJS. Returns the sorted tiles that it drew.
fn draw(
    modules: &Path,
    tree: &Path,
    camera: &Camera,
    (error, still_frames): (f64, u32),
    output: &Path,
) -> Vec<String> {
    let r = camera.camera_from_world;
    // z up.
    let turned = |v: Vec3| [-v.x, -v.z, -v.y];
    let description = serde_json::json!({
        "width": camera.width,
        "height": camera.height,
        "fov_degrees": 2.0 * (0.5 * camera.width as f32 / camera.fx).atan().to_degrees(),
        "eye": turned(camera.position()),
        "forward": turned(r.row(2)),
        "up": turned(-r.row(1)),
        "screen_space_error": error,
        "still_frames": still_frames,
    });
    let file = output.with_extension("json");
    std::fs::write(&file, description.to_string()).unwrap();
    let script = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/ecosystem/cesium.mjs"));
    let mut node = Command::new("node");
    let result = node.arg(script).arg(modules).arg(tree).arg(file).arg(output).output().expect("node");
    assert!(result.status.success(), "{}", String::from_utf8_lossy(&result.stderr));
    let mut drawn: Vec<String> = String::from_utf8_lossy(&result.stdout).lines().map(Into::into).collect();
    drawn.sort();
    drawn
}
