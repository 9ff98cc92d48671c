//! Files as other people's programs name them: with the separators of another system, in another case, with another
//! ending or none.

use std::collections::HashMap;
use std::ffi::OsString;
use std::path::{Component, Path, PathBuf};

/// Endings of photos, the likelier one first.
const ENDINGS: [&str; 3] = ["png", "jpg", "jpeg"];

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

/// Whether a name ends as photos do.
pub(super) fn has_photo_ending(name: &Path) -> bool {
    name.extension().is_some_and(|ending| ENDINGS.iter().any(|known| ending.eq_ignore_ascii_case(known)))
}

/// How many photos lie in a folder and those below it.
pub(super) fn count_photos(folder: &Path) -> usize {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let count =
        |path: PathBuf| match path.file_name().is_some_and(|name| name.to_string_lossy().starts_with('.')) {
            true => 0,
            // A link may lead back.
            false if path.is_dir() && !path.is_symlink() => count_photos(&path),
            false => usize::from(has_photo_ending(&path)),
        };
    entries.map(|entry| count(entry.path())).sum()
}

/// Looks files up, and keeps what lies in the folders that it had to look through.
#[derive(Default)]
pub(super) struct Finder {
    folders: HashMap<PathBuf, Listing>,
}

/// What lies in a folder.
struct Listing {
    /// By name in lower case.
    names: HashMap<String, OsString>,
    /// Photos by name in lower case, without ending; the likeliest.
    photos: HashMap<String, OsString>,
}

impl Finder {
    /// The photo that a path means: itself, or one whose name differs in case, lacks an ending, or has another one.
    pub(super) fn photo(&mut self, path: &Path) -> Option<PathBuf> {
        self.file(path).or_else(|| {
            let (folder, listing) = self.folder_of(path)?;
            let name = path.file_name()?.to_string_lossy().to_lowercase();
            let stem = Path::new(&name).file_stem()?.to_string_lossy().into_owned();
            let other = listing.photos.get(&name);
            let other = other.or_else(|| listing.photos.get(&stem).filter(|_| has_photo_ending(path)));
            other.map(|name| folder.join(name))
        })
    }

    /// The file that a path means: itself, or one whose name differs in case.
    pub(super) fn file(&mut self, path: &Path) -> Option<PathBuf> {
        if path.is_file() {
            return Some(path.to_owned());
        }
        self.entry(path).filter(|found| found.is_file())
    }

    fn entry(&mut self, path: &Path) -> Option<PathBuf> {
        if path.exists() {
            return Some(path.to_owned());
        }
        let (folder, listing) = self.folder_of(path)?;
        let name = path.file_name()?.to_string_lossy().to_lowercase();
        listing.names.get(&name).map(|name| folder.join(name))
    }

    /// The folder of a path as it is written on this disk, and what lies there.
    fn folder_of(&mut self, path: &Path) -> Option<(PathBuf, &Listing)> {
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty())?;
        let folder = self.entry(folder)?;
        let listing = self.folders.entry(folder.clone()).or_insert_with(|| Listing::of(&folder));
        Some((folder, listing))
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
        for name in all {
            let lower = name.to_string_lossy().to_lowercase();
            if let Some(stem) = Path::new(&lower).file_stem().filter(|_| has_photo_ending(Path::new(&lower)))
            {
                photos.entry(stem.to_string_lossy().into_owned()).or_insert_with(|| name.clone());
            }
            names.entry(lower).or_insert(name);
        }
        Self { names, photos }
    }
}
