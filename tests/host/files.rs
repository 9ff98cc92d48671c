//! Helpers of the tests that write files and data sets.

use ashsplat::scene::{Camera, PointCloud, WorldFrame};
use ashsplat_files::colmap::{self, ColmapCamera, ColmapImage};
use ashsplat_files::{Dataset, DatasetOptions, DatasetReport, Photo, PhotoFileFormat, Progress, View, ply};
use image::{DynamicImage, GrayImage, Luma};
use serde_json::Value;
use std::ops::Deref;
use std::path::{Path, PathBuf};

pub use crate::common::assert_says;
use crate::common::scenes::Random;

pub struct Folder(tempfile::TempDir);

impl Folder {
    pub fn new() -> Folder {
        Folder(tempfile::tempdir().unwrap())
    }

    /// A folder, and the path of a file in it.
    pub fn with(name: &str) -> (Folder, PathBuf) {
        let folder = Folder::new();
        let path = folder.join(name);
        (folder, path)
    }

    /// Writes a file, and creates the folders above it.
    pub fn put(&self, name: &str, contents: impl AsRef<[u8]>) -> PathBuf {
        let path = self.join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(&path, contents).unwrap();
        path
    }

    pub fn bytes(&self, name: &str) -> Vec<u8> {
        std::fs::read(self.join(name)).unwrap()
    }

    pub fn remove(&self, name: &str) {
        std::fs::remove_file(self.join(name)).unwrap();
    }
}

impl Deref for Folder {
    type Target = Path;

    fn deref(&self) -> &Path {
        self.0.path()
    }
}

impl AsRef<Path> for Folder {
    fn as_ref(&self) -> &Path {
        self
    }
}

/// The error's text, which begins with the path and is one line.
#[track_caller]
pub fn refusal<T>(path: &Path, result: ashsplat::Result<T>) -> String {
    let message = result.err().expect("refused").to_string();
    assert!(message.starts_with(path.to_str().unwrap()) && !message.contains('\n'), "{message}");
    message
}

/// Fails unless there is one line, and it has all of these words.
#[track_caller]
pub fn assert_one(lines: &[String], words: &[&str]) {
    assert_eq!(lines.len(), 1, "{lines:?}");
    assert_says(&lines[0], words);
}

/// Fails unless one of the lines has all of these words.
#[track_caller]
pub fn assert_some(lines: &[String], words: &[&str]) {
    let has_all = |line: &String| words.iter().all(|word| line.contains(word));
    assert!(lines.iter().any(has_all), "no {words:?} in: {lines:?}");
}

pub fn names(folder: &Path) -> Vec<String> {
    let entry = |entry: std::io::Result<std::fs::DirEntry>| entry.unwrap().file_name().into_string().unwrap();
    let mut names: Vec<String> = std::fs::read_dir(folder).unwrap().map(entry).collect();
    names.sort();
    names
}

/// Cuts `bytes` at each of their [`places`], writes the file and calls `check` with the length.
pub fn for_each_truncation(path: &Path, bytes: &[u8], mut check: impl FnMut(usize)) {
    for length in places(bytes) {
        replace(path, &bytes[..length]);
        check(length);
    }
}

/// Replaces the byte at each of the [`places`] by three of eight others in turn, and damages the file at random: a short
/// form of tests/fuzz. Writes each file and calls `check`.
pub fn for_each_mutation(path: &Path, bytes: &[u8], mut check: impl FnMut()) {
    let mut mutated = bytes.to_vec();
    for (turn, place) in places(bytes).enumerate() {
        let changes = [0x00, 0xff, 0x7f, b'9', b' ', b'\n', bytes[place] ^ 1, bytes[place] ^ 0x80];
        for at in 3 * turn..3 * turn + 3 {
            mutated[place] = changes[at % 8];
            replace(path, &mutated);
            check();
        }
        mutated[place] = bytes[place];
    }
    let mut random = Random::new(bytes.len() as u64);
    for _ in 0..400 {
        replace(path, &damage(bytes, &mut random));
        check();
    }
}

/// Numbers that break readers.
const NUMBERS: [&str; 8] =
    ["0", "-1", "4294967295", "18446744073709551615", "1e30", "nan", "65536", "2147483648"];

