//! Undistorted photographs: the pinhole, and what it shows. COLMAP's own tool is among the programs.

use super::files::Folder;
use crate::common::lenses::write;
use ashsplat::scene::{Intrinsics, PhotoLens};
use ashsplat_files::colmap::Model;
use ashsplat_files::images::undistort;
use ashsplat_files::{DatasetOptions, Gallery, Photo, Progress};
use glam::{DVec2, dvec2};

fn lenses() -> Vec<PhotoLens> {
    let folder = Folder::new();
    write(&folder);
    let model = Model::of_dataset(&folder).unwrap();
    model.cameras.values().map(|camera| model.lens(camera).unwrap()).collect()
}

/// No pixel of the undistorted photo lies outside the photo, and no larger pinhole would fit.
#[test]
fn the_pinhole_is_inscribed() {
    for lens in lenses() {
        let pinhole = lens.inscribed_pinhole().unwrap();
        let place = |x: f64, y: f64, of: &Intrinsics| {
            let center = dvec2(f64::from(of.cx), f64::from(of.cy));
            let point = (dvec2(x, y) - center) / dvec2(f64::from(of.fx), f64::from(of.fy));
            lens.project(point.extend(1.0)).unwrap()
        };
        let outside = |of: &Intrinsics| {
            let (w, h) = (of.width, of.height);
            let border =
                (0..w).flat_map(|x| [(x, 0), (x, h - 1)]).chain((0..h).flat_map(|y| [(0, y), (w - 1, y)]));
            border
                .filter(|&(x, y)| {
                    let p = place(f64::from(x) + 0.5, f64::from(y) + 0.5, of);
                    p.x < 0.5 || p.y < 0.5 || p.x > 319.5 || p.y > 239.5
                })
                .count()
        };
        // COLMAP rounds the principal point with the size: a border pixel may be half a pixel outside.
        assert!(outside(&pinhole) <= pinhole.height as usize, "{lens:?} {}", outside(&pinhole));
        let (cx, cy) = (pinhole.cx * 1.05, pinhole.cy * 1.05);
        let larger = Intrinsics {
            width: (pinhole.width as f32 * 1.05) as u32,
            height: (pinhole.height as f32 * 1.05) as u32,
            cx,
            cy,
            ..pinhole
        };
        assert!(outside(&larger) > pinhole.height as usize, "{lens:?}");
    }
}

/// Distortion is no problem: a note names it and the size used.
#[test]
fn what_happens_to_distorted_photos_is_no_warning() {
    let folder = Folder::new();
    write(&folder);
    for (resolution, end, undistort) in [("1", "", true), ("2", " (-r 2)", true), ("2", " (-r 2)", false)] {
        let resolution = resolution.parse().unwrap();
        let options = DatasetOptions { resolution, undistort, ..Default::default() };
        let gallery = Gallery::open(&folder, &options, Progress::NONE).unwrap();
        // The largest photo, because the cameras have several sizes.
        let largest = gallery.train_photos().iter().map(|photo| photo.width * photo.height).max();
        let photos = gallery.train_photos();
        let size = photos.iter().find(|photo| Some(photo.width * photo.height) == largest).unwrap();
        let up_to = if undistort {
            "undistorted as they are read, and used at up to "
        } else {
            "used as they were taken, at "
        };
        let used = format!("{up_to}{}x{} pixels{end}", size.width, size.height);
        let [note] = gallery.notes() else { panic!("{:?}", gallery.notes()) };
        assert!(note.contains("all 6 cameras have a lens") && note.ends_with(&used), "{note}");
        assert!(!gallery.warnings().concat().contains("lens"), "{:?}", gallery.warnings());
    }
}

/// An undistorted photo of straight lines equals the pinhole camera's view.
#[test]
fn undistorted_photos_show_what_a_pinhole_sees() {
    // A board in the plane z = 1.
    let board = |p: DVec2| {
        let wave = |phase: f64| 127.5 + 110.0 * phase.sin();
        [wave(9.0 * p.x), wave(8.0 * p.y + 1.0), wave(6.0 * (p.x + p.y))]
    };
    for lens in lenses() {
        let (ray_at, mut rgb) = (lens.rays(), Vec::new());
        for (y, x) in (0..240).flat_map(|y| (0..320).map(move |x| (y, x))) {
            let ray = ray_at(dvec2(f64::from(x) + 0.5, f64::from(y) + 0.5)).unwrap();
            rgb.extend(board(ray.truncate() / ray.z).map(|v| v.round() as u8));
        }
        let pinhole = lens.inscribed_pinhole().unwrap();
        let photo = undistort(&Photo { width: 320, height: 240, rgb }, &lens, &PhotoLens::pinhole(pinhole));
        let mut off = 0;
        for (index, pixel) in photo.rgb.chunks_exact(3).enumerate() {
            let (x, y) = (index as u32 % pinhole.width, index as u32 / pinhole.width);
            if x == 0 || y == 0 || x + 1 == pinhole.width || y + 1 == pinhole.height {
                continue;
            }
            let center = dvec2(f64::from(pinhole.cx), f64::from(pinhole.cy));
            let focal = dvec2(f64::from(pinhole.fx), f64::from(pinhole.fy));
            let expected = board((dvec2(f64::from(x) + 0.5, f64::from(y) + 0.5) - center) / focal);
            off += pixel.iter().zip(expected).filter(|(a, b)| (f64::from(**a) - b).abs() > 2.0).count();
        }
        assert!(off < 20, "{lens:?}: {off} values are off");
    }
}
