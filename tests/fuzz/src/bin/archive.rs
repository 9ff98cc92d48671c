//! ZIPs of data sets: valid ones with hostile contents and names, and false directories.
#![no_main]

use arbitrary::Arbitrary;
use ashsplat_files::{Dataset, DatasetOptions, Gallery, HostMemory, Photo, PhotoFileFormat, Progress};
use ashsplat_fuzz::hostile::{Change, Filling, MAX_BYTES, Number, Patch, patch, spoil};
use ashsplat_fuzz::{folder, in_one_line, within};
use libfuzzer_sys::fuzz_target;
use serde_json::json;
use std::io::{Cursor, Write};
use std::path::PathBuf;
use std::sync::LazyLock;
use zip::write::SimpleFileOptions;

static FOLDER: LazyLock<PathBuf> = LazyLock::new(|| folder("archive"));
static PHOTO: LazyLock<Vec<u8>> = LazyLock::new(|| {
    let path = FOLDER.join("a.png");
    Photo { width: 4, height: 3, rgb: vec![9; 36] }.write_png(&path).expect("a photo");
    std::fs::read(path).expect("there")
});

const NAMES: [&str; 16] = [
    "transforms.json",
    "a.png",
    "images/a.png",
    "images/a.jpg",
    "sparse/0/cameras.bin",
    "sparse/0/images.bin",
    "sparse/0/points3D.bin",
    "sparse/0/cameras.txt",
    "points3D.ply",
    "transforms_train.json",
    "images/",
    "../a.png",
    "/a.png",
    "a/b/c/d/e/transforms.json",
    "IMAGES\\a.png",
    "__MACOSX/a.png",
];

#[derive(Arbitrary, Debug)]
enum Content {
    Transforms(Vec<Change>),
    Photo(Vec<Patch>),
    Filling(Filling),
    Cameras { count: Number, model: u8, side: Number },
    Images { count: Number, points: Number },
    Points { count: Number, track: Number },
    Text(u8),
}

#[derive(Arbitrary, Debug)]
struct Archive {
    entries: Vec<(u8, Content, bool)>,
    patches: Vec<Patch>,
}

impl Content {
    fn bytes(&self) -> Vec<u8> {
        match self {
            Self::Transforms(changes) => {
                let mut json = json!({"fl_x": 9.5, "w": 4, "h": 3, "k1": 0, "frames": [{"file_path": "a.png",
                    "transform_matrix": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 2], [0, 0, 0, 1]]}]});
                spoil(&mut json, changes);
                json.to_string().into_bytes()
            }
            Self::Photo(patches) => {
                let mut photo = PHOTO.clone();
                patch(&mut photo, patches);
                photo
            }
            Self::Filling(filling) => filling.bytes(MAX_BYTES),
            Self::Cameras { count, model, side } => {
                let mut bytes = count.of(1).to_le_bytes().to_vec();
                bytes.extend(1u32.to_le_bytes());
                bytes.extend(u32::from(model % 13).to_le_bytes());
                bytes.extend(side.of(4).to_le_bytes());
                bytes.extend(3u64.to_le_bytes());
                bytes
                    .extend([5.0f64, 5.0, 2.0, 1.5, 0.1, 0.0, 0.0, 0.0].iter().flat_map(|x| x.to_le_bytes()));
                bytes
            }
            Self::Images { count, points } => {
                let mut bytes = count.of(1).to_le_bytes().to_vec();
                bytes.extend(1u32.to_le_bytes());
                bytes.extend([1.0f64, 0.0, 0.0, 0.0, 0.0, 0.0, 4.0].iter().flat_map(|x| x.to_le_bytes()));
                bytes.extend(1u32.to_le_bytes());
                bytes.extend(b"a.png\0");
                bytes.extend(points.of(0).to_le_bytes());
                bytes
            }
            Self::Points { count, track } => {
                let mut bytes = count.of(1).to_le_bytes().to_vec();
                bytes.extend(1u64.to_le_bytes());
                bytes.extend([0; 24]);
                bytes.extend([1, 2, 3]);
                bytes.extend(0.5f64.to_le_bytes());
                bytes.extend(track.of(0).to_le_bytes());
                bytes
            }
            Self::Text(kind) => match kind % 3 {
                0 => b"1 PINHOLE 4 3 5 5 2 1.5\n".to_vec(),
                1 => b"1 1 0 0 0 0 0 4 1 a.png\n\n".to_vec(),
                _ => b"1 0 0 0 1 2 3 0.5 1 0\n".to_vec(),
            },
        }
    }
}

impl Archive {
    fn file(&self) -> Vec<u8> {
        let mut zip = zip::ZipWriter::new(Cursor::new(Vec::new()));
        for (name, content, stored) in self.entries.iter().take(24) {
            let method = match stored {
                true => zip::CompressionMethod::Stored,
                false => zip::CompressionMethod::Deflated,
            };
            let options = SimpleFileOptions::default().compression_method(method);
            // The writer refuses duplicate names.
            if zip.start_file(NAMES[usize::from(*name) % NAMES.len()], options).is_ok() {
                zip.write_all(&content.bytes()).expect("packed");
            }
        }
        let mut file = zip.finish().expect("an archive").into_inner();
        patch(&mut file, &self.patches);
        file
    }
}

fuzz_target!(|archive: Archive| {
    let bytes = archive.file();
    let path = FOLDER.join("archive.zip");
    std::fs::write(&path, &bytes).expect("written");
    within(bytes.len(), |bound| {
        let options = DatasetOptions { host_memory: HostMemory::new(bound), ..DatasetOptions::default() };
        in_one_line(Gallery::open(&path, &options, Progress::NONE));
        in_one_line(Dataset::load(&path, &options, Progress::default()));
    });
});
