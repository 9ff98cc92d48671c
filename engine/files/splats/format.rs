//! File formats of Gaussians: names, detection, the origin beside files without a field for it, and unread formats.

use std::fs;
use std::io::{ErrorKind, Read};
use std::path::{Path, PathBuf};

use flate2::read::GzDecoder;
use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::WriteOptions;
use crate::names::{has_photo_ending, quoted};
use crate::{atomic, ply, regular_file};
use ashsplat::{Error, Result};

/// Bound of log-scales in both directions, as in the format's first writer.
pub(crate) const MAX_COMPRESSED_LOG_SCALE: f32 = 20.0;

/// A format of files of Gaussians.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Format {
    /// PLY in the layout of the reference implementation: all parameters as floats.
    #[default]
    Ply,
    /// PlayCanvas' compressed PLY: 16 bytes and a byte for each higher SH value, in chunks of 256.
    CompressedPly,
    /// `.splat`: 32 bytes, no view dependence.
    Splat,
    /// Niantic's SPZ: packed attributes, compressed.
    Spz,
    /// Binary glTF with `KHR_gaussian_splatting`.
    Glb,
    /// glTF as JSON, with `KHR_gaussian_splatting` and a `.bin` beside it.
    Gltf,
    /// PlayCanvas' SOG: attributes as WebP pictures, in a ZIP (`.sog`) or beside their `meta.json`.
    Sog,
    /// OpenUSD's text with prims of `ParticleField3DGaussianSplat`.
    Usda,
    /// `.ksplat` of GaussianSplats3D, which is only read.
    Ksplat,
}

/// The place where a file names the origin of its positions.
#[derive(Clone, Copy, PartialEq)]
enum OriginPlace {
    Comment,
    Node,
    Beside,
}

/// A format's names, and what its files hold.
struct Traits {
    /// The ending of a file's name, with the dot.
    extension: &'static str,
    /// In messages.
    name: &'static str,
    /// The variants that are read and written, for [`Format::description`].
    read: &'static str,
    written: &'static str,
    /// The values that it rounds or cuts; empty if it holds single precision.
    rounded: &'static str,
    max_sh_degree: u32,
    antialiased: bool,
    /// It holds the kernel size, and whether the order is that of distances.
    kernel_size: bool,
    is_2dgs: bool,
    origin: OriginPlace,
}

/// Traits that most formats share.
const USUAL: Traits = Traits {
    extension: "",
    name: "",
    read: "yes",
    written: "yes",
    rounded: "",
    max_sh_degree: 3,
    antialiased: true,
    kernel_size: true,
    is_2dgs: false,
    origin: OriginPlace::Beside,
};

impl Format {
    /// All formats that are written: all but [`Format::Ksplat`], the last.
    pub const WRITTEN: [Self; 8] = {
        let [written @ .., _] = Self::ALL;
        written
    };
    /// All formats.
    pub const ALL: [Self; 9] = [
        Self::Ply,
        Self::CompressedPly,
        Self::Splat,
        Self::Spz,
        Self::Glb,
        Self::Gltf,
        Self::Sog,
        Self::Usda,
        Self::Ksplat,
    ];

