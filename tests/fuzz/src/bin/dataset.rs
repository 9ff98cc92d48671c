//! Arbitrary bytes as a transforms.json, a cameras.json, the ZIP of a data set, an exposure.json, a lens.json, a
//! depth_params.json or a tileset.json; or as a value that a list in the JSON repeats up to 8 MiB.
#![no_main]

use ashsplat::scene::WorldFrame;
use ashsplat_files::depth_fit::DepthFit;
use ashsplat_files::lens_json::LensFile;
use ashsplat_files::tiles::Tree;
use ashsplat_files::transforms::{self, Transforms};
use ashsplat_files::{
    Dataset, DatasetOptions, Gallery, HostMemory, Photo, PhotoFileFormat, Progress, cameras_json, exposure_json,
};
use ashsplat_fuzz::{folder, in_one_line, leave_seed, within};
use libfuzzer_sys::fuzz_target;
use std::path::PathBuf;
use std::sync::LazyLock;

static FOLDER: LazyLock<PathBuf> = LazyLock::new(|| folder("dataset"));

const TRANSFORMS: &str = r#"{"fl_x": 9.5, "w": 4, "h": 3, "k1": 0.01, "frames": [{"file_path": "a.png",
 "transform_matrix": [[1,0,0,0],[0,1,0,0],[0,0,1,2],[0,0,0,1]]}]}"#;
const CAMERAS: &str = r#"[{"id": 0, "img_name": "a.png", "width": 4, "height": 3, "position": [0,0,1],
 "rotation": [[1,0,0],[0,1,0],[0,0,1]], "fx": 4.0, "fy": 4.0}]"#;

const TILES: &str = r#"{"root": {"refine": "REPLACE", "geometricError": 1, "boundingVolume": {"box": [0,0,0,1,0,0,0,1,0,0,0,1]},
 "content": {"uri": "a.spz"}, "extras": {"gaussians": 1}, "children": []}}"#;
const EXPOSURES: &str = r#"{"a.png": [[1.5,0,0,0],[0,1,0,0.25],[0,0,1,0]]}"#;
const LENSES: &str = r#"{"cameras": {"1": {"vignetting": [[0.1,0,0],[0,-0.2,0],[0,0,0]], "response": [1,1.1,0.9]}},
 "photos": {"a.png": 1}}"#;
const DEPTHS: &str = r#"{"a": {"scale": 1.5, "offset": -0.25}}"#;

/// Writes a valid file of each kind, and the photo that they name.
fn seeds() {
    let photo = FOLDER.join("a.png");
    Photo { width: 4, height: 3, rgb: vec![9; 36] }.write_png(&photo).expect("a photo");
    leave_seed("transforms", &[&[0], TRANSFORMS.as_bytes()].concat());
    leave_seed("tiles", &[&[6], TILES.as_bytes()].concat());
    leave_seed("long transforms", &[128 + 5, b'[', b']']);
    leave_seed("long tiles", &[128 + 4, b'[', b']']);
    leave_seed("cameras", &[&[1], CAMERAS.as_bytes()].concat());
    leave_seed("exposures", &[&[3], EXPOSURES.as_bytes()].concat());
    leave_seed("lenses", &[&[5], LENSES.as_bytes()].concat());
    leave_seed("depth parameters", &[&[4], DEPTHS.as_bytes()].concat());
    let mut zip = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    let stored = zip::write::SimpleFileOptions::default().compression_method(zip::CompressionMethod::Stored);
    let photo = std::fs::read(photo).expect("there");
    for (name, bytes) in [("transforms.json", TRANSFORMS.as_bytes()), ("a.png", &photo)] {
        zip.start_file(name, stored).expect("an entry");
        std::io::Write::write_all(&mut zip, bytes).expect("packed");
    }
    let archive = zip.finish().expect("an archive").into_inner();
    leave_seed("archive", &[&[2], &archive[..]].concat());
}

/// Length of a file with a repeated value, bytes.
const LONG: usize = 8 << 20;

/// A valid file with a list that repeats a value.
fn repeated(valid: &str, value: &[u8]) -> Vec<u8> {
    let element = [value, b","].concat();
    let list = element.repeat(LONG / element.len());
    [b"{\"list\": [", &list[..], b"0],", &valid.as_bytes()[1..]].concat()
}

fuzz_target!(init: seeds(), |data: &[u8]| {
    let [kind, bytes @ ..] = data else { return };
    let names = ["transforms.json", "cameras.json", "archive.zip", "exposure.json", "depth_params.json", "lens.json", "tileset.json"];
    let name = names[usize::from(*kind) % names.len()];
    let path = FOLDER.join(name);
    let repeated = match name {
        "transforms.json" if *kind >= 128 => Some(repeated(TRANSFORMS, bytes)),
        "tileset.json" if *kind >= 128 => Some(repeated(TILES, bytes)),
        _ => None,
    };
    let bytes = repeated.as_deref().unwrap_or(bytes);
    std::fs::write(&path, bytes).expect("written");
    within(bytes.len(), |bound| {
        let options = DatasetOptions { host_memory: HostMemory::new(bound), ..DatasetOptions::default() };
        match name {
            "cameras.json" => drop(in_one_line(cameras_json::read(&path, &WorldFrame::default()))),
            "exposure.json" => {
                if let Some(all) = in_one_line(exposure_json::read(&path)) {
                    exposure_json::write(&path, all.iter().map(|(name, e)| (&**name, e))).expect("written");
                    assert_eq!(exposure_json::read(&path).expect("its own"), all);
                }
            }
            "tileset.json" => drop(in_one_line(Tree::open(&*FOLDER))),
            "lens.json" => drop(in_one_line(LensFile::read(&path))),
            "depth_params.json" => drop(in_one_line(DepthFit::read_all(&path))),
            "archive.zip" => drop(in_one_line(Gallery::open(&path, &options, Progress::NONE))),
            _ => {
                let files = transforms::find(&FOLDER).expect("it is there");
                if in_one_line(Transforms::read(&files)).is_some() {
                    in_one_line(Dataset::load(&*FOLDER, &options, Progress::default()));
                }
            }
        }
    });
});
