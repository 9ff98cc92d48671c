//! Files as other people's programs name them: with the separators of another system, in another case, with another
//! ending or none.

use std::collections::{HashMap, HashSet};
use std::ffi::{OsStr, OsString};
use std::path::{Component, Path, PathBuf};

use unicode_normalization::UnicodeNormalization;

use crate::cost;

/// Endings of photos, the likelier one first.
const ENDINGS: [&str; 3] = ["png", "jpg", "jpeg"];

/// Endings of videos.
const VIDEO_ENDINGS: [&str; 11] =
    ["mp4", "mov", "mkv", "webm", "avi", "m4v", "mpg", "mpeg", "mts", "3gp", "wmv"];

/// Longest path that systems have, bytes. A longer one names nothing.
pub(super) const MAX_PATH_BYTES: usize = 4096;

/// Most folders within each other that a differently written name is looked for in.
pub(super) const MAX_DEPTH: usize = 64;

/// A name with `/` for `\`, and without `./` in front.
pub(super) fn plain(name: &str) -> String {
    let name = name.replace('\\', "/");
    let mut rest = name.as_str();
    while let Some(shorter) = rest.strip_prefix("./") {
        rest = shorter.trim_start_matches('/');
    }
    rest.to_owned()
}

/// Whether a plain name stays below the folder that it is joined to.
pub(super) fn stays_inside(name: &str) -> bool {
    let below = |c: Component<'_>| matches!(c, Component::Normal(_) | Component::CurDir);
    let drive = name.as_bytes().get(1) == Some(&b':');
    Path::new(name).components().all(below) && !drive && !name.is_empty() && !name.contains('\0')
}

/// The end of a path of unknown length, for a message.
pub(super) fn ending(name: &str) -> String {
    const SHOWN: usize = 120;
    let start = name.len().saturating_sub(SHOWN);
    let start = (start..=name.len()).find(|&at| name.is_char_boundary(at)).unwrap_or(0);
    format!("{}{}", if start > 0 { "…" } else { "" }, &name[start..])
}

/// Whether a name ends as the photos do that can be read: `.jpg`, `.jpeg` or `.png`, in any case.
pub fn has_photo_ending(name: &Path) -> bool {
    name.extension().is_some_and(|ending| ENDINGS.iter().any(|known| ending.eq_ignore_ascii_case(known)))
}

/// Whether a name ends as videos do.
pub fn has_video_ending(name: &Path) -> bool {
    name.extension()
        .is_some_and(|ending| VIDEO_ENDINGS.iter().any(|known| ending.eq_ignore_ascii_case(known)))
}

/// A word as a shell reads it back: in quotes if it needs them.
pub fn quoted(word: &str) -> String {
    let plain = |c: char| c.is_alphanumeric() || "-_./:,+=@%".contains(c);
    if !word.is_empty() && word.chars().all(plain) {
        return word.to_owned();
    }
    format!("'{}'", word.replace('\'', "'\\''"))
}

/// Whether photos lie in a folder itself.
pub(super) fn has_photos(folder: &Path) -> bool {
    let mut entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    entries.any(|entry| !is_hidden(&entry.file_name()) && has_photo_ending(&entry.path()))
}

fn is_hidden(name: &OsStr) -> bool {
    name.as_encoded_bytes().starts_with(b".")
}

/// How many photos lie in a folder itself and in those folders of it that `names` begin with: not in other folders
/// beside them.
pub(super) fn count_photos_beside<'n>(folder: &Path, names: impl Iterator<Item = &'n str>) -> usize {
    let first = |name: &'n str| {
        cost::step();
        Some(name.trim_start_matches("./").split_once('/')?.0)
    };
    let folders: HashSet<&str> = names.filter_map(first).filter(|name| stays_inside(name)).collect();
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let here = entries.filter(|entry| {
        cost::step();
        let path = entry.path();
        !is_hidden(&entry.file_name()) && has_photo_ending(&path) && !path.is_dir()
    });
    here.count() + folders.iter().map(|name| count_photos(&folder.join(name))).sum::<usize>()
}

/// How many photos lie in a folder and those below it.
pub(super) fn count_photos(folder: &Path) -> usize {
    let mut open = vec![folder.to_owned()];
    let mut photos = 0;
    while let Some(folder) = open.pop() {
        for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
            cost::step();
            let path = entry.path();
            if is_hidden(&entry.file_name()) {
                continue;
            }
            // A link may lead back.
            match path.is_dir() && !path.is_symlink() {
                true => open.push(path),
                false => photos += usize::from(has_photo_ending(&path)),
            }
        }
    }
    photos
}