    const fn traits(self) -> Traits {
        match self {
            Self::Ply => Traits {
                extension: ".ply",
                name: "PLY",
                read: "any order, encoding and scalar type, also 2DGS and colours in place of SH",
                written: "as the reference implementation",
                is_2dgs: true,
                origin: OriginPlace::Comment,
                ..USUAL
            },
            Self::CompressedPly => Traits {
                extension: ".compressed.ply",
                name: "compressed PLY",
                read: "PlayCanvas', with and without SH and colour ranges",
                rounded: "all values, within chunks of 256",
                is_2dgs: true,
                origin: OriginPlace::Comment,
                ..USUAL
            },
            Self::Splat => Traits {
                extension: ".splat",
                name: ".splat",
                rounded: "colours, opacities and rotations to bytes",
                max_sh_degree: 0,
                antialiased: false,
                kernel_size: false,
                ..USUAL
            },
            Self::Spz => Traits {
                extension: ".spz",
                name: "SPZ",
                read: "versions 2, 3, 4",
                written: "version 4; 2 and 3 with --spz-version",
                rounded: "positions to 24 bits, the rest to bytes",
                kernel_size: false,
                ..USUAL
            },
            Self::Glb => Traits {
                extension: ".glb",
                name: "GLB",
                read: "KHR_gaussian_splatting, also with SPZ inside",
                written: "KHR_gaussian_splatting; SPZ inside with --spz-version 2",
                origin: OriginPlace::Node,
                ..USUAL
            },
            Self::Gltf => Traits {
                extension: ".gltf",
                name: "glTF",
                read: "KHR_gaussian_splatting, also with SPZ inside",
                written: "KHR_gaussian_splatting",
                origin: OriginPlace::Node,
                ..USUAL
            },
            Self::Sog => Traits {
                extension: ".sog",
                name: "SOG",
                read: "versions 1, 2, also the folder of a meta.json, and the finest level of a lod-meta.json",
                written: "version 2; with levels of detail by `ashsplat tiles --sog`",
                rounded: "positions to 16 bits, the rest to bytes and palettes",
                kernel_size: false,
                ..USUAL
            },
            Self::Usda => Traits {
                extension: ".usda",
                name: "USDA",
                read: "ParticleField3DGaussianSplat, not what refers to other files",
                written: "ParticleField3DGaussianSplat",
                rounded: "rotations to unit length, opacities to 0 to 1",
                antialiased: false,
                kernel_size: false,
                origin: OriginPlace::Node,
                ..USUAL
            },
            Self::Ksplat => Traits {
                extension: ".ksplat",
                name: ".ksplat",
                read: "compression levels 0, 1, 2",
                written: "no",
                antialiased: false,
                kernel_size: false,
                ..USUAL
            },
        }
    }

    /// One line: what is read and written, and what a file of the format holds and loses.
    pub fn description(self) -> String {
        let Traits { extension, read, written, rounded, .. } = self.traits();
        let parts = [
            ("Gaussians", true),
            ("spherical harmonics", self.max_sh_degree() > 0),
            ("antialiasing", self.keeps_antialiased()),
            ("kernel size and order", self.traits().kernel_size),
            ("the mark of 2DGS", self.traits().is_2dgs),
        ];
        let names = |held: bool| {
            let names: Vec<&str> = parts.iter().filter(|part| part.1 == held).map(|part| part.0).collect();
            if names.is_empty() { "nothing".to_owned() } else { names.join(", ") }
        };
        let rounds = if rounded.is_empty() { String::new() } else { format!("; rounds {rounded}") };
        let (holds, loses) = (names(true), names(false));
        format!("{extension}: read: {read}; written: {written}; holds {holds}; loses {loses}{rounds}")
    }

    /// Names what Gaussians of this SH degree and with these marks lose in the format.
    pub(crate) fn losses(self, sh_degree: u32, marks: &WriteOptions) -> Vec<String> {
        let WriteOptions { antialiased, kernel_size, distance_order, is_2dgs, .. } = *marks;
        let mut losses = Vec::new();
        if sh_degree > self.max_sh_degree() {
            losses.push(format!("{self} holds no spherical harmonics: the view dependence is lost"));
        }
        if antialiased && !self.keeps_antialiased() {
            losses.push(format!("{self} cannot say that the Gaussians want antialiasing"));
        }
        if let Some(size) = kernel_size.filter(|_| !self.traits().kernel_size) {
            losses.push(format!("{self} cannot hold the kernel size: draw it with --kernel-size {size}"));
        }
        if distance_order && !self.traits().kernel_size {
            losses.push(format!(
                "{self} cannot say that the order is that of distances: draw it with --distance-order"
            ));
        }
        if is_2dgs && !self.traits().is_2dgs {
            losses.push(format!("{self} cannot say that this is a 2DGS scene"));
        }
        losses
    }

    /// True if a file beside it holds the origin of the positions, because the format has no field for it.
    pub(super) fn has_origin_file(self) -> bool {
        self.traits().origin == OriginPlace::Beside
    }

    /// A note on the origin of the positions, if programs that ignore it would place the scene elsewhere.
    pub(crate) fn origin_note(self, path: &Path, origin: DVec3) -> Option<String> {
        let DVec3 { x, y, z } = origin;
        let place = match self.traits().origin {
            _ if origin == DVec3::ZERO => return None,
            OriginPlace::Node => return None,
            OriginPlace::Comment => "a comment in its header".to_owned(),
            OriginPlace::Beside => origin_path(path).display().to_string(),
        };
        Some(format!("positions are relative to {x},{y},{z}, which {place} names"))
    }

