//! The source of `poses`: photographs in a folder, or a video; and the folder of their data set.

use ashsplat::{Error, Result};
use ashsplat_files::images::existing_folder;
use ashsplat_files::{
    Dataset, colmap, has_other_picture_ending, has_photo_ending, has_video_ending, quoted, regular_file,
    transforms,
};
use std::collections::BTreeMap;
use std::ffi::OsString;
use std::path::{Path, PathBuf};

/// Largest depth of nested folders that are searched.
const MAX_DEPTH: usize = 32;

#[derive(Debug)]
pub enum Source {
    Photos(Photos),
    /// Paths of a video and of its data set.
    Video(PathBuf, PathBuf),
}

/// Photographs and the folder of their data set.
#[derive(Debug)]
pub struct Photos {
    pub folder: PathBuf,
    /// Paths of the photographs below it, sorted.
    pub names: Vec<String>,
    /// Number of pictures that cannot be read, and the name of one.
    pub others: Option<(usize, String)>,
    pub dataset: PathBuf,
    /// True if the data set reads them in place; otherwise they are linked into its folder `images`.
    pub in_place: bool,
}

impl Source {
    /// Recognises a path as photographs or a video.
    ///
    /// # Errors
    /// [`Error::Input`] for anything else, for photographs of other formats, and for a data set that has cameras;
    /// [`Error::Io`].
    pub fn of(path: &Path, out: Option<&Path>) -> Result<Self> {
        let metadata = path.metadata().map_err(|e| Error::io(path, "read", e))?;
        if metadata.is_dir() {
            return Photos::of(path, out).map(Self::Photos);
        }
        if has_photo_ending(path) {
            return Err(Error::input(path, "is one photograph", "give the folder that holds all of them"));
        }
        if Dataset::is_archive(path) {
            return Err(Error::input(path, "is a ZIP", "unpack it and give the folder"));
        }
        // Refuses a pipe, which ffmpeg would wait for.
        regular_file::open(path)?;
        let dataset = out.map_or_else(|| beside(path, path.file_stem()), Path::to_owned);
        Ok(Self::Video(path.to_owned(), dataset))
    }

    pub fn dataset(&self) -> &Path {
        match self {
            Self::Photos(photos) => &photos.dataset,
            Self::Video(_, dataset) => dataset,
        }
    }
}

impl Photos {
    fn of(path: &Path, out: Option<&Path>) -> Result<Self> {
        let has_cameras = |folder: &Path| colmap::exists(folder) || transforms::find(folder).is_some();
        if has_cameras(path) && out.is_none_or(|out| same(path, out)) {
            let remedy = format!(
                "`ashsplat train -s {}` trains on it; -o DATASET finds them anew in another folder",
                quoted(&path.to_string_lossy())
            );
            return Err(Error::input(path, "is a data set that has cameras already", remedy));
        }
        // COLMAP's own tools and the reference's script use these folders.
        for name in ["images", "input"] {
            let folder = path.join(name);
            let list = Listing::of(&folder, MAX_DEPTH)?;
            if !list.photos.is_empty() {
                let dataset = out.unwrap_or(path);
                if is_within(dataset, &folder) {
                    let problem = format!("{} lies among the photographs", dataset.display());
                    return Err(Error::argument("-o", problem + "; give another folder"));
                }
                let in_place = name == "images" && same(dataset, path);
                return list.into_photos(folder, dataset.to_owned(), in_place);
            }
        }
        let list = Listing::of(path, 0)?;
        if list.photos.is_empty() {
            return Err(list.nothing(path));
        }
        let dataset = match out {
            Some(out) => out.to_owned(),
            // A folder of this name belongs to a data set.
            None if path.file_name().is_some_and(|name| name == "images") => parent(path),
            None => beside(path, path.file_name()),
        };
        let in_place = same(&dataset, path) || same(&dataset.join("images"), path);
        list.into_photos(path.to_owned(), dataset, in_place)
    }
}

/// The pictures and videos of a folder.
#[derive(Default)]
struct Listing {
    photos: Vec<PathBuf>,
    others: Vec<PathBuf>,
    videos: Vec<PathBuf>,
    folders: Vec<PathBuf>,
}

impl Listing {
    /// Lists a folder and `depth` levels of folders below it; empty if the folder does not exist.
    fn of(folder: &Path, depth: usize) -> Result<Self> {
        let mut list = Self::default();
        if folder.is_dir() {
            list.add(folder, Path::new(""), depth)?;
        }
        for found in [&mut list.photos, &mut list.others, &mut list.videos, &mut list.folders] {
            found.sort();
        }
        Ok(list)
    }