fn damage(bytes: &[u8], random: &mut Random) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    for _ in 0..=random.below(3) {
        let at = random.below(bytes.len().max(1) as u32) as usize;
        match random.below(6) {
            0 => bytes.truncate(at),
            1 if !bytes.is_empty() => bytes[at] = random.bits() as u8,
            2 if !bytes.is_empty() => bytes[at] ^= 1 << random.below(8),
            3 => drop(bytes.splice(at..at, NUMBERS[random.below(8) as usize].bytes())),
            4 => {
                let end = (at + random.below(40) as usize).min(bytes.len());
                bytes.drain(at.min(end)..end);
            }
            _ => {
                let end = (at + 8).min(bytes.len());
                bytes[at.min(end)..end].fill(0xFF);
            }
        }
    }
    bytes
}

/// Places to cut or change a file: all near its beginning and end, every ninth byte between.
fn places(bytes: &[u8]) -> impl Iterator<Item = usize> + use<> {
    let (begin, end) = (384, bytes.len().saturating_sub(64));
    (0..bytes.len()).filter(move |place| *place < begin || *place >= end || place % 9 == 0)
}

fn replace(path: &Path, bytes: &[u8]) {
    let _ = std::fs::remove_file(path);
    std::fs::write(path, bytes).unwrap();
}

// ---- data sets ----

impl Folder {
    pub fn picture(&self, name: &str, [width, height]: [u32; 2], grey: u8) {
        let rgb = vec![grey; 3 * (width * height) as usize];
        Photo { width, height, rgb }.write_png(self.put(name, "")).unwrap();
    }

    pub fn photo(&self, name: &str, grey: u8) {
        self.picture(name, [20, 12], grey);
    }

    pub fn save(&self, name: &str, picture: impl Into<DynamicImage>) {
        picture.into().save(self.put(name, "")).unwrap();
    }

    pub fn json(&self, name: &str, value: &Value) {
        self.put(name, value.to_string());
    }

    pub fn model(&self, images: &[(u32, &str, Camera)], points: &PointCloud) {
        let lens = images.iter().map(|(.., camera)| ColmapCamera::pinhole(1, camera)).take(1);
        let posed = |(id, name, camera): &(u32, &str, Camera)| ColmapImage::posed(*id, 1, *name, camera);
        let images: Vec<ColmapImage> = images.iter().map(posed).collect();
        colmap::write(self.join("sparse/0"), &lens.collect::<Vec<_>>(), &images, points).unwrap();
    }

    pub fn points(&self, name: &str, points: &PointCloud) {
        ply::write_points(self.join(name), points, &WorldFrame::default()).unwrap();
    }

    pub fn inspect(&self, options: &DatasetOptions) -> DatasetReport {
        Dataset::inspect(self, options, Progress::NONE)
    }

    pub fn try_load(&self, options: &DatasetOptions) -> Result<Dataset, String> {
        Dataset::load(self, options, Progress::NONE).map_err(|error| error.to_string())
    }

    pub fn load_with(&self, options: &DatasetOptions) -> Dataset {
        self.try_load(options).unwrap()
    }

    pub fn load(&self) -> Dataset {
        self.load_with(&DatasetOptions::default())
    }

    pub fn refusal(&self) -> String {
        self.try_load(&DatasetOptions::default()).unwrap_err()
    }

    pub fn warnings(&self, word: &str) -> Vec<String> {
        let mut lines = self.load().warnings;
        lines.retain(|line| line.contains(word));
        lines
    }
}

pub fn cloud(positions: &[[f32; 3]], color: [u8; 3]) -> PointCloud {
    PointCloud { positions: positions.to_vec(), colors: vec![color; positions.len()] }
}

/// A mask of 20×12 pixels that shows the left half.
pub fn left_half() -> GrayImage {
    GrayImage::from_fn(20, 12, |x, _| Luma([if x < 10 { 255 } else { 0 }]))
}

/// A JSON object with the entries of another.
pub fn with(mut object: Value, entries: &Value) -> Value {
    object.as_object_mut().unwrap().extend(entries.as_object().unwrap().clone());
    object
}

/// First grey of each training photograph.
pub fn greys(dataset: &Dataset) -> Vec<u8> {
    dataset.train.iter().map(|view| view.photo.photo().unwrap().rgb[0]).collect()
}

pub fn named(views: &[View]) -> Vec<&str> {
    views.iter().map(|view| view.name.as_str()).collect()
}
