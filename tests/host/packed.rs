//! SPZ of versions 2 and 3, alone and inside a GLB.

use super::files::{Folder, assert_says};
use crate::common::splats::{Tolerance, assert_close, scene, tolerance};
use ashsplat::scene::Gaussians;
use ashsplat_files::splats::{self, Format, ReadOptions, Scene, WriteOptions};
use serde_json::{Value, json};
use std::io::{Read, Write};
use std::path::Path;

const COMPRESSION: &str = "KHR_gaussian_splatting_compression_spz_2";

fn read(path: &Path) -> ashsplat::Result<Scene> {
    splats::read(path, &ReadOptions::default())
}

fn write(path: &Path, gaussians: &Gaussians) {
    write_version(path, gaussians, 2);
}

fn write_version(path: &Path, gaussians: &Gaussians, version: u32) {
    let options = WriteOptions { antialiased: true, spz_version: Some(version), ..Default::default() };
    splats::write(path, gaussians, &options).unwrap();
}

fn spz_of(gaussians: &Gaussians) -> Vec<u8> {
    let (_folder, path) = Folder::with("scene.spz");
    write(&path, gaussians);
    std::fs::read(path).unwrap()
}

/// Version 2 has 8 bits for each of x, y and z of a quaternion. w follows from them, and is least exact near 0.
fn tolerance_of_2() -> Tolerance {
    Tolerance { rotation: 7e-3, ..tolerance(Format::Spz) }
}

#[test]
fn spz_2_and_3_come_back() {
    let folder = Folder::new();
    for (version, degree) in [(2, 0), (2, 1), (2, 2), (2, 3), (3, 3)] {
        let (path, expected) = (folder.join("scene.spz"), scene(700, degree));
        write_version(&path, &expected, version);
        let mut head = [0; 16];
        flate2::read::GzDecoder::new(std::fs::File::open(&path).unwrap()).read_exact(&mut head).unwrap();
        assert_eq!(head[..8], [b'N', b'G', b'S', b'P', version as u8, 0, 0, 0]);
        assert_eq!((&head[8..10], &head[12..]), (&[188, 2][..], &[degree as u8, 19, 1, 0][..]));
        let back = read(&path).unwrap();
        assert!(back.header.antialiased);
        let margin = if version == 2 { tolerance_of_2() } else { tolerance(Format::Spz) };
        assert_close(&back.gaussians, &expected, &margin);
    }
}

/// Warnings name unknown parts of a valid file: flags that change the Gaussians, and extensions.
#[test]
fn unknown_parts_of_an_spz_are_named() {
    let (_folder, path) = Folder::with("scene.spz");
    write(&path, &scene(20, 0));
    let mut bytes = Vec::new();
    flate2::read::GzDecoder::new(std::fs::File::open(&path).unwrap()).read_to_end(&mut bytes).unwrap();
    let packed = |flags: u8, behind: &[u8]| {
        let mut changed = bytes.clone();
        changed[14] = flags;
        changed.extend(behind);
        let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
        encoder.write_all(&changed).unwrap();
        std::fs::write(&path, encoder.finish().unwrap()).unwrap();
        read(&path)
    };
    assert_says(packed(0x81, &[]).unwrap_err().to_string(), &["has flags that are not known (0x80)"]);
    let georeference = [0x01, 0, 0x53, 0x4e, 4, 0, 0, 0, 1, 2, 3, 4];
    let warnings = packed(2, &georeference).unwrap().warnings;
    assert!(warnings[0].ends_with("the extension 0x4e530001 is not used"), "{warnings:?}");
}

#[test]
fn packed_glb_comes_back() {
    let folder = Folder::new();
    for degree in 0..=3 {
        let (path, expected) = (folder.join("scene.glb"), scene(20_000, degree));
        write(&path, &expected);
        let back = read(&path).unwrap();
        assert_eq!((back.header.format, back.header.antialiased), (Format::Glb, true));
        assert_close(&back.gaussians, &expected, &tolerance_of_2());
        // 11 to 56 floats become 19 to 64 bytes.
        let plain = folder.join("plain.glb");
        splats::write(&plain, &expected, &WriteOptions::default()).unwrap();
        let [packed, plain] = [&path, &plain].map(|path| path.metadata().unwrap().len());
        assert!(2 * packed < plain, "{packed} of {plain}");
    }
}

