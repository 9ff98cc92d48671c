//! Readers under a limit of address space, as `ulimit -v` and `prlimit --as` set it. Insufficient memory is an error
//! with the required amount, and does not end the program.
#![cfg(target_os = "linux")]

use crate::common::child;
use crate::common::prelude::*;
use crate::common::splats::scene;
use ashsplat::scene::{Intrinsics, PointCloud, WorldFrame};
use ashsplat_files::colmap::{ColmapCamera, ColmapImage, Model};
use ashsplat_files::dataset::{Dataset, DatasetOptions};
use ashsplat_files::splats::{ConvertOptions, Format, ReadOptions, Target, WriteOptions};
use ashsplat_files::{PhotoFileFormat, Progress, Resolution, cameras_json, colmap, ply, splats};
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use std::fs::{self, File};
use std::path::Path;

/// Address space of the readers.
const ROOM: u64 = 24 << 20;
/// Number of Gaussians; each takes at least 56 bytes.
const MANY: usize = 400_000;

fn address_space() -> u64 {
    let status = fs::read_to_string("/proc/self/status").expect("a status");
    let line = status.lines().find_map(|line| line.strip_prefix("VmSize:")).expect("a size");
    let kib: u64 = line.trim().trim_end_matches(" kB").parse().expect("a number");
    kib << 10
}

/// Limits this process to `room` bytes more than it uses. It waits first until new threads have
/// reserved their address space.
fn limit_address_space(room: u64) {
    let mut size = address_space();
    loop {
        std::thread::sleep(std::time::Duration::from_millis(200));
        let before = std::mem::replace(&mut size, address_space());
        if before == size {
            break;
        }
    }
    let current = Some(size + room);
    setrlimit(Resource::As, Rlimit { current, ..getrlimit(Resource::As) }).expect("a limit");
}

fn dataset(folder: &Path, photos: u32, [width, height]: [u32; 2]) {
    let intrinsics = Intrinsics::from_fov_x(1.0, width, height);
    let camera =
        |i: u32| Camera::look_at(Vec3::new(i as f32, 0.0, -4.0), Vec3::ZERO, Vec3::NEG_Y, intrinsics);
    fs::create_dir_all(folder.join("images")).expect("a folder");
    let photo = Photo { width, height, rgb: vec![9; 3 * (width * height) as usize] };
    photo.write_png(folder.join("images/0.png")).expect("a photo");
    let name = |i: u32| format!("{i}.png");
    (1..photos).for_each(|i| {
        fs::copy(folder.join("images/0.png"), folder.join("images").join(name(i))).expect("a copy");
    });
    let images: Vec<_> = (0..photos).map(|i| ColmapImage::posed(i, 1, name(i), &camera(i))).collect();
    let points = PointCloud { positions: vec![[0.5; 3]; 9], colors: vec![[9; 3]; 9] };
    let lens = ColmapCamera::pinhole(1, &camera(0));
    colmap::write(folder.join("sparse/0"), &[lens], &images, &points).expect("a model");
}

fn spaces(path: &Path, mib: usize) {
    fs::write(path, vec![b' '; mib << 20]).expect("a file");
}

fn refused<T>(what: &str, result: ashsplat::Result<T>) {
    let Err(error) = result else { panic!("{what}: has room") };
    let message = error.to_string();
    println!("{message}");
    assert!(matches!(error, Error::TooLarge { .. }) && message.contains("bytes of host memory"), "{message}");
    assert!(message.contains(what) && !message.contains('\n'), "{message}");
}