    fn add(&mut self, folder: &Path, below: &Path, depth: usize) -> Result<()> {
        let place = folder.join(below);
        let io = |e| Error::io(&place, "read", e);
        for entry in std::fs::read_dir(&place).map_err(io)? {
            let name = entry.map_err(io)?.file_name();
            // "._IMG_1.JPG" is macOS's metadata of a photograph.
            if name.as_encoded_bytes().starts_with(b".") {
                continue;
            }
            let (path, name) = (place.join(&name), below.join(&name));
            if path.is_dir() {
                if depth > 0 && !path.is_symlink() {
                    self.add(folder, &name, depth - 1)?;
                }
                self.folders.push(name);
            } else if has_photo_ending(&path) {
                self.photos.push(name);
            } else if has_video_ending(&path) {
                self.videos.push(name);
            } else if has_other_picture_ending(&path) {
                self.others.push(name);
            }
        }
        Ok(())
    }

    fn into_photos(self, folder: PathBuf, dataset: PathBuf, in_place: bool) -> Result<Photos> {
        let others = self.others.first().map(|one| (self.others.len(), one.display().to_string()));
        let named = |path: PathBuf| name_in_list(&path).ok_or_else(|| bad_name(&folder.join(path)));
        let names = self.photos.into_iter().map(named).collect::<Result<Vec<String>>>()?;
        Ok(Photos { names, others, dataset, in_place, folder })
    }

    fn nothing(&self, folder: &Path) -> Error {
        let below = |names: &[PathBuf]| names.first().map(|name| folder.join(name));
        let command = |path: PathBuf| format!("`ashsplat poses {}`", quoted(&path.to_string_lossy()));
        if let Some(one) = below(&self.others) {
            let problem = format!(
                "has no JPEG or PNG; its {} pictures ({} for example) are of a kind that is not read",
                self.others.len(),
                one.display()
            );
            let remedy = "convert them to JPEG of the same size first: heif-convert or sips for HEIC, else ImageMagick";
            return Error::input(folder, problem, remedy);
        }
        if let Some(video) = below(&self.videos) {
            return Error::input(
                folder,
                "has no photographs, but a video",
                format!("{} takes it", command(video)),
            );
        }
        let mut within = self.folders.iter().map(|name| folder.join(name));
        let within = within.find(|folder| Listing::of(folder, 0).is_ok_and(|list| !list.photos.is_empty()));
        match within {
            Some(inner) => {
                let problem = format!("has no photographs itself, but {} has", inner.display());
                Error::input(folder, problem, format!("{} takes those", command(inner)))
            }
            None => Error::input(folder, "has no photographs", "put JPEG or PNG files there"),
        }
    }
}

/// A path in the form that COLMAP reads from a list with one name per line and writes in models.
fn name_in_list(path: &Path) -> Option<String> {
    let parts: Option<Vec<&str>> = path.iter().map(|part| part.to_str()).collect();
    let name = parts?.join("/");
    let plain = name.trim() == name && !name.contains(['\n', '\r']);
    plain.then_some(name)
}

fn bad_name(path: &Path) -> Error {
    let problem = "has a name that COLMAP's lists cannot hold";
    Error::input(path, problem, "rename it: without line breaks, without spaces at its ends, in UTF-8")
}

/// Groups photographs that share a camera: of one size, and with the same camera and focal length in their metadata.
pub fn by_camera(names: &[String], infos: &[PhotoInfo]) -> Vec<Vec<String>> {
    let mut groups: BTreeMap<&PhotoInfo, Vec<String>> = BTreeMap::new();
    for (name, info) in names.iter().zip(infos) {
        groups.entry(info).or_default().push(name.clone());
    }
    let mut groups: Vec<Vec<String>> = groups.into_values().collect();
    // The largest group first, then by name: the order does not depend on the metadata.
    groups.sort_by(|a, b| b.len().cmp(&a.len()).then_with(|| a.cmp(b)));
    groups
}

/// Properties that photographs of one camera share.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct PhotoInfo {
    /// Width and height as stored, pixels.
    pub size: (u32, u32),
    /// Maker, model and focal length from the metadata; empty without.
    pub lens: String,
}

impl PhotoInfo {
    /// Reads the metadata of a photograph of this size.
    pub fn of(path: &Path, size: (u32, u32)) -> Self {
        use exif::{In, Reader, Tag};
        let read = |file| Reader::new().read_from_container(&mut std::io::BufReader::new(file)).ok();
        let metadata = regular_file::open(path).ok().and_then(|(file, _)| read(file));
        let value =
            |tag| metadata.as_ref()?.get_field(tag, In::PRIMARY).map(|f| f.display_value().to_string());
        let parts: Vec<String> =
            [Tag::Make, Tag::Model, Tag::LensModel, Tag::FocalLength].into_iter().filter_map(value).collect();
        Self { size, lens: parts.join(" ") }
    }
}

