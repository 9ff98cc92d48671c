//! `blocks.json`: the division of a scene into blocks, which are trained one by one on any machine and then merged.

pub mod job;
pub mod parts;
pub mod result;
pub mod rounds;

use crate::output;
use ashsplat::scene::{Bounds, Cells, Fingerprint, WorldFrame};
use ashsplat::{Error, Result};
use ashsplat_files::cameras_json::NamedCamera;
use ashsplat_files::{Gallery, regular_file};
use glam::{DVec3, Vec3};
use parts::Part;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Component, Path, PathBuf};

pub const VERSION: u32 = 1;
/// Largest number of blocks: checking more against each other would take long.
pub const MAX_BLOCKS: usize = 4096;
const REMEDY: &str = "make it anew: `ashsplat partition`";

/// A division of a scene. Paths below the file's folder are relative to it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Division {
    pub version: u32,
    pub dataset: DatasetOfBlocks,
    pub coarse: Coarse,
    /// Origin (source coordinates) and unit of the frame in which all blocks are trained.
    pub origin: [f64; 3],
    pub unit: f64,
    /// Extent of the whole scene, source units.
    pub scene_extent: f32,
    /// Margin around a core in which the block's Gaussians are trained too, source units.
    pub margin: f32,
    /// Least share of a picture that a block's core must cover.
    pub min_share: f64,
    /// Largest number of the coarse model's Gaussians in a core.
    pub max_gaussians: u64,
    /// Number of iterations that training the whole scene would take.
    pub iterations: u32,
    /// Number of rounds in which each block is trained, with exchanges between them.
    pub rounds: u32,
    pub blocks: Vec<Block>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DatasetOfBlocks {
    pub path: PathBuf,
    /// Hash of the data set's cameras: see [`cameras_hash`].
    pub cameras: String,
    pub images: String,
    pub resolution: i32,
    pub orientation: String,
    pub undistort: bool,
    pub alpha: String,
    /// Turn of the coarse model's data set.
    pub level: String,
    pub eval: bool,
}

/// The coarse model with which the blocks begin.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Coarse {
    pub path: PathBuf,
    pub hash: String,
    pub gaussians: u64,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Block {
    /// Number of the block, from 1.
    pub number: u32,
    pub core: CoreBox,
    /// Number of the coarse model's Gaussians in the core.
    pub gaussians: u64,
    /// Number of the coarse model's Gaussians in core and margin, with which training begins.
    pub trained: u64,
    pub iterations: u32,
    /// Model folder.
    pub folder: PathBuf,
    pub photos: Vec<String>,
    pub held_out: Vec<String>,
    /// Number of pixels in the used parts of all these photos.
    pub pixels: u64,
    /// The parts of photos that show core and margin, by name; a missing photo is used as a whole.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub parts: BTreeMap<String, Part>,
}

/// A box, source coordinates; null for an unbounded side. It is half-open: least sides belong to it, greatest ones do
/// not.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CoreBox {
    pub min: [Option<f64>; 3],
    pub max: [Option<f64>; 3],
}

impl CoreBox {
    /// The core of a box in the world coordinates of a frame.
    pub fn of(bounds: Bounds, frame: &WorldFrame) -> CoreBox {
        // Converts through the shortest decimal number, so that 0.1 stays 0.1.
        let decimal = |side: f32| side.to_string().parse().unwrap_or(f64::from(side));
        let sides = |corner: Vec3| {
            let source = frame.origin + frame.unit * DVec3::from_array(corner.to_array().map(decimal));
            source.to_array().map(|side| Some(side).filter(|side| side.is_finite()))
        };
        CoreBox { min: sides(bounds.min), max: sides(bounds.max) }
    }

    /// The corners, source coordinates; infinite for unbounded sides.
    pub fn corners(&self) -> [DVec3; 2] {
        let corner = |sides: [Option<f64>; 3], end: f64| DVec3::from_array(sides.map(|s| s.unwrap_or(end)));
        [corner(self.min, f64::NEG_INFINITY), corner(self.max, f64::INFINITY)]
    }

    /// The box in the world coordinates of a frame.
    pub fn bounds(&self, frame: &WorldFrame) -> Bounds {
        let [min, max] = self.corners().map(|corner| frame.world(corner));
        Bounds { min, max }
    }
}

/// The field that every version of the file has.
#[derive(Deserialize)]
struct Versioned {
    version: Option<u64>,
}