#[test]
#[ignore = "limits the memory of its process: address_space_is_respected runs it in one of its own"]
fn readers_without_address_space() {
    let folder = tempfile::tempdir().expect("a folder");
    let place = |name: &str| folder.path().join(name);
    for format in Format::WRITTEN {
        let path = place(&format!("many{}", format.extension()));
        splats::write(&path, &scene(MANY, 0), &WriteOptions::default()).expect("written");
        let path = place(&format!("few{}", format.extension()));
        splats::write(&path, &scene(100, 0), &WriteOptions::default()).expect("written");
    }
    let large = Photo { width: 4000, height: 3000, rgb: vec![90; 36_000_000] };
    large.write_png(place("large.png")).expect("written");
    let pixels = image::RgbImage::from_raw(4000, 3000, large.rgb).expect("a picture");
    pixels.save(place("large.jpg")).expect("written");
    drop(pixels);
    dataset(&place("many"), 20, [800, 600]);
    dataset(&place("large"), 2, [4000, 3000]);
    dataset(&place("few"), 2, [80, 60]);
    File::create(place("large.safetensors")).and_then(|file| file.set_len(64 << 20)).expect("a file");
    let many_points = [2_000_000_u64.to_le_bytes().as_slice(), &vec![0; 51 * 2_000_000]].concat();
    dataset(&place("points"), 1, [8, 6]);
    fs::write(place("points/sparse/0/points3D.bin"), many_points).expect("a file");
    dataset(&place("text"), 1, [8, 6]);
    for part in ["cameras", "images", "points3D"] {
        let _ = fs::remove_file(place("text/sparse/0").join(part).with_extension("bin"));
    }
    spaces(&place("text/sparse/0/cameras.txt"), 12);
    spaces(&place("text/sparse/0/images.txt"), 12);
    spaces(&place("cameras.json"), 20);
    fs::create_dir(place("frames")).expect("a folder");
    spaces(&place("frames/transforms.json"), 20);
    let points = PointCloud { positions: vec![[0.5; 3]; 1_500_000], colors: vec![[9; 3]; 1_500_000] };
    ply::write_points(place("points.ply"), &points, &WorldFrame::default()).expect("written");
    drop(points);
    let load = |name: &str, resolution: Resolution| {
        // Same as under the limit: the default depends on it.
        let options = DatasetOptions { resolution, ..Default::default() };
        Dataset::load(place(name), &options, Progress::NONE)
    };
    // The threads that read photos stay alive.
    assert_eq!(load("few", Resolution::Auto).expect("room").train.len(), 2);

    limit_address_space(ROOM);
    for format in Format::WRITTEN {
        let many = format!("many{}", format.extension());
        refused(&many, splats::read(place(&many), &ReadOptions::default()));
        let few = place(&format!("few{}", format.extension()));
        assert_eq!(splats::read(few, &ReadOptions::default()).expect("room").gaussians.len(), 100);
    }
    refused("large.png: reading it", Photo::read(place("large.png"), [0.0; 3]));
    refused("large.jpg: reading it", Photo::read(place("large.jpg"), [0.0; 3]));
    refused("keeping its 20 photos", load("many", Resolution::Auto));
    refused("keeping its 2 photos", load("large", Resolution::Factor(1)));
    // Read by rows, they fit.
    assert_eq!(load("large", Resolution::Width(200)).expect("room").train.len(), 2);
    refused("large.safetensors", Checkpoint::read(place("large.safetensors")));
    refused("points3D.bin", Model::of_dataset(place("points")));
    refused("cameras.txt", Model::of_dataset(place("text")));
    refused("transforms.json", load("frames", Resolution::Auto));
    refused("cameras.json", cameras_json::read(place("cameras.json"), &WorldFrame::default()));
    refused("points.ply", ply::read_points(place("points.ply"), &mut Vec::new()));
    // A conversion by blocks fits; sorting and merging need all at once.
    let convert =
        |to: &str, options: &ConvertOptions| splats::convert(&place("many.ply"), &place(to), options);
    let out = convert("out.splat", &ConvertOptions::default()).expect("room");
    assert_eq!(out.written, MANY as u64);
    refused("out.compressed.ply: writing it", convert("out.compressed.ply", &ConvertOptions::default()));
    let half = ConvertOptions { decimate: Some(Target::Share(0.5)), ..Default::default() };
    refused("many.ply: reading it", convert("half.splat", &half));
    assert!(!place("out.compressed.ply").exists() && !place("half.splat").exists());
}

#[test]
fn address_space_is_respected() {
    let said = child::run(&["readers_without_address_space"], 1, |_| {});
    assert!(said.contains("bytes of host memory"), "{said}");
}