/// `NAME_dataset` beside a path.
fn beside(path: &Path, name: Option<&std::ffi::OsStr>) -> PathBuf {
    let whole = path.canonicalize().ok();
    // Also for "." and "..".
    let name = name.or_else(|| whole.as_deref()?.file_name());
    let mut name = name.map_or_else(|| OsString::from("photographs"), OsString::from);
    name.push("_dataset");
    parent(path).join(name)
}

/// The parent folder of a path, including "." and "..".
fn parent(path: &Path) -> PathBuf {
    match (path.file_name(), path.parent()) {
        (Some(_), Some(parent)) => parent.to_owned(),
        _ => path.join(".."),
    }
}

/// True if a folder, which may not exist yet, lies in another.
fn is_within(inner: &Path, outer: &Path) -> bool {
    let places = (existing_folder(inner).canonicalize(), outer.canonicalize());
    matches!(places, (Ok(inner), Ok(outer)) if inner.starts_with(&outer))
}

fn same(a: &Path, b: &Path) -> bool {
    matches!((a.canonicalize(), b.canonicalize()), (Ok(a), Ok(b)) if a == b)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn folder_with(files: &[&str]) -> tempfile::TempDir {
        let folder = tempfile::tempdir().expect("a temporary folder");
        for file in files {
            let path = folder.path().join(file);
            std::fs::create_dir_all(path.parent().expect("a parent")).expect("a folder");
            std::fs::write(path, "").expect("written");
        }
        folder
    }

    #[test]
    fn photographs_are_found_and_their_data_set_is_named() {
        let folder = folder_with(&[
            "flat/b.JPG",
            "flat/a.png",
            "flat/._a.png",
            "flat/c.HEIC",
            "flat/deep/d.jpg",
            "scene/images/left/1.jpg",
            "scene/images/2.jpg",
            "old/input/1.jpg",
            "film.MOV",
        ]);
        let at = |name: &str| folder.path().join(name);
        let photos = |name: &str, out: Option<&str>| match Source::of(&at(name), out.map(at).as_deref()) {
            Ok(Source::Photos(photos)) => photos,
            other => panic!("{name}: {other:?}"),
        };
        let flat = photos("flat", None);
        assert_eq!((flat.names.join(" "), flat.in_place), ("a.png b.JPG".into(), false));
        assert_eq!((flat.others, flat.dataset), (Some((1, "c.HEIC".into())), at("flat_dataset")));
        assert!(photos("flat", Some("flat")).in_place);
        assert!(!photos("flat", Some("new")).in_place);
        let scene = photos("scene", None);
        assert_eq!((scene.names.join(" "), scene.in_place), ("2.jpg left/1.jpg".into(), true));
        assert_eq!((scene.folder, scene.dataset), (at("scene/images"), at("scene")));
        assert!(!photos("scene", Some("new")).in_place);
        // The folder `images` itself: the data set is its parent.
        let images = photos("scene/images", None);
        assert_eq!((images.dataset, images.in_place), (at("scene"), true));
        let among = Source::of(&at("scene"), Some(&at("scene/images/new")));
        assert!(among.is_err_and(|e| e.to_string().contains("among the photographs")));
        let old = photos("old", None);
        assert_eq!((old.folder, old.dataset, old.in_place), (at("old/input"), at("old"), false));
        let video = Source::of(&at("film.MOV"), None).expect("a video");
        assert_eq!(video.dataset(), at("film_dataset"));
        assert_eq!(
            beside(Path::new("photos/"), Path::new("photos/").file_name()),
            Path::new("photos_dataset")
        );
    }

    #[test]
    fn what_has_no_photographs_says_what_to_give() {
        let folder = folder_with(&[
            "phone/1.heic",
            "phone/2.heic",
            "films/my film.mp4",
            "outer/day 1/a.jpg",
            "empty/notes.txt",
            "one.jpg",
            "solved/images/a.jpg",
            "solved/sparse/0/cameras.bin",
            "line/a\nb.jpg",
        ]);
        let refused = |name: &str, words: &[&str]| {
            let path = folder.path().join(name);
            let error = Source::of(&path, None).err().map(|error| error.to_string()).unwrap_or_default();
            assert!(words.iter().all(|word| error.contains(word)), "{name}: {error}");
        };
        refused("phone", &["its 2 pictures", "1.heic", "heif-convert"]);
        refused("films", &["`ashsplat poses '", "my film.mp4'`"]);
        refused("outer", &["day 1 has", "`ashsplat poses '"]);
        refused("empty", &["has no photographs; put JPEG"]);
        refused("one.jpg", &["the folder that holds"]);
        refused("solved", &["has cameras already", "ashsplat train -s"]);
        refused("line", &["rename it"]);
        refused("nowhere", &["cannot read"]);
    }
}