fn glb(path: &Path, spz: &[u8], change: impl FnOnce(&mut Value)) {
    let mut document = json!({
        "asset": { "version": "2.0" },
        "nodes": [{ "mesh": 0 }],
        "buffers": [{ "byteLength": spz.len() }],
        "bufferViews": [{ "buffer": 0, "byteLength": spz.len() }],
        "accessors": [{ "componentType": 5126, "type": "VEC3", "count": 90 }],
        "meshes": [{ "primitives": [{ "mode": 0, "attributes": { "POSITION": 0 }, "extensions": {
            "KHR_gaussian_splatting": { "kernel": "ellipse", "extensions": { COMPRESSION: { "bufferView": 0 } } },
        } }] }],
    });
    change(&mut document);
    let mut json = document.to_string().into_bytes();
    json.resize(json.len().next_multiple_of(4), b' ');
    let numbers = |numbers: [u32; 2]| numbers.map(u32::to_le_bytes).concat();
    let total = (28 + json.len() + spz.len()) as u32;
    let bytes = [
        &b"glTF"[..],
        &numbers([2, total]),
        &numbers([json.len() as u32, 0x4e4f_534a]),
        &json,
        &numbers([spz.len() as u32, 0x004e_4942]),
        spz,
    ];
    std::fs::write(path, bytes.concat()).unwrap();
}

/// With a kernel, the SPZ has its own axes, as the draft requires. Nodes place it like any primitive.
#[test]
fn the_drafts_axes_are_spzs() {
    let (_folder, path) = Folder::with("scene.glb");
    let expected = scene(90, 3);
    let spz = spz_of(&expected);
    glb(&path, &spz, |_| {});
    assert_close(&read(&path).unwrap().gaussians, &expected, &tolerance_of_2());
    // glTF's (2, 3, 4) are (-2, -3, 4) here.
    glb(&path, &spz, |document| document["nodes"][0]["translation"] = json!([2, 3, 4]));
    let mut moved = expected;
    moved.means.iter_mut().for_each(|mean| *mean = [mean[0] - 2.0, mean[1] - 3.0, mean[2] + 4.0]);
    assert_close(&read(&path).unwrap().gaussians, &moved, &tolerance_of_2());
}

#[test]
fn damaged_packed_glb_is_refused() {
    let (_folder, path) = Folder::with("scene.glb");
    let spz = spz_of(&scene(90, 0));
    let refused = |change: &dyn Fn(&mut Value), spz: &[u8], word: &str| {
        glb(&path, spz, change);
        assert_says(read(&path).expect_err(word).to_string(), &[word, "scene.glb"]);
    };
    refused(&|d| d["accessors"][0]["count"] = json!(91), &spz, "90 Gaussians, where 91 are due");
    refused(&|d| d["bufferViews"][0]["byteLength"] = json!(100_000), &spz, "behind its buffer");
    refused(&|d| d["bufferViews"][0]["byteOffset"] = json!(u64::MAX), &spz, "behind its buffer");
    refused(&|d| d["bufferViews"][0]["buffer"] = json!(3), &spz, "buffer is missing");
    refused(&|d| d["bufferViews"] = json!([]), &spz, "buffer view is missing");
    refused(&|d| d["nodes"] = json!(vec![json!({ "mesh": 0 }); 17]), &spz, "again and again");
    refused(&|d| d["buffers"][0]["uri"] = json!("data:;base64,AAAA"), &spz[..0], "inside the JSON");
    refused(&|_| {}, &spz[..spz.len() - 9], "damaged");
    refused(&|_| {}, &[7; 400], "is no SPZ");
}

#[test]
fn versions_that_a_format_has_not_are_refused() {
    let folder = Folder::new();
    for (name, version) in
        [("a.spz", 1), ("a.spz", 5), ("a.glb", 4), ("a.gltf", 2), ("a.ply", 2), ("a.splat", 4)]
    {
        let path = folder.join(name);
        let options = WriteOptions { spz_version: Some(version), ..Default::default() };
        let error = splats::write(&path, &scene(3, 0), &options).unwrap_err().to_string();
        assert_says(error, &["SPZ has 2, 3 and 4"]);
        assert!(!path.exists());
    }
}
