//! Data sets in a ZIP: they are unpacked, and the temporary files are removed. One scene in two layouts: as the
//! synthetic scenes of the NeRF paper, and as a COLMAP model.

use super::*;
use crate::program::page::Server;
use ashsplat_files::{Dataset, DatasetOptions, Progress, View};
use std::io::Write;
use zip::write::SimpleFileOptions;

pub(super) fn pack<'a>(archive: &Path, files: impl IntoIterator<Item = (String, &'a [u8])>) {
    let mut zip = zip::ZipWriter::new(std::fs::File::create(archive).expect("a file"));
    for (name, bytes) in files {
        zip.start_file(name, SimpleFileOptions::default()).expect("an entry");
        zip.write_all(bytes).expect("packed");
    }
    zip.finish().expect("an archive");
}

/// The program with its own folder for temporary files, not yet started.
fn command(place: &Place, line: &str) -> Command {
    place.create_folder("temporary");
    let mut command = place.command(line);
    command.env("TMPDIR", place.at("temporary"));
    command
}

fn unpacked(place: &Place) -> usize {
    let entries = std::fs::read_dir(place.at("temporary")).expect("a folder").flatten();
    entries.filter(|entry| entry.path().is_dir()).count()
}

const TRAIN: &str = "train -s @data.zip -m @model --iterations 1000000 --quiet";

/// A page shows the photos that training has unpacked, and all unpacked files are removed at the end.
#[test]
fn archives_are_unpacked_once_and_removed() {
    let place = Place::new();
    let files: Vec<(String, Vec<u8>)> = (place.files("data").iter())
        .map(|file| (format!("scene/{}", text(file)), place.read(Path::new("data").join(file))))
        .collect();
    pack(&place.at("data.zip"), files.iter().map(|(name, bytes)| (name.clone(), bytes.as_slice())));
    for (line, code) in [(format!("{TRAIN} --view=0"), 130), ("view @data.zip --port 0".into(), 0)] {
        let server = Server::run(command(&place, &line), &[], "viewer at ");
        // The page exists before the scene, and waits for it.
        server.page();
        assert_eq!(unpacked(&place), 1, "{line}");
        let (ended_with, stderr) = server.end();
        assert_eq!(ended_with, Some(code), "{line}: {stderr}");
        assert_eq!(unpacked(&place), 0, "{line}: something is left");
    }
}

#[test]
fn archives_are_removed_when_loading_is_interrupted() {
    let place = Place::empty();
    // Photos that are slow to decode.
    let mut photo = Vec::new();
    let grey = image::GrayImage::new(5000, 5000);
    image::codecs::jpeg::JpegEncoder::new(&mut photo).encode_image(&grey).expect("a JPEG");
    let names: Vec<String> = (0..30).map(|index| format!("{index}.jpg")).collect();
    let transforms = transforms(&names, 5000);
    let photos = names.into_iter().map(|name| (name, photo.as_slice()));
    pack(&place.at("data.zip"), photos.chain([("transforms.json".into(), transforms.as_bytes())]));
    let mut command = command(&place, TRAIN);
    let mut running = Running::start(command.stdout(Stdio::null()).stderr(Stdio::null()));
    wait_until("nothing is unpacked", || unpacked(&place) > 0);
    running.interrupt();
    assert_eq!(running.wait().expect("it ends").code(), Some(130));
    assert_eq!(unpacked(&place), 0, "something is left");
    assert!(!place.has("model"), "training had begun");
}

fn load(dataset: &Path) -> Dataset {
    let options = DatasetOptions { eval: true, ..DatasetOptions::default() };
    Dataset::load(dataset, &options, Progress::NONE).expect("a data set")
}

#[test]
fn the_city_is_a_data_set_of_many_photos() {
    let place = Place::empty();
    place.run("demo --out @city --scene city --photo-width 64 --dataset-only --quiet").ok();
    let dataset = load(&place.at("city/dataset"));
    assert_eq!((dataset.train.len(), dataset.test.len()), (141, 21));
    let camera = dataset.train[0].camera;
    assert_eq!((camera.width, camera.height), (64, 48));
    assert!(dataset.points.positions.len() > 1000);
    for (option, value) in [("--lots", "12"), ("--photo-width", "64")] {
        place.run(format!("demo --out @none {option} {value}")).refused(&[option, "city"]);
        assert!(!place.has("none"));
    }
}

/// Fails unless both layouts load identically, to the bit.
fn assert_alike(nerf: &Dataset, colmap: &Dataset) {
    assert_eq!((nerf.train.len(), nerf.test.len()), (35, 5));
    let corner: Vec<u8> = nerf.train[0].photo.photo().expect("in memory").rgb[..3].to_vec();
    assert_eq!(corner, [0; 3], "the sky is transparent, and so the background");
    assert_eq!((&nerf.points, nerf.scene_extent), (&colmap.points, colmap.scene_extent));
    let number =
        |view: &View| view.name.trim_end_matches(".png").rsplit_once('_').expect("a number").1.to_owned();
    for (a, b) in [(&nerf.train, &colmap.train), (&nerf.test, &colmap.test)] {
        assert_eq!(a.len(), b.len());
        for (a, b) in a.iter().zip(b) {
            assert_eq!((number(a), a.camera), (number(b), b.camera));
            assert!(a.photo == b.photo, "the photos of {} differ", a.name);
        }
    }
}

/// Photographs, cameras, split and points of the demo's scene without its sky are equal in both layouts, so that
/// trainings have the same bits.
#[test]
fn layouts_of_a_scene_load_alike() {
    let place = Place::empty();
    for points in ["sparse", "none"] {
        let [nerf, colmap] = ["nerf-synthetic", "colmap"].map(|layout| {
            let kind = format!("--layout {layout} --points {points} --without-sky");
            place.run(format!("demo --out @{points}_{layout} --dataset-only --quiet {kind}")).ok();
            load(&place.at(format!("{points}_{layout}")).join("dataset"))
        });
        assert_alike(&nerf, &colmap);
    }
}
