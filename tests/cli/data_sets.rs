//! Data sets in a ZIP: they are unpacked, and the temporary files are removed. One scene in two layouts: as the
//! synthetic scenes of the NeRF paper, and as a COLMAP model.

use super::*;
use crate::program::page::Server;
use ashsplat::scene::linear_from_srgb;
use ashsplat_demo_scene::View as DemoView;
use ashsplat_demo_scene::city::{self, City};
use ashsplat_demo_scene::raycast;
use ashsplat_files::{Dataset, DatasetOptions, Progress, View};
use glam::{DMat3, DQuat, DVec3};
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
fn command(place: &TestFolder, line: &str) -> Command {
    place.create_folder("temporary");
    let mut command = place.command(line);
    command.env(if cfg!(windows) { "TMP" } else { "TMPDIR" }, place.at("temporary"));
    command
}

fn unpacked(place: &TestFolder) -> usize {
    let entries = std::fs::read_dir(place.at("temporary")).expect("a folder").flatten();
    entries.filter(|entry| entry.path().is_dir()).count()
}

const TRAIN: &str = "train -s @data.zip -m @model --iterations 1000000 --quiet";

/// A page shows the photos that training has unpacked, and all unpacked files are removed at the end.
#[test]
fn archives_are_unpacked_once_and_removed() {
    let place = TestFolder::new();
    let files: Vec<(String, Vec<u8>)> = (place.files("data").iter())
        .map(|file| (format!("scene/{}", text(file)), place.read(Path::new("data").join(file))))
        .collect();
    pack(&place.at("data.zip"), files.iter().map(|(name, bytes)| (name.clone(), bytes.as_slice())));
    for (line, code) in [(format!("{TRAIN} --view=0"), 130), ("view @data.zip --port 0".into(), 0)] {
        let server = Server::run(command(&place, &line), &[]);
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
    let place = TestFolder::empty();
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

/// Lots along a side of the city in trials, the fewest.
const LOTS: u32 = 4;

/// Writes the city through a lens.
fn write_city(place: &TestFolder, lens: &str) -> PathBuf {
    let city = format!("--scene city --lots {LOTS} --photo-width 64 --dataset-only --quiet");
    place.run(format!("demo --out @{lens} --lens {lens} {city}")).ok();
    place.at(lens).join("dataset")
}

/// The city from this pose, through a pinhole.
fn city_from(pose: &Camera, width: u32) -> (Camera, Photo) {
    let intrinsics = Intrinsics::from_fov_x(0.96, width, width * 3 / 4);
    let camera = Camera::with_pose(pose.camera_from_world, pose.translation, intrinsics);
    let city = city::scene(City { lots: LOTS, ..City::default() });
    (camera, raycast::photograph(&city, &DemoView::new(camera)))
}

/// Pixels of photographs through a lens show the light that a pinhole with the same pose sees in their directions.
#[test]
fn the_city_through_a_lens_is_the_city() {
    const PHOTO: usize = 5;
    let place = TestFolder::empty();
    for (lens, model, size) in [("opencv-fisheye", 5, [56, 56]), ("equirectangular", 17, [80, 40])] {
        let folder = write_city(&place, lens);
        let found = colmap::Model::of_dataset(&folder).expect("a model");
        let (own, image) = (&found.cameras[&1], &found.images[PHOTO]);
        assert_eq!((own.model.number(), found.images.len()), (model, 50));
        let camera = found.camera_of(image).expect("a camera");
        let photo = image::open(folder.join("images").join(&image.name)).expect("a photograph").to_rgb8();
        assert_eq!([photo.width(), photo.height()], size);

        // The light of a finer photograph through a pinhole, collected where the lens shows it.
        let (pinhole, truth) = city_from(&camera, 256);
        let linear = |rgb: [u8; 3]| Vec3::from(rgb.map(|c| linear_from_srgb(f32::from(c) / 255.0)));
        let rays = pinhole.rays();
        let mut light = std::collections::BTreeMap::new();
        for (index, &rgb) in (0..).zip(truth.rgb.as_chunks::<3>().0) {
            let direction = rays([(index % 256) as f32 + 0.5, (index / 256) as f32 + 0.5]);
            let seen = pinhole.position() + pinhole.camera_from_world.transpose() * direction;
            let (x, y, _) = camera.project(seen);
            let (sum, count) = light.entry((x as u32, y as u32)).or_insert((Vec3::ZERO, 0.0));
            *sum += linear(rgb);
            *count += 1.0;
        }
        let max = light.values().map(|(_, count)| *count).fold(0.0, f32::max);
        light.retain(|_, (_, count)| *count > 0.7 * max);
        let difference = |shift: u32| {
            let off = light.iter().map(|(&(x, y), &(sum, count))| {
                let shown = linear(photo.get_pixel((x + shift).min(size[0] - 1), y).0);
                (sum / count - shown).abs().element_sum()
            });
            off.sum::<f32>() / (3 * light.len()) as f32
        };
        let (own, beside) = (difference(0), difference(1));
        assert!(light.len() > 50 && own < 0.3 * beside, "{lens}: {own}, with the pixels beside {beside}");

        // Only the fisheye has a rim, and a mask for what lies beyond.
        let mask = folder.join("masks").join(format!("{}.png", image.name));
        assert_eq!(mask.is_file(), lens == "opencv-fisheye");
        if mask.is_file() {
            let mask = image::open(mask).expect("a mask").to_luma8();
            assert_eq!([(0, 0), (28, 1), (28, 28)].map(|(x, y)| mask.get_pixel(x, y).0[0]), [0, 255, 255]);
            assert_eq!(photo.get_pixel(0, 0).0, [0; 3]);
        }
    }
}

/// Rows of a rolling shutter show what a pinhole sees from the pose of their time.
#[test]
fn rows_of_a_rolling_shutter_have_poses_of_their_own() {
    const PHOTO: usize = 5;
    let place = TestFolder::empty();
    let folder = write_city(&place, "rolling-shutter");
    let file = place.read_json(folder.join("transforms.json"));
    assert_eq!((file["shutter"].as_str(), file["frames"].as_array().map(Vec::len)), (Some("down"), Some(50)));
    let frame = &file["frames"][PHOTO];
    let [first, last] = ["transform_matrix", "transform_matrix_end"].map(|key| {
        let number = |row: usize, column: usize| frame[key][row][column].as_f64().expect("a number");
        let column = |column: usize| DVec3::from([0, 1, 2].map(|row| number(row, column)));
        // From y up and z backward.
        let axes = DMat3::from_cols(column(0), -column(1), -column(2));
        (DQuat::from_mat3(&axes), column(3))
    });
    let photo = image::open(folder.join(frame["file_path"].as_str().expect("a path")))
        .expect("a photograph")
        .to_rgb8();
    let intrinsics = Intrinsics::from_fov_x(0.96, 64, 48);
    let off = |row: u32, share: f64| {
        let turned = DMat3::from_quat(first.0.slerp(last.0, share)).transpose();
        let pose = Camera::at(first.1.lerp(last.1, share), turned, intrinsics);
        let (_, truth) = city_from(&pose, 64);
        let row = 3 * 64 * row as usize..3 * 64 * (row as usize + 1);
        let pairs = truth.rgb[row.clone()].iter().zip(&photo.as_raw()[row]);
        pairs.map(|(a, b)| f32::from(a.abs_diff(*b))).sum::<f32>() / (3.0 * 64.0)
    };
    for row in [0, 15, 47] {
        let own = off(row, f64::from(row) / 47.0);
        assert!(own < 1.0, "row {row} differs by {own} of 255");
    }
    assert!(off(47, 0.0) > 5.0 && off(0, 1.0) > 5.0, "nothing moves");
    place.run(format!("info {}", folder.display())).ok().says(&["rolling shutter"]);

    let dataset = load(&folder);
    assert_eq!((dataset.train.len(), dataset.test.len()), (43, 7));
    let camera = dataset.train[0].camera;
    assert_eq!((camera.width, camera.height), (64, 48));
    assert!(dataset.points.positions.len() > 1000);
}

#[test]
fn options_of_the_demo_that_do_not_fit_are_refused() {
    let place = TestFolder::empty();
    let refused = |line: &str, words: &[&str]| {
        place.run(format!("demo --out @none {line}")).refused(words);
        assert!(!place.has("none"));
    };
    refused("--lens opencv --layout nerf-synthetic --dataset-only", &["--lens", "nerf-synthetic"]);
    refused("--lens fov", &["--lens", "opencv-fisheye"]);
    refused("--lots 12", &["--lots", "city"]);
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
    let place = TestFolder::empty();
    let [nerf, colmap] = ["nerf-synthetic", "colmap"].map(|layout| {
        let kind = format!("--layout {layout} --without-sky --points sparse");
        place.run(format!("demo --out @{layout} --dataset-only --quiet {kind}")).ok();
        load(&place.at(layout).join("dataset"))
    });
    assert_alike(&nerf, &colmap);
}
