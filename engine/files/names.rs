//! Finds files under the names of other programs: with another system's separators, another case or extension, or none.

use std::collections::{HashMap, HashSet};
use std::ffi::{OsStr, OsString};
use std::fs::DirEntry;
use std::path::{Component, Path, PathBuf};

use unicode_normalization::UnicodeNormalization;
use walkdir::WalkDir;

use crate::{cost, text};

/// Extensions of photos, the likeliest first.
const ENDINGS: [&str; 3] = ["png", "jpg", "jpeg"];

/// Extensions of pictures that must be converted.
const OTHER_ENDINGS: [&str; 18] = [
    "webp", "tif", "tiff", "heic", "heif", "avif", "bmp", "gif", "jxl", "jp2", "dng", "cr2", "cr3", "nef",
    "arw", "raf", "orf", "rw2",
];

const VIDEO_ENDINGS: [&str; 11] =
    ["mp4", "mov", "mkv", "webm", "avi", "m4v", "mpg", "mpeg", "mts", "3gp", "wmv"];

/// Longest path that systems have, bytes. A longer one cannot exist.
pub(super) const MAX_PATH_BYTES: usize = 4096;
/// Largest depth of nested folders in which a differently written name is searched.
pub(super) const MAX_DEPTH: usize = 64;

/// A name with `/` for `\`, and without a leading `./`.
pub(super) fn plain(name: &str) -> String {
    let name = name.replace('\\', "/");
    let mut rest = name.as_str();
    while let Some(shorter) = rest.strip_prefix("./") {
        rest = shorter.trim_start_matches('/');
    }
    rest.to_owned()
}

/// True if a plain name stays below the folder that it is joined to.
pub(super) fn stays_inside(name: &str) -> bool {
    let below = |c: Component<'_>| matches!(c, Component::Normal(_) | Component::CurDir);
    let drive = name.as_bytes().get(1) == Some(&b':');
    Path::new(name).components().all(below) && !drive && !name.is_empty() && !name.contains('\0')
}

/// The end of a path, shortened for a message.
pub(super) fn ending(name: &str) -> String {
    const SHOWN: usize = 120;
    let start = name.len().saturating_sub(SHOWN);
    let start = (start..=name.len()).find(|&at| name.is_char_boundary(at)).unwrap_or(0);
    format!("{}{}", if start > 0 { "…" } else { "" }, &name[start..])
}

/// True for the extension of a readable photo: `.jpg`, `.jpeg` or `.png`, in any case.
pub fn has_photo_ending(name: &Path) -> bool {
    has_one_of(name, &ENDINGS)
}

/// True for the extension of a picture that must be converted to be read.
pub fn has_other_picture_ending(name: &Path) -> bool {
    has_one_of(name, &OTHER_ENDINGS)
}

/// True for the extension of a video.
pub fn has_video_ending(name: &Path) -> bool {
    has_one_of(name, &VIDEO_ENDINGS)
}

/// True for a name with one of these extensions, in any case.
pub(super) fn has_one_of(name: &Path, endings: &[&str]) -> bool {
    name.extension().is_some_and(|own| endings.iter().any(|ending| own.eq_ignore_ascii_case(ending)))
}

/// A word for a shell: in quotes if it needs them.
pub fn quoted(word: &str) -> String {
    let plain = |c: char| c.is_alphanumeric() || "-_./:,+=@%".contains(c) || std::path::is_separator(c);
    if !word.is_empty() && word.chars().all(plain) {
        return word.to_owned();
    }
    // Both shells of Windows know these quotes, and no file's name there has one.
    if cfg!(windows) { format!("\"{word}\"") } else { format!("'{}'", word.replace('\'', "'\\''")) }
}

/// The entries of a folder, in any order; none if it cannot be read.
pub(super) fn entries(folder: &Path) -> impl Iterator<Item = DirEntry> {
    std::fs::read_dir(folder).into_iter().flatten().flatten()
}

/// The first file in a folder, by name, with one of these extensions.
pub(super) fn first_with(folder: &Path, endings: &[&str]) -> Option<PathBuf> {
    entries(folder).map(|entry| entry.path()).filter(|path| has_one_of(path, endings)).min()
}

/// True if a folder has photos where those of a data set may lie.
pub(super) fn holds_photos(folder: &Path) -> bool {
    has_photos(folder) || ["images", "input"].iter().any(|name| has_photos(&folder.join(name)))
}

/// True if photos lie directly in a folder.
pub(super) fn has_photos(folder: &Path) -> bool {
    entries(folder).any(|entry| !is_hidden(&entry.file_name()) && has_photo_ending(&entry.path()))
}

fn is_hidden(name: &OsStr) -> bool {
    name.as_encoded_bytes().starts_with(b".")
}

