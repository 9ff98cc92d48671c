//! Files of Gaussians, points, cameras; archives.

use super::{assert_linear, gaussians, on_a_small_stack};
use crate::colmap::{self, ColmapCamera, ColmapImage, Model};
use crate::splats::{self, ReadOptions, WriteOptions};
use crate::{cameras_json, ply};
use ashsplat::scene::{Camera, Intrinsics, PointCloud, WorldFrame};
use glam::Vec3;
use serde_json::{Value, json};
use std::io::Write;
use std::ops::Add;
use std::path::Path;

fn read(path: &Path) -> Result<splats::Scene, String> {
    splats::read(path, &ReadOptions::default()).map_err(|error| error.to_string())
}

#[test]
fn gaussians_of_every_format() {
    for name in ["a.ply", "a.compressed.ply", "a.splat", "a.spz", "a.glb", "a.gltf", "a.usda"] {
        let write = |folder: &Path, size: usize| {
            splats::write(folder.join(name), &gaussians(size, 1), &WriteOptions::default()).unwrap();
        };
        assert_linear(40_000, write, |folder| {
            read(&folder.join(name)).unwrap();
        });
    }
}

/// A PLY of Gaussians after an element of lists, which the reader must skip.
fn ply_behind_lists(encoding: &str, rows: usize) -> Vec<u8> {
    let names = "x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3";
    let lists = "property list uchar uchar a\nproperty list uchar int b\n";
    let mut ply = format!("ply\nformat {encoding} 1.0\nelement face {rows}\n{lists}element vertex {rows}\n");
    names.split(' ').for_each(|name| ply += &format!("property float {name}\n"));
    ply += "end_header\n";
    if encoding == "ascii" {
        return (ply + &"2 7 7 1 9\n".repeat(rows) + &"1 ".repeat(13).add("1\n").repeat(rows)).into_bytes();
    }
    let face = [2, 7, 7, 1, 0, 0, 0, 9];
    let one = if encoding == "binary_big_endian" { 1_f32.to_be_bytes() } else { 1_f32.to_le_bytes() };
    [ply.into_bytes(), face.repeat(rows), one.repeat(14 * rows)].concat()
}

#[test]
fn gaussians_behind_lists() {
    for encoding in ["ascii", "binary_little_endian", "binary_big_endian"] {
        let write = |folder: &Path, size: usize| {
            std::fs::write(folder.join("a.ply"), ply_behind_lists(encoding, size)).unwrap();
        };
        assert_linear(5000, write, |folder| {
            assert!(read(&folder.join("a.ply")).unwrap().gaussians.len() >= 5000, "{encoding}");
        });
    }
}

fn glb(path: &Path, document: &Value) {
    let mut json = document.to_string().into_bytes();
    json.resize(json.len().next_multiple_of(4), b' ');
    let mut bytes = b"glTF".to_vec();
    for word in [2, 20 + json.len() as u32, json.len() as u32, 0x4e4f_534a] {
        bytes.extend(word.to_le_bytes());
    }
    bytes.extend(json);
    std::fs::write(path, bytes).unwrap();
}

/// Each node is the child of the previous one, and no scene names the root; or each has the same mesh.
#[test]
fn many_nodes() {
    let write = |folder: &Path, size: usize| {
        let nodes: Vec<Value> =
            (1..=size).map(|next| json!({ "children": [next] })).chain([json!({})]).collect();
        glb(&folder.join("a.glb"), &json!({ "nodes": nodes }));
    };
    let refused = |folder: &Path| {
        assert!(read(&folder.join("a.glb")).unwrap_err().contains("has no Gaussians"));
    };
    assert_linear(15_000, write, refused);
    let with_one_mesh = |folder: &Path, size: usize| {
        let primitives = vec![json!({ "attributes": {} }); size];
        let nodes = vec![json!({ "mesh": 0 }); size];
        glb(&folder.join("a.glb"), &json!({ "nodes": nodes, "meshes": [{ "primitives": primitives }] }));
    };
    assert_linear(2000, with_one_mesh, refused);
    on_a_small_stack(move || {
        let folder = tempfile::tempdir().unwrap();
        write(folder.path(), 60_000);
        refused(folder.path());
    });
}

#[test]
fn many_properties_and_elements() {
    let header = |lines: String| format!("ply\nformat ascii 1.0\n{lines}end_header\n");
    let property = |index: usize| format!("property float f_rest_{index}\n");
    let properties =
        |size: usize| header("element vertex 0\n".to_owned() + &(0..size).map(property).collect::<String>());
    let elements = |size: usize| header((0..size).map(|index| format!("element e{index} 0\n")).collect());
    for text in [&properties as &dyn Fn(usize) -> String, &elements] {
        let write = |folder: &Path, size: usize| std::fs::write(folder.join("a.ply"), text(size)).unwrap();
        assert_linear(4000, write, |folder| {
            read(&folder.join("a.ply")).unwrap_err();
        });
    }
}

#[test]
fn models_and_lists_of_cameras() {
    let intrinsics = Intrinsics { fx: 5.0, fy: 5.0, cx: 2.0, cy: 1.0, width: 4, height: 2 };
    let camera = Camera::look_at(Vec3::NEG_Z, Vec3::ZERO, Vec3::NEG_Y, intrinsics);
    let write = |folder: &Path, size: usize| {
        let images: Vec<_> =
            (0..size as u32).map(|id| ColmapImage::posed(id, id, format!("{id}.png"), &camera)).collect();
        let cameras: Vec<_> = (0..size as u32).map(|id| ColmapCamera::pinhole(id, &camera)).collect();
        let points = PointCloud { positions: vec![[0.5; 3]; size], colors: vec![[9; 3]; size] };
        colmap::write(folder.join("sparse/0"), &cameras, &images, &points).unwrap();
        ply::write_points(folder.join("a.ply"), &points, &WorldFrame::default()).unwrap();
        let named = images.iter().map(|image| (image.name.as_str(), &camera));
        cameras_json::write(folder.join("cameras.json"), named, &WorldFrame::default()).unwrap();
    };
    assert_linear(2000, write, |folder| {
        let model = Model::of_dataset(folder).unwrap();
        assert!(model.images.iter().all(|image| model.camera_of(image).is_ok()));
        cameras_json::read(folder.join("cameras.json"), &WorldFrame::default()).unwrap();
        ply::read_points(folder.join("a.ply"), &mut Vec::new()).unwrap();
    });
}

#[test]
fn archives_of_many_files() {
    let write = |folder: &Path, size: usize| {
        let mut archive = zip::ZipWriter::new(std::fs::File::create(folder.join("a.zip")).unwrap());
        for index in 0..size {
            archive.start_file(format!("a/{index}.txt"), zip::write::SimpleFileOptions::default()).unwrap();
            archive.write_all(b"text").unwrap();
        }
        archive.finish().unwrap();
    };
    assert_linear(300, write, |folder| {
        assert!(!super::inspect(&folder.join("a.zip")).is_sound());
    });
}
