//! Recognises scenes in formats that are not read, and names the command that converts them.

use std::io::Read;
use std::path::Path;

use flate2::read::GzDecoder;

use super::format::Format;
use crate::names::{has_photo_ending, quoted};
use crate::regular_file;
use ashsplat::{Error, Result};

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
const CONVERTED: [(&str, &str, &str); 6] = [
    ("sog", "is a SOG", "splat-transform"),
    ("ksplat", "is a .ksplat of GaussianSplats3D", "splat-transform"),
    ("lcc", "is an LCC scene of XGRIDS", "splat-transform --select-lod 0"),
    ("lcc2", "is an LCC scene of XGRIDS", "splat-transform --select-lod 0"),
    ("spx", "is an SPX scene", "gsbox spx2ply"),
    ("sogst", "is an animated SOG", ""),
];

/// First bytes of a file.
pub(super) fn first_bytes(path: &Path) -> Result<Vec<u8>> {
    let (file, _) = regular_file::open(path)?;
    let mut start = Vec::new();
    file.take(512).read_to_end(&mut start).map_err(|source| Error::io(path, "read", source))?;
    Ok(start)
}

/// The error for a file or folder with a scene in an unread format; `None` for anything else.
pub fn foreign(path: &Path) -> Option<Error> {
    if path.is_dir() {
        return ["meta.json", "lod-meta.json"].iter().find_map(|name| json(&path.join(name)));
    }
    let start = first_bytes(path).ok()?;
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
        return Some(Error::input(
            path,
            format!("is {what}"),
            format!("unpack it: `{command} {}`", shell(path)),
        ));
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
        "gsbox spx2ply" => format!("make a PLY of it: `{command} -i {input} -o {out}`"),
        command => format!("make a PLY of it: `{command} {input} {out}`"),
    };
    Some(Error::input(path, format!("{problem}, which is not read"), remedy))
}

/// The error for the JSON of a SOG without its ZIP.
fn json(path: &Path) -> Option<Error> {
    let mut text = Vec::new();
    regular_file::open(path).ok()?.0.take(SEARCHED_BYTES).read_to_end(&mut text).ok()?;
    let text = String::from_utf8_lossy(&text);
    let out = path.with_file_name("scene.ply");
    let is_streamed = path.file_name().is_some_and(|name| name == "lod-meta.json");
    let (what, level) = match is_streamed {
        true => ("a streamed SOG", "--select-lod 0 "),
        false => ("a SOG without its ZIP", ""),
    };
    let is_sog = is_streamed && text.contains("\"lodLevels\"")
        || text.contains("\"means\"") && text.contains(".webp\"");
    is_sog.then(|| {
        let remedy = format!("make a PLY of it: `splat-transform {level}{} {}`", shell(path), shell(&out));
        Error::input(path, format!("is {what}, which is not read"), remedy)
    })
}

/// The error for a ZIP that does not hold a data set.
fn zip(path: &Path) -> Option<Error> {
    let archive = zip::ZipArchive::new(std::io::BufReader::new(regular_file::open(path).ok()?.0)).ok()?;
    let names: Vec<String> = archive.file_names().flatten().map(|name| name.into_owned()).collect();
    let with = |endings: &[&str]| {
        let fits = |name: &&String| endings.iter().any(|ending| name.to_ascii_lowercase().ends_with(ending));
        names.iter().find(fits)
    };
    if by_ending(path).is_some() || with(&["means_l.webp"]).is_some() {
        return by_ending(path).or_else(|| converted(path, "sog"));
    }
    let unread = |what: &str, remedy: &str| Some(Error::input(path, format!("is {what}"), remedy));
    if with(&["data.pkl"]).is_some() {
        return unread("a checkpoint of PyTorch", "export a PLY with the program that wrote it");
    }
    if with(&[".usda", ".usdc", ".usd"]).is_some() {
        return unread("a USDZ, which is not read", "export a PLY with the program that wrote it");
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