    /// The extension of a file's name, with the dot.
    pub fn extension(self) -> &'static str {
        self.traits().extension
    }

    /// The highest SH degree that the format can hold.
    pub fn max_sh_degree(self) -> u32 {
        self.traits().max_sh_degree
    }

    /// True if the format can mark Gaussians as trained with antialiasing.
    pub fn keeps_antialiased(self) -> bool {
        self.traits().antialiased
    }

    /// The format by a file's name.
    pub fn of_extension(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        Self::by_name(path)
            .ok_or_else(|| Error::input(path, "has no extension of a known format", one_of_the_written()))
    }

    /// The requested format, or that of a file's name, if it is written.
    pub(super) fn chosen(requested: Option<Self>, path: &Path) -> Result<Self> {
        let format = requested.map_or_else(|| Self::of_extension(path), Ok)?;
        match Self::WRITTEN.contains(&format) {
            true => Ok(format),
            false => Err(Error::input(path, format!("{format} is not written"), one_of_the_written())),
        }
    }

    fn by_name(path: &Path) -> Option<Self> {
        let name = path.file_name()?.to_string_lossy().to_ascii_lowercase();
        // The longest of several matching extensions counts.
        Self::ALL.into_iter().filter(|f| name.ends_with(f.extension())).max_by_key(|f| f.extension().len())
    }
}

fn one_of_the_written() -> String {
    format!("give it one of {}", Format::WRITTEN.map(Format::extension).join(" "))
}

impl std::fmt::Display for Format {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.traits().name)
    }
}

impl Format {
    /// The format of a file by its first bytes, or by its name if they are ambiguous.
    pub fn of_file(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        let start = regular_file::start(path, MAGIC_BYTES)?;
        if let Some(error) = foreign(path) {
            return Err(error);
        }
        let by_name = Self::by_name(path);
        let by_content = match start.as_slice() {
            [b'p', b'l', b'y', b'\n' | b'\r', ..] => {
                Some(if ply::is_compressed(path)? { Self::CompressedPly } else { Self::Ply })
            }
            [b'N', b'G', b'S', b'P', ..] => Some(Self::Spz),
            [b'g', b'l', b'T', b'F', ..] => Some(Self::Glb),
            [b'#', b'u', b's', b'd', b'a', b' ', ..] => Some(Self::Usda),
            [0x1f, 0x8b, ..] if by_name.is_none() => Some(Self::Spz),
            _ if is_sog(path) => Some(Self::Sog),
            _ => None,
        };
        by_content.or(by_name).ok_or_else(|| {
            let known = format!("known are {}", Self::ALL.map(Self::extension).join(" "));
            let unknown = ("is no file of Gaussians that is known", &*known);
            let (problem, remedy) = regular_file::recognise(&start).unwrap_or(unknown);
            Error::input(path, problem, remedy)
        })
    }
}

/// Farthest origin, source units: the square of a coordinate must not overflow in single precision.
pub(crate) const FARTHEST: f64 = 1e18;
/// Largest such file, bytes.
const MAX_BYTES: u64 = 4096;

#[derive(Serialize, Deserialize)]
struct OriginJson {
    origin: [f64; 3],
}

fn origin_path(path: &Path) -> PathBuf {
    let mut name = path.file_name().unwrap_or_default().to_owned();
    name.push(".origin.json");
    path.with_file_name(name)
}

/// Reads the origin of a file's positions; zero without such a file.
pub(super) fn read_origin(path: &Path) -> Result<DVec3> {
    let path = origin_path(path);
    if !path.is_file() {
        return Ok(DVec3::ZERO);
    }
    let text = regular_file::read_at_most(&path, MAX_BYTES)?.unwrap_or_default();
    let json = serde_json::from_slice::<OriginJson>(&text).map_err(|e| e.to_string());
    let origin = json.and_then(|json| match DVec3::from_array(json.origin) {
        origin if origin.abs().max_element() <= FARTHEST => Ok(origin),
        _ => Err(format!("it may be up to {FARTHEST:e}")),
    });
    origin.map_err(|problem| {
        let remedy = "expected {\"origin\": [x, y, z]}; remove the file if positions are absolute";
        Error::input(&path, format!("is no origin: {problem}"), remedy)
    })
}

/// Writes the origin of a newly written file. A zero origin removes an earlier origin file.
pub(crate) fn write_origin(path: &Path, origin: DVec3) -> Result<()> {
    let beside = origin_path(path);
    if origin == DVec3::ZERO {
        return match fs::remove_file(&beside) {
            Err(e) if e.kind() != ErrorKind::NotFound => Err(Error::io(&beside, "remove", e)),
            _ => Ok(()),
        };
    }
    let json = OriginJson { origin: origin.to_array() };
    let written = atomic::write(&beside, |writer| Ok(serde_json::to_writer(writer, &json)?));
    // Positions without their origin would be silently wrong, so the scene is removed too.
    written.inspect_err(|_| drop(fs::remove_file(path)))
}

