//! PhotoLens distortion: the models, their inverse, the undistorted pinhole. COLMAP's own tool is among the programs.

use super::files::Folder;
use crate::common::lenses::write;
use ashsplat::scene::Intrinsics;
use ashsplat::scene::distortion::{Distortion, PhotoLens};
use ashsplat_files::colmap::Model;
use ashsplat_files::images::undistort;
use ashsplat_files::{DatasetOptions, Gallery, Photo, Progress};
use glam::{DVec2, dvec2};
use proptest::prelude::*;

fn lenses() -> Vec<PhotoLens> {
    let folder = Folder::new();
    write(&folder);
    let model = Model::of_dataset(&folder).unwrap();
    model.cameras.values().map(|camera| model.lens(camera).unwrap()).collect()
}

/// True if the distortion folds between the centre and a point. The distorted point then has two sources, and
/// undoing it gives the other one.
fn folds_before(distortion: &Distortion, point: DVec2) -> bool {
    const STEPS: u32 = 64;
    let h = 1e-5;
    let by = |at: DVec2, axis: DVec2| {
        (distortion.apply(at + h * axis) - distortion.apply(at - h * axis)) / (2.0 * h)
    };
    (0..=STEPS).any(|step| {
        let at = point * (f64::from(step) / f64::from(STEPS));
        by(at, DVec2::X).perp_dot(by(at, DVec2::Y)) < 0.05
    })
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(300) })]
    #[test]
    fn undoing_inverts(
        k in prop::array::uniform4(-0.05..0.05f64),
        p in prop::array::uniform2(-0.002..0.002f64),
        d in prop::array::uniform3(-0.02..0.02f64),
        point in prop::array::uniform2(-0.8..0.8f64),
    ) {
        let point = DVec2::from_array(point);
        for distortion in [Distortion::Brown { k, d, p }, Distortion::Fisheye { k }, Distortion::None] {
            if folds_before(&distortion, point) {
                continue;
            }
            let back = distortion.undo(distortion.apply(point)).unwrap();
            prop_assert!(back.distance(point) < 1e-7, "{distortion:?} {point} {back}");
        }
    }
}

#[test]
fn known_values_of_the_models() {
    let near = |a: DVec2, b: DVec2| assert!(a.distance(b) < 1e-12, "{a} {b}");
    let point = dvec2(0.5, -0.25);
    let r2: f64 = 0.3125;
    near(
        Distortion::Brown { k: [0.1, 0.0, 0.0, 0.0], d: [0.0; 3], p: [0.0; 2] }.apply(point),
        point * (1.0 + 0.1 * r2),
    );
    let p = Distortion::Brown { k: [0.0; 4], d: [0.0; 3], p: [0.01, 0.02] };
    let (u, v) = (0.5, -0.25);
    near(
        p.apply(point),
        point + dvec2(0.02 * u * v + 0.02 * (r2 + 2.0 * u * u), 0.04 * u * v + 0.01 * (r2 + 2.0 * v * v)),
    );
    let theta = r2.sqrt().atan();
    near(Distortion::Fisheye { k: [0.0; 4] }.apply(point), point * (theta / r2.sqrt()));
    // No point of the plane appears beyond a right angle.
    assert!(Distortion::Fisheye { k: [0.0; 4] }.undo(dvec2(1.7, 0.0)).is_none());
}

/// No pixel of the undistorted photo lies outside the photo, and no larger pinhole would fit.
#[test]
fn the_pinhole_is_inscribed() {
    for lens in lenses() {
        let pinhole = lens.inscribed_pinhole().unwrap();
        let place = |x: f64, y: f64, of: &Intrinsics| {
            let center = dvec2(f64::from(of.cx), f64::from(of.cy));
            lens.project((dvec2(x, y) - center) / dvec2(f64::from(of.fx), f64::from(of.fy)))
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
    for (resolution, end) in [("1", ""), ("2", " (-r 2)")] {
        let options = DatasetOptions { resolution: resolution.parse().unwrap(), ..Default::default() };
        let gallery = Gallery::open(&folder, &options, Progress::NONE).unwrap();
        // The largest photo, because the cameras have several sizes.
        let largest = gallery.train_photos().iter().map(|photo| photo.width * photo.height).max();
        let photos = gallery.train_photos();
        let size = photos.iter().find(|photo| Some(photo.width * photo.height) == largest).unwrap();
        let used = format!("used at up to {}x{} pixels{end}", size.width, size.height);
        let [note] = gallery.notes() else { panic!("{:?}", gallery.notes()) };
        assert!(note.contains("all 6 cameras have lens distortion") && note.ends_with(&used), "{note}");
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
        let mut rgb = Vec::new();
        for (y, x) in (0..240).flat_map(|y| (0..320).map(move |x| (y, x))) {
            let seen = (dvec2(f64::from(x) + 0.5, f64::from(y) + 0.5) - lens.center_px) / lens.focal_px;
            rgb.extend(board(lens.distortion.undo(seen).unwrap()).map(|v| v.round() as u8));
        }
        let pinhole = lens.inscribed_pinhole().unwrap();
        let photo = undistort(&Photo { width: 320, height: 240, rgb }, &lens, &pinhole);
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