/// The photos directly in a folder, and in those subfolders that `names` begin with.
pub(super) fn photos_beside<'n>(folder: &Path, names: impl Iterator<Item = &'n str>) -> Vec<PathBuf> {
    let first = |name: &'n str| {
        cost::step();
        Some(name.trim_start_matches("./").split_once('/')?.0)
    };
    let folders: HashSet<&str> = names.filter_map(first).filter(|name| stays_inside(name)).collect();
    let here = entries(folder).filter_map(|entry| {
        cost::step();
        let path = entry.path();
        let counts = !is_hidden(&entry.file_name()) && !is_companion(Path::new(&entry.file_name()));
        (counts && has_photo_ending(&path) && !path.is_dir()).then_some(path)
    });
    here.chain(folders.iter().flat_map(|name| photos_below(&folder.join(name)))).collect()
}

/// The pictures in a folder and its subfolders.
pub(super) fn pictures_below(folder: &Path) -> Vec<PathBuf> {
    let shown = |entry: &walkdir::DirEntry| {
        cost::step();
        entry.depth() == 0 || !is_hidden(entry.file_name())
    };
    let all = WalkDir::new(folder).into_iter().filter_entry(shown).flatten();
    let pictures = all.filter(|entry| !entry.path().is_dir() && has_photo_ending(entry.path()));
    pictures.map(walkdir::DirEntry::into_path).collect()
}

/// The photos in a folder and its subfolders, without their masks, depth maps and smaller copies.
pub(super) fn photos_below(folder: &Path) -> Vec<PathBuf> {
    let mut photos = pictures_below(folder);
    photos.retain(|photo| !is_companion(photo.strip_prefix(folder).unwrap_or(photo)));
    photos
}

/// True if a part of the path is named like masks, depth maps or smaller copies of photos: `masks`, `a_mask.png`,
/// `a.jpg.png`, `dynamic_mask_a.png`.
pub(super) fn is_companion(path: &Path) -> bool {
    const WORDS: [&str; 7] = ["mask", "masks", "segmentation", "segmentations", "depth", "depths", "normals"];
    path.iter().any(|part| {
        cost::step();
        let name = part.to_string_lossy().to_lowercase();
        let stem = Path::new(&name).file_stem().unwrap_or_default().to_string_lossy();
        let mut words = stem.split(['_', '-', '.', ' ']);
        let is_word = |word: &str| WORDS.contains(&word);
        ["images_2", "images_4", "images_8"].contains(&&*name)
            || name.starts_with("dynamic_mask_")
            || has_photo_ending(Path::new(&*stem))
            || words.next().is_some_and(is_word)
            || words.next_back().is_some_and(is_word)
    })
}

/// Looks files up, and caches the contents of the folders that it has searched.
#[derive(Default)]
pub(super) struct Finder {
    folders: HashMap<PathBuf, Listing>,
    /// Photos in folders and their subfolders, by the [`stem_key`] of their names.
    trees: HashMap<PathBuf, HashMap<String, Vec<PathBuf>>>,
}

struct Listing {
    /// Names as written on disk.
    exact: HashSet<OsString>,
    /// Names by [`key`].
    names: HashMap<String, OsString>,
    /// The likeliest photo for each [`key`] without extension.
    photos: HashMap<String, OsString>,
}

impl Finder {
    /// Finds the photo of a path below `folder`: the file itself, or one whose name differs in case, in the form of its
    /// accents, or in its extension.
    pub(super) fn photo(&mut self, folder: &Path, name: &str) -> Option<PathBuf> {
        let found = self.file(folder, name);
        // The original of a converted photo may still be there.
        let must_be_converted = has_one_of(Path::new(name), &OTHER_ENDINGS);
        if found.is_some() && !must_be_converted {
            return found;
        }
        let mut converted = || {
            let (folder, name) = self.parent(folder, name)?;
            let listing = self.listing(&folder);
            let key = key(name);
            let stem = Path::new(&key).file_stem()?.to_str()?;
            let may_differ = has_photo_ending(Path::new(name)) || must_be_converted;
            let other = listing.photos.get(&key);
            let other = other.or_else(|| listing.photos.get(stem).filter(|_| may_differ));
            other.map(|name| folder.join(name))
        };
        converted().or(found)
    }

    /// Finds the file of a path below `folder`: itself, or one whose name differs in case or in the form of accents.
    pub(super) fn file(&mut self, folder: &Path, name: &str) -> Option<PathBuf> {
        cost::step();
        if name.len() > MAX_PATH_BYTES {
            return None;
        }
        let path = folder.join(name);
        if path.is_file() {
            return Some(path);
        }
        let (folder, name) = self.parent(folder, name)?;
        self.within(&folder, name).filter(|found| found.is_file())
    }

    pub(super) fn folder(&mut self, place: &Path, name: &str) -> Option<PathBuf> {
        self.within(place, name).filter(|found| found.is_dir())
    }

    /// Finds a file below `folder` by the longest end of a path, except the whole path.
    pub(super) fn file_by_end(&mut self, folder: &Path, name: &str) -> Option<PathBuf> {
        self.ends(folder, name).into_iter().find_map(|end| self.file(folder, end))
    }