/// Number of bytes that tell binary formats apart.
const MAGIC_BYTES: u64 = 512;

/// Number of bytes of a JSON file that are searched.
const SEARCHED_BYTES: u64 = 64 * 1024;

/// Compression formats of single files: first bytes, name, and the command that unpacks to the standard output.
const PACKERS: [(&[u8], &str, &str); 5] = [
    (b"\x1f\x8b", "gzip", "gzip -dc"),
    (b"\x28\xb5\x2f\xfd", "zstd", "zstd -dc"),
    (b"BZh", "bzip2", "bzip2 -dc"),
    (b"\xfd7zXZ\0", "xz", "xz -dc"),
    (b"\x04\x22\x4d\x18", "lz4", "lz4 -dc"),
];

/// Archive formats other than ZIP: offset, first bytes, name and command.
const ARCHIVERS: [(usize, &[u8], &str, &str); 3] = [
    (0, b"7z\xbc\xaf\x27\x1c", "a 7z archive", "7z x"),
    (0, b"Rar!\x1a\x07", "a RAR archive", "unrar x"),
    (257, b"ustar", "a tar archive", "tar -xf"),
];

/// Extensions of scenes that other programs can convert.
const CONVERTED: [(&str, &str, &str); 5] = [
    ("usdc", "is binary USD", "usdcat"),
    ("lcc", "is an LCC scene of XGRIDS", "splat-transform --select-lod 0"),
    ("lcc2", "is an LCC scene of XGRIDS", "splat-transform --select-lod 0"),
    ("spx", "is an SPX scene", "gsbox spx2ply"),
    ("sogst", "is an animated SOG", ""),
];

/// The error for a file or folder with a scene in an unread format; `None` for anything else.
pub fn foreign(path: &Path) -> Option<Error> {
    if path.is_dir() {
        return None;
    }
    let start = regular_file::start(path, MAGIC_BYTES).ok()?;
    if start.starts_with(b"PK\x03\x04") {
        return zip(path);
    }
    if start.starts_with(b"spx") && start.get(3).is_some_and(|version| *version < 32) {
        return converted(path, "spx");
    }
    let by_name = Format::by_name(path);
    if let Some((_, name, command)) = PACKERS.iter().find(|(magic, ..)| start.starts_with(magic)) {
        let mut inside = [0; 4];
        // SPZ is gzip itself.
        let is_spz = GzDecoder::new(&*start).read_exact(&mut inside).is_err() || inside == *b"NGSP";
        if *name == "gzip" && (is_spz || by_name == Some(Format::Spz)) {
            return None;
        }
        let stem = path.file_stem().map(Path::new).filter(|_| by_name.is_none());
        let out = stem.map_or(path.with_file_name("unpacked.ply"), |stem| path.with_file_name(stem));
        let remedy = format!("unpack it: `{command} {} > {}`", shell(path), shell(&out));
        return Some(Error::input(path, format!("is packed with {name}"), remedy));
    }
    let is = |(at, magic): (usize, &[u8])| start.get(at..).is_some_and(|start| start.starts_with(magic));
    if let Some((.., what, command)) = ARCHIVERS.iter().find(|(at, magic, ..)| is((*at, magic))) {
        let remedy = format!("unpack it: `{command} {}`", shell(path));
        return Some(Error::input(path, format!("is {what}"), remedy));
    }
    match by_name {
        Some(_) => None,
        None if start.trim_ascii_start().starts_with(b"{") => json(path).or_else(|| by_ending(path)),
        None => by_ending(path),
    }
}

fn by_ending(path: &Path) -> Option<Error> {
    converted(path, &path.extension()?.to_str()?.to_ascii_lowercase())
}

/// The error for a scene with this extension.
fn converted(path: &Path, ending: &str) -> Option<Error> {
    let (_, problem, command) = CONVERTED.iter().find(|(known, ..)| *known == ending)?;
    let (input, out) = (shell(path), shell(&path.with_extension("ply")));
    let remedy = match *command {
        "" => "export one moment of it as a PLY".to_owned(),
        "usdcat" => format!("make its text: `usdcat {input} -o {}`", shell(&path.with_extension("usda"))),
        "gsbox spx2ply" => format!("make a PLY of it: `{command} -i {input} -o {out}`"),
        command => format!("make a PLY of it: `{command} {input} {out}`"),
    };
    Some(Error::input(path, format!("{problem}, which is not read"), remedy))
}