/// A `blocks.json` that was read.
#[derive(Clone)]
pub struct BlocksFile {
    pub path: PathBuf,
    pub division: Division,
    /// Hash of the file, by which trained blocks name their division.
    pub hash: String,
}

impl BlocksFile {
    pub fn read(path: &Path) -> Result<BlocksFile> {
        let refuse = |problem: String| Error::input(path, problem, REMEDY);
        let bytes = regular_file::read_json(path)?;
        let no_json = |e: serde_json::Error| refuse(format!("is no list of blocks: {e}"));
        let versioned: Versioned = serde_json::from_slice(&bytes).map_err(no_json)?;
        match versioned.version {
            Some(version) if version == u64::from(VERSION) => {}
            Some(other) => {
                return Err(refuse(format!("is of version {other}, this program reads version {VERSION}")));
            }
            None => return Err(refuse("is no list of blocks: it says no version".into())),
        }
        let division: Division = serde_json::from_slice(&bytes).map_err(no_json)?;
        division.check().map_err(|problem| refuse(problem.to_string()))?;
        let mut print = Fingerprint::new();
        print.add(&bytes);
        Ok(BlocksFile { path: path.to_owned(), division, hash: format!("{:016x}", print.finish()) })
    }

    /// Refuses a replacement by another division once blocks have been trained, because they could not be merged any
    /// more.
    pub fn check_replaced(&self, division: &Division) -> Result<()> {
        let is_trained = |block: &&Block| result::is_noted(&self.at(&block.folder));
        let trained = self.division.blocks.iter().filter(is_trained).count();
        if self.division == *division || trained == 0 {
            return Ok(());
        }
        let problem = format!(
            "is another division, for which {trained} blocks have been trained; it is of {}",
            self.division.differences(division)
        );
        let remedy =
            "give the options that it was made with, or another -o; remove it if those blocks are not needed";
        Err(Error::input(&self.path, problem, remedy))
    }

    /// Refuses a data set with other cameras than the division's. `path` names it in the error.
    pub fn check_cameras(&self, path: &Path, gallery: &Gallery) -> Result<()> {
        if cameras_hash(&gallery.cameras_in(&self.division.frame())) == self.division.dataset.cameras {
            return Ok(());
        }
        let problem = format!("its cameras are not those that {} was made for", self.path.display());
        let remedy = "give the data set as it was, or make the blocks anew: `ashsplat partition`";
        Err(Error::input(path, problem, remedy))
    }

    /// Resolves a path of the file.
    pub fn at(&self, path: &Path) -> PathBuf {
        folder_of(&self.path).join(path)
    }
}

impl Division {
    pub fn frame(&self) -> WorldFrame {
        WorldFrame { origin: DVec3::from_array(self.origin), unit: self.unit }
    }

    /// A block's core and margin in the world coordinates of the frame.
    pub fn core_and_margin(&self, block: &Block) -> (Bounds, f32) {
        (block.core.bounds(&self.frame()), self.margin_in_world())
    }

    /// The margin, world units.
    pub fn margin_in_world(&self) -> f32 {
        (f64::from(self.margin) / self.unit) as f32
    }

    pub fn cells(&self) -> Result<Cells> {
        let frame = self.frame();
        let cores: Vec<Bounds> = self.blocks.iter().map(|block| block.core.bounds(&frame)).collect();
        Cells::of(&cores)
    }

    /// True if blocks use only parts of some photos.
    pub fn uses_parts(&self) -> bool {
        self.blocks.iter().any(|block| !block.parts.is_empty())
    }

    /// Names the options that differ from another division's: "--margin 0.2 (now 0.6)".
    fn differences(&self, other: &Division) -> String {
        let pairs = self.options().into_iter().zip(other.options());
        let differing: Vec<String> = pairs
            .filter(|(own, theirs)| own != theirs)
            .map(|((name, own), (_, theirs))| format!("{name} {own} (now {theirs})"))
            .collect();
        if differing.is_empty() { "other photos or cells".into() } else { differing.join(", ") }
    }

