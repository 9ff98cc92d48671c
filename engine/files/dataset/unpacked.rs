//! A data set in a folder or in a ZIP.

use std::fs::{self, File};
use std::io::{BufReader, Read, Write};
use std::path::{Component, Path, PathBuf};

use zip::result::ZipError;

use crate::colmap::is_data_set;
use crate::cost;
use crate::names::{MAX_DEPTH, MAX_PATH_BYTES, ending, entries, holds_photos};
use crate::progress::Progress;
use crate::regular_file::{self, OnFile};
use ashsplat::{Error, Result};

/// Largest credible ratio of an archive's unpacked size to its own.
const MAX_RATIO: u64 = 1032;
/// Bytes that are unpacked between two checks of `progress`.
const PIECE_BYTES: usize = 1 << 20;

/// The folder of a data set, or the temporary folder with the contents of its ZIP.
pub(crate) struct Unpacked {
    pub(super) folder: PathBuf,
    archive: Option<(PathBuf, tempfile::TempDir)>,
}

impl Unpacked {
    /// Unpacks a ZIP to a temporary folder, which is removed with this value. A folder is used in place.
    pub(crate) fn open(path: &Path, progress: Progress<'_>) -> Result<Self> {
        if !path.is_file() || !starts_like_zip(path) {
            return Ok(Self { folder: path.to_owned(), archive: None });
        }
        let target = tempfile::tempdir().on(std::env::temp_dir(), "create")?;
        extract(path, target.path(), progress)?;
        let folder = data_folder(path, target.path())?;
        Ok(Self { folder, archive: Some((path.to_owned(), target)) })
    }

    /// True if the folder is removed with this value.
    pub(super) fn is_temporary(&self) -> bool {
        self.archive.is_some()
    }

    /// Replaces temporary paths in an error by paths in the archive.
    pub(crate) fn name(&self, error: Error) -> Error {
        match error {
            Error::Input { path, problem, remedy } => Error::Input {
                path: self.named(&path),
                problem: self.name_in(&problem),
                remedy: self.name_in(&remedy),
            },
            Error::Io { path, action, source } => Error::Io { path: self.named(&path), action, source },
            Error::TooLarge { what, needed, unit, limit, limit_name } => {
                Error::TooLarge { what: self.name_in(&what), needed, unit, limit, limit_name }
            }
            other => other,
        }
    }

    /// Replaces a temporary path by the path in the archive.
    pub(crate) fn named(&self, path: &Path) -> PathBuf {
        let Some((archive, target)) = &self.archive else { return path.to_owned() };
        let rest = path.strip_prefix(&self.folder).or_else(|_| path.strip_prefix(target.path()));
        match rest {
            Ok(rest) if rest.as_os_str().is_empty() => archive.clone(),
            Ok(rest) => archive.join(rest),
            Err(_) => path.to_owned(),
        }
    }

    /// Replaces all temporary paths in a text by paths in the archive.
    pub(crate) fn name_in(&self, text: &str) -> String {
        let Some((archive, target)) = &self.archive else { return text.to_owned() };
        let archive = archive.to_string_lossy();
        text.replace(&*self.folder.to_string_lossy(), &archive)
            .replace(&*target.path().to_string_lossy(), &archive)
    }
}

/// True if a file's content is a ZIP archive, even an empty one.
pub(super) fn starts_like_zip(path: &Path) -> bool {
    regular_file::start(path, 4).is_ok_and(|start| start == b"PK\x03\x04" || start == b"PK\x05\x06")
}