/// Looks files up, and keeps what lies in the folders that it had to look through.
#[derive(Default)]
pub(super) struct Finder {
    folders: HashMap<PathBuf, Listing>,
}

/// What lies in a folder.
struct Listing {
    /// As they are written.
    exact: HashSet<OsString>,
    /// By [`key`].
    names: HashMap<String, OsString>,
    /// Photos by [`key`], without ending; the likeliest.
    photos: HashMap<String, OsString>,
}

impl Finder {
    /// The photo that a path below `folder` means: itself, or one whose name differs in case or in the form of its
    /// accents, lacks an ending, or has another one.
    pub(super) fn photo(&mut self, folder: &Path, name: &str) -> Option<PathBuf> {
        self.file(folder, name).or_else(|| {
            let (folder, name) = self.parent(folder, name)?;
            let listing = self.listing(&folder);
            let key = key(name);
            let stem = Path::new(&key).file_stem()?.to_str()?;
            let other = listing.photos.get(&key);
            let other =
                other.or_else(|| listing.photos.get(stem).filter(|_| has_photo_ending(Path::new(name))));
            other.map(|name| folder.join(name))
        })
    }

    /// The file that a path below `folder` means: itself, or one whose name differs in case or in the form of its
    /// accents.
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

    /// The longest end of a path that means a photo below `folder`, and that photo. The whole path is not tried.
    pub(super) fn photo_by_end<'n>(&mut self, folder: &Path, name: &'n str) -> Option<(&'n str, PathBuf)> {
        let starts: Vec<usize> = name.rmatch_indices('/').take(MAX_DEPTH).map(|(at, _)| at + 1).collect();
        starts.into_iter().rev().find_map(|start| {
            cost::step();
            let end = &name[start..];
            // Most ends begin with a folder of another machine. Only those that begin with one of these are looked at.
            let begins_here = match end.split_once('/') {
                Some((first, _)) => stays_inside(first) && self.within(folder, first).is_some(),
                None => true,
            };
            let possible = begins_here && end.len() <= MAX_PATH_BYTES && stays_inside(end);
            possible.then(|| self.photo(folder, end)).flatten().map(|photo| (end, photo))
        })
    }

    /// The folder in which the last part of a path lies, as it is written on this disk, and that part.
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

    /// What one name means in a folder.
    fn within(&mut self, folder: &Path, name: &str) -> Option<PathBuf> {
        cost::step();
        let listing = self.listing(folder);
        if listing.exact.contains(OsStr::new(name)) {
            return Some(folder.join(name));
        }
        if let Some(name) = listing.names.get(&key(name)) {
            return Some(folder.join(name));
        }
        // A folder may be entered without the right to list it.
        Some(folder.join(name)).filter(|path| listing.exact.is_empty() && path.exists())
    }

    fn listing(&mut self, folder: &Path) -> &Listing {
        self.folders.entry(folder.to_owned()).or_insert_with(|| Listing::of(folder))
    }
}

/// What names have in common that mean the same file: without case, accents as one character with their letter. Linux
/// and Windows write them so, macOS apart.
fn key(name: &str) -> String {
    match name.is_ascii() {
        true => name.to_ascii_lowercase(),
        false => name.nfc().collect::<String>().to_lowercase().nfc().collect(),
    }
}

impl Listing {
    fn of(folder: &Path) -> Self {
        let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
        let mut all: Vec<OsString> = entries.map(|entry| entry.file_name()).collect();
        let rank = |name: &OsString| {
            let ending = Path::new(name).extension().map(|ending| ending.to_string_lossy().to_lowercase());
            ENDINGS.iter().position(|known| ending.as_deref() == Some(known)).unwrap_or(ENDINGS.len())
        };
        all.sort_by_cached_key(|name| (rank(name), name.clone()));
        let (mut names, mut photos) = (HashMap::new(), HashMap::new());
        for name in &all {
            cost::step();
            let key = key(&name.to_string_lossy());
            if let Some(stem) = Path::new(&key).file_stem().filter(|_| has_photo_ending(Path::new(&key))) {
                photos.entry(stem.to_string_lossy().into_owned()).or_insert_with(|| name.clone());
            }
            names.entry(key).or_insert_with(|| name.clone());
        }
        Self { exact: all.into_iter().collect(), names, photos }
    }
}