    /// Ends of a path that may name a file below `folder`, the longest first, without the whole path.
    fn ends<'n>(&mut self, folder: &Path, name: &'n str) -> Vec<&'n str> {
        let starts: Vec<usize> = name.rmatch_indices('/').take(MAX_DEPTH).map(|(at, _)| at + 1).collect();
        let mut ends: Vec<&str> = starts.into_iter().rev().map(|start| &name[start..]).collect();
        ends.retain(|end| {
            cost::step();
            // Most ends begin with a folder of another machine.
            let begins_here = match end.split_once('/') {
                Some((first, _)) => stays_inside(first) && self.within(folder, first).is_some(),
                None => true,
            };
            begins_here && end.len() <= MAX_PATH_BYTES && stays_inside(end)
        });
        ends
    }

    /// Finds a photo below `folder` by a path from another folder. The longest end of the path that names a photo wins,
    /// else the photo that shares the longest end with the path. Two equally good photos are an error.
    pub(super) fn photo_by_end(
        &mut self,
        folder: &Path,
        name: &str,
    ) -> Result<Option<PathBuf>, [PathBuf; 2]> {
        if let Some(photo) = self.ends(folder, name).into_iter().find_map(|end| self.photo(folder, end)) {
            return Ok(Some(photo));
        }
        let parts: Vec<String> = name.split('/').rev().map(stem_key).collect();
        let tree = self.trees.entry(folder.to_owned()).or_insert_with(|| {
            let mut tree: HashMap<String, Vec<PathBuf>> = HashMap::new();
            let mut photos = photos_below(folder);
            photos.sort_unstable();
            for photo in photos {
                let name = stem_key(&photo.file_name().unwrap_or_default().to_string_lossy());
                tree.entry(name).or_default().push(photo);
            }
            tree
        });
        let Some(candidates) = parts.first().and_then(|stem| tree.get(stem)) else { return Ok(None) };
        let shared = |photo: &Path| {
            cost::step();
            let own = photo.iter().rev().map(|part| stem_key(&part.to_string_lossy()));
            own.zip(&parts).take_while(|(own, part)| own == *part).count()
        };
        let max = candidates.iter().map(|photo| shared(photo)).max();
        let mut best = candidates.iter().filter(|photo| Some(shared(photo)) == max);
        match (best.next(), best.next()) {
            (Some(first), Some(second)) => Err([first.clone(), second.clone()]),
            (first, _) => Ok(first.cloned()),
        }
    }

    /// The folder of a path's last part, as written on this disk, and that part.
    fn parent<'n>(&mut self, folder: &Path, name: &'n str) -> Option<(PathBuf, &'n str)> {
        let mut parts = Vec::new();
        for part in Path::new(name).components() {
            match part {
                Component::Normal(part) if parts.len() < MAX_DEPTH => parts.push(part.to_str()?),
                Component::CurDir => {}
                _ => return None,
            }
        }
        let (last, parents) = parts.split_last()?;
        let mut place = folder.to_owned();
        for part in parents {
            place = self.within(&place, part)?;
        }
        Some((place, last))
    }

    fn within(&mut self, folder: &Path, name: &str) -> Option<PathBuf> {
        cost::step();
        let listing = self.listing(folder);
        if listing.exact.contains(OsStr::new(name)) {
            return Some(folder.join(name));
        }
        if let Some(name) = listing.names.get(&key(name)) {
            return Some(folder.join(name));
        }
        // A folder may be readable without the right to list it.
        Some(folder.join(name)).filter(|path| listing.exact.is_empty() && path.exists())
    }

    fn listing(&mut self, folder: &Path) -> &Listing {
        self.folders.entry(folder.to_owned()).or_insert_with(|| Listing::of(folder))
    }
}

/// Makes names equal that mean the same file: lower case, and accents composed with their letter. Linux and Windows
/// write composed accents, macOS separate ones.
fn key(name: &str) -> String {
    match name.is_ascii() {
        true => name.to_ascii_lowercase(),
        false => name.nfc().collect::<String>().to_lowercase().nfc().collect(),
    }
}

/// The [`key`] of a name without its extension.
fn stem_key(name: &str) -> String {
    let key = key(name);
    Path::new(&key).file_stem().map_or_else(String::new, |stem| stem.to_string_lossy().into_owned())
}

impl Listing {
    fn of(folder: &Path) -> Self {
        let mut all: Vec<OsString> = entries(folder).map(|entry| entry.file_name()).collect();
        let rank = |name: &OsString| {
            let ending = Path::new(name).extension().map(|ending| ending.to_string_lossy().to_lowercase());
            ENDINGS.iter().position(|known| ending.as_deref() == Some(known)).unwrap_or(ENDINGS.len())
        };
        all.sort_by_cached_key(|name| (rank(name), name.clone()));
        let (mut names, mut photos) = (HashMap::new(), HashMap::new());
        for name in &all {
            cost::step();
            let key = key(&text::decoded(name.as_encoded_bytes().to_vec()));
            if let Some(stem) = Path::new(&key).file_stem().filter(|_| has_photo_ending(Path::new(&key))) {
                photos.entry(stem.to_string_lossy().into_owned()).or_insert_with(|| name.clone());
            }
            names.entry(key).or_insert_with(|| name.clone());
        }
        Self { exact: all.into_iter().collect(), names, photos }
    }
}