fn extract(path: &Path, target: &Path, progress: Progress<'_>) -> Result<()> {
    let refused =
        |problem: String| Error::input(path, problem, "the archive is damaged: pack or download it again");
    let damaged = |place: String, error: ZipError| match error {
        ZipError::UnsupportedArchive(why) => {
            let remedy = "pack it as a plain ZIP: deflated or stored, without a password";
            Error::input(path, format!("{place}: {why}"), remedy)
        }
        error => refused(format!("{place}: {error}")),
    };
    let (file, bytes) = regular_file::open(path)?;
    let mut left = bytes.saturating_mul(MAX_RATIO);
    let mut archive =
        zip::ZipArchive::new(BufReader::new(file)).map_err(|e| refused(format!("is no whole ZIP: {e}")))?;
    if archive.is_empty() {
        return Err(Error::input(path, "is an empty ZIP", "pack the data set again"));
    }
    let mut piece = vec![0; PIECE_BYTES];
    for index in 0..archive.len() {
        progress.check()?;
        cost::step();
        let mut entry = archive.by_index(index).map_err(|e| damaged(format!("entry {index}"), e))?;
        let name = entry.name().map_err(|e| damaged(format!("entry {index}"), e))?.into_owned();
        let inside = path_of(&name).ok_or_else(|| {
            refused(format!("{:?} leads out of the archive, or is of too many folders", ending(&name)))
        })?;
        if is_clutter(&inside) {
            continue;
        }
        let place = target.join(inside);
        if entry.is_dir() || name.ends_with('\\') {
            fs::create_dir_all(&place).on(&place, "create")?;
            continue;
        }
        if !entry.is_file() {
            return Err(refused(format!("{name:?} is a link")));
        }
        if let Some(parent) = place.parent() {
            fs::create_dir_all(parent).on(parent, "create")?;
        }
        // A full disk is not the archive's fault.
        const UNPACK: &str = "unpack the ZIP (TMPDIR names another folder for it)";
        let mut output = File::create(&place).on(target, UNPACK)?;
        loop {
            progress.check()?;
            let read = entry.read(&mut piece).map_err(|e| refused(format!("{name:?}: {e}")))?;
            if read == 0 {
                break;
            }
            left = left.saturating_sub(read as u64);
            if left == 0 {
                return Err(refused("unpacks to far more than photos can".into()));
            }
            output.write_all(&piece[..read]).on(target, UNPACK)?;
        }
    }
    Ok(())
}

/// The path of an archive entry; Windows' separators occur. `None` if it leads out of the folder.
fn path_of(name: &str) -> Option<PathBuf> {
    let path = PathBuf::from(name.replace('\\', "/"));
    if name.len() > MAX_PATH_BYTES || path.components().count() > MAX_DEPTH {
        return None;
    }
    let inside = |part: Component<'_>| matches!(part, Component::Normal(_) | Component::CurDir);
    (path.components().all(inside) && !name.contains('\0')).then_some(path)
}

/// True for files that macOS adds to archives.
fn is_clutter(path: &Path) -> bool {
    path.iter()
        .map(|part| part.to_string_lossy())
        .any(|part| part == "__MACOSX" || part == ".DS_Store" || part.starts_with("._"))
}

/// Finds the data set's folder: archives often nest it in a single folder, or put other folders beside it.
fn data_folder(archive: &Path, unpacked: &Path) -> Result<PathBuf> {
    let mut folder = unpacked.to_owned();
    while !is_data_set(&folder) {
        let paths = entries(&folder).map(|entry| entry.path());
        let folders: Vec<PathBuf> = paths.filter(|path| path.is_dir()).collect();
        let mut data: Vec<&PathBuf> = folders.iter().filter(|folder| is_data_set(folder)).collect();
        data.sort();
        match (data.as_slice(), folders.as_slice()) {
            ([first, second, ..], _) => {
                let [first, second] = [first, second].map(|folder| folder.strip_prefix(unpacked));
                let (first, second) = (first.unwrap_or(archive), second.unwrap_or(archive));
                let problem = format!("holds several data sets: {}, {}", first.display(), second.display());
                return Err(Error::input(archive, problem, "unpack it and give one of them"));
            }
            ([only], _) => folder = (*only).clone(),
            // `sparse` and `images` alone are no data sets.
            ([], [only]) if !["sparse", "images"].iter().any(|name| only.ends_with(name)) => {
                folder.clone_from(only);
            }
            _ => break,
        }
    }
    if !is_data_set(&folder) && holds_photos(&folder) {
        let remedy = "unpack it; `ashsplat poses FOLDER` finds the cameras of a folder of photos";
        return Err(Error::input(archive, "holds photos without cameras", remedy));
    }
    Ok(folder)
}
