//! CesiumJS in headless Chromium draws our trees of tiles as we draw their Gaussians.

use super::playcanvas::{camera, render};
use super::tiles::{document, tree_of_the_ball};
use super::{compare_at_least, once_more_with_patience, read, run_script};
use ashsplat::scene::{Camera, Gaussians};
use ashsplat_files::{Photo, PhotoFileFormat};
use glam::Vec3;
use serde_json::Value;
use std::path::Path;

const MIN_PSNR: f64 = 35.0;

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
            gaussians.append(&read(&tree.join(tile)));
        }
        let ours = render(&gaussians, &camera);
        once_more_with_patience(8, |still_frames| {
            let drawn = draw(modules, &tree, &camera, (error, still_frames), &picture);
            if drawn != expected {
                return Err(format!("{name}: {drawn:?} are drawn in place of {expected:?}"));
            }
            let theirs = Photo::read(&picture, [0.0; 3]).unwrap();
            compare_at_least(MIN_PSNR, &format!("cesium_{name}"), &ours, &theirs)
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
    let said = run_script("cesium.mjs", &[modules, tree, &file, output]);
    let mut drawn: Vec<String> = said.lines().map(Into::into).collect();
    drawn.sort();
    drawn
}