/// The error for the description of a SOG under another name.
fn json(path: &Path) -> Option<Error> {
    let text = start_of_text(path)?;
    let describes_sog = text.contains("\"means\"") && text.contains(".webp\"");
    (describes_sog && !is_meta(path))
        .then(|| Error::input(path, "describes a SOG under another name", "name it meta.json"))
}

fn start_of_text(path: &Path) -> Option<String> {
    regular_file::start(path, SEARCHED_BYTES).ok().map(|text| String::from_utf8_lossy(&text).into_owned())
}

/// Name of the description of a SOG, in the ZIP or in the folder.
pub(super) const META: &str = "meta.json";
/// Name of the description of a streamed SOG.
pub(crate) const LOD_META: &str = "lod-meta.json";

pub(super) fn is_meta(path: &Path) -> bool {
    path.file_name().is_some_and(|name| name.eq_ignore_ascii_case(META))
}

pub(super) fn is_lod_meta(path: &Path) -> bool {
    path.file_name().is_some_and(|name| name.eq_ignore_ascii_case(LOD_META))
}

/// True for a SOG: its ZIP, its `meta.json`, the `lod-meta.json` of a streamed one, or the folder of either.
pub fn is_sog(path: &Path) -> bool {
    if path.is_dir() {
        return sog_in(path).is_some();
    }
    if is_lod_meta(path) {
        return start_of_text(path).is_some_and(|text| text.contains("\"lodLevels\""));
    }
    if is_meta(path) {
        return start_of_text(path)
            .is_some_and(|text| text.contains("\"means\"") && text.contains(".webp\""));
    }
    names_in_zip(path).is_some_and(|names| {
        let has = |file: &str| names.iter().any(|name| name.rsplit('/').next() == Some(file));
        has(META) && (has("means_l.webp") || Format::by_name(path) == Some(Format::Sog))
    })
}

/// The description of a SOG in a folder. A model folder or a data set may hold one besides, and is none.
pub(super) fn sog_in(folder: &Path) -> Option<PathBuf> {
    let others = ["point_cloud", "sparse", "transforms.json", "transforms_train.json"];
    if !folder.is_dir() || others.iter().any(|name| folder.join(name).exists()) {
        return None;
    }
    [META, LOD_META].map(|name| folder.join(name)).into_iter().find(|path| is_sog(path))
}

/// `None` for no ZIP: without its first bytes, the file is not searched for a directory.
fn names_in_zip(path: &Path) -> Option<Vec<String>> {
    regular_file::start(path, MAGIC_BYTES).ok().filter(|start| start.starts_with(b"PK\x03\x04"))?;
    let archive = zip::ZipArchive::new(std::io::BufReader::new(regular_file::open(path).ok()?.0)).ok()?;
    Some(archive.file_names().flatten().map(|name| name.into_owned()).collect())
}

/// The error for a ZIP that does not hold a data set.
fn zip(path: &Path) -> Option<Error> {
    let names = names_in_zip(path)?;
    let with = |endings: &[&str]| {
        let fits = |name: &&String| endings.iter().any(|ending| name.to_ascii_lowercase().ends_with(ending));
        names.iter().find(fits)
    };
    if by_ending(path).is_some() || is_sog(path) {
        return by_ending(path);
    }
    let export = "export a PLY with the program that wrote it";
    if with(&["data.pkl"]).is_some() {
        return Some(Error::input(path, "is a checkpoint of PyTorch", export));
    }
    if with(&[".usda", ".usdc", ".usd"]).is_some() {
        return Some(Error::input(path, "is a USDZ, which is not read", export));
    }
    let is_data_set = with(&["transforms.json", "cameras.bin", "cameras.txt"]).is_some()
        || names.iter().any(|name| has_photo_ending(Path::new(name)));
    let scene = with(&[".ply", ".splat", ".spz", ".glb", ".ksplat", ".sog"]).filter(|_| !is_data_set)?;
    let remedy = format!("unpack it: `unzip {} {}`, and give that file", shell(path), quoted(scene));
    Some(Error::input(path, format!("is a ZIP with a scene, {scene}"), remedy))
}

fn shell(path: &Path) -> String {
    quoted(&path.to_string_lossy())
}