    /// The options that the division was made with, by name.
    fn options(&self) -> [(&'static str, String); 7] {
        [
            ("--margin", self.margin.to_string()),
            ("--photo-parts", if self.uses_parts() { "on" } else { "off" }.to_owned()),
            ("--min-share", self.min_share.to_string()),
            ("--max-gaussians", self.max_gaussians.to_string()),
            ("--iterations", self.iterations.to_string()),
            ("--rounds", self.rounds.to_string()),
            ("--coarse of hash", self.coarse.hash.clone()),
        ]
    }

    /// Refuses an invalid division, such as one with an editing mistake.
    fn check(&self) -> Result<(), String> {
        let numbered = self.blocks.iter().zip(1..).all(|(block, number)| block.number == number);
        let folders: BTreeSet<&Path> = self.blocks.iter().map(|block| block.folder.as_path()).collect();
        if !numbered || self.blocks.is_empty() {
            return Err("its blocks are not numbered from 1".into());
        }
        let below = |folder: &&Path| {
            let mut parts = folder.components().peekable();
            parts.peek().is_some() && parts.all(|part| matches!(part, Component::Normal(_)))
        };
        if folders.len() != self.blocks.len() || !folders.iter().all(below) {
            return Err("its blocks do not have a folder each, below that of the file".into());
        }
        if self.blocks.len() > MAX_BLOCKS {
            return Err(format!("it has {} blocks, more than {MAX_BLOCKS}", self.blocks.len()));
        }
        if !(self.unit.is_finite() && self.unit > 0.0 && self.origin.iter().all(|x| x.is_finite())) {
            return Err(format!("its origin is {:?} and its unit {}", self.origin, self.unit));
        }
        if !(self.margin.is_finite() && self.margin >= 0.0) {
            return Err(format!("its margin is {}, must be 0 or more", self.margin));
        }
        if !(self.scene_extent.is_finite() && self.scene_extent > 0.0) {
            return Err(format!("its scene_extent is {}, must be above 0", self.scene_extent));
        }
        if let Some(block) = self.blocks.iter().find(|block| block.photos.is_empty()) {
            return Err(format!("block {} has no photos to train on", block.number));
        }
        let missing = |block: &Block| {
            let mut parts = block.parts.iter();
            let (name, _) = parts.find(|(_, part)| !part.exists())?;
            Some(format!(
                "the part of {name} for block {} is empty or lies outside of its picture",
                block.number
            ))
        };
        if let Some(problem) = self.blocks.iter().find_map(missing) {
            return Err(problem);
        }
        self.check_rounds()?;
        self.cells().map(drop).map_err(|error| error.to_string())
    }
}

fn folder_of(file: &Path) -> &Path {
    file.parent().unwrap_or(Path::new(""))
}

/// A path for storing in a file: relative if it lies below the file's folder, else absolute.
pub fn stored(path: &Path, file: &Path) -> PathBuf {
    let (path, file) = (output::absolute(path), output::absolute(file));
    match path.strip_prefix(folder_of(&file)) {
        // The folder of the file.
        Ok(below) if below.as_os_str().is_empty() => PathBuf::from("."),
        Ok(below) => below.to_owned(),
        Err(_) => path,
    }
}

/// The hash of a data set's cameras, by name: names, poses, focal lengths, sizes.
pub fn cameras_hash(cameras: &[NamedCamera]) -> String {
    let mut print = Fingerprint::new();
    for NamedCamera { name, camera } in cameras {
        print.add(name.as_bytes());
        print.add_camera(camera);
    }
    format!("{:016x}", print.finish())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cores_come_back_to_the_bit() {
        let (min, max) = (Vec3::new(-0.1, f32::NEG_INFINITY, 2.5), Vec3::new(0.3, 7.25, f32::INFINITY));
        for (frame, start) in [
            (WorldFrame::default(), "[-0.1,null,"),
            (WorldFrame { origin: DVec3::splat(5e6), unit: 1.0 }, "[4999999.9,null,"),
            (WorldFrame { origin: DVec3::ZERO, unit: 0.01 }, "[-0.001,null,"),
        ] {
            let text = serde_json::to_string(&CoreBox::of(Bounds { min, max }, &frame)).expect("JSON");
            assert!(text.contains(start), "{text}");
            let read: CoreBox = serde_json::from_str(&text).expect("a core");
            let read = read.bounds(&frame);
            assert_eq!((read.min, read.max), (min, max));
        }
    }

    #[test]
    fn paths_below_the_file_are_relative() {
        assert_eq!(stored(Path::new("/a/b/c"), Path::new("/a/blocks.json")), Path::new("b/c"));
        let elsewhere = std::path::absolute("/x/c").expect("a path");
        assert_eq!(stored(&elsewhere, Path::new("/a/blocks.json")), elsewhere);
        assert_eq!(stored(Path::new("b"), Path::new("blocks.json")), Path::new("b"));
    }
}
