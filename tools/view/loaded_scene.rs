//! The scene to look at: Gaussians, render settings, cameras and photos.

use super::appearances::PhotoAppearances;
use super::labels::labels;
use super::openings;
use super::photos::Photos;
use super::protocol::CameraMessage;
use ashsplat::scene::{Bounds, Camera, Gaussians, Intrinsics, Orbit, Similarity, WorldFrame, without_strays};
use ashsplat::{Error, RenderSettings, Result};
use ashsplat_files::cameras_json::{self, NamedCamera};
use ashsplat_files::splats::{Format, ReadOptions, Target};
use ashsplat_files::tiles::Tree;
use ashsplat_files::{DatasetOptions, Gallery, quoted};
use ashsplat_program::appearance::Appearances;
use ashsplat_program::args::HostArguments;
use ashsplat_program::config::{DataSettings, Settings};
use ashsplat_program::look::{LookArguments, gaussians_of, orbit_around, parse_target, tree_of};
use ashsplat_program::model::Model;
use ashsplat_program::progress::thousands;
use ashsplat_program::{model, session};
use clap::Args;
use glam::Vec3;
use serde_json::{Value, json};
use std::path::{Component, Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::SystemTime;

/// SH degree of a data set's points: they have one colour each.
const POINTS_SH_DEGREE: u32 = 0;
/// Size of the first picture, before the page requests its own.
const START_SIZE: [u32; 2] = [1280, 720];

#[derive(Default)]
pub struct LoadedScene {
    pub name: String,
    pub gaussians: Gaussians,
    /// Coordinate frame of Gaussians and cameras within their files' coordinates.
    pub frame: WorldFrame,
    pub base: RenderSettings,
    pub cameras: Vec<NamedCamera>,
    pub photos: Option<Arc<Photos>>,
    pub appearances: PhotoAppearances,
    /// Text on the page: instead of an empty scene, otherwise below the name.
    pub note: Option<String>,
    /// Its file or folder, for commands; none if there is none.
    pub file: Option<PathBuf>,
    /// Scenes that are drawn together, in the order of their Gaussians; empty for one alone.
    pub parts: Vec<ScenePart>,
    /// `run` in the greeting of the scene that it has joined, whose frame it keeps.
    pub joined: Option<String>,
    /// Tree of tiles; the Gaussians are its coarsest tile.
    pub tree: Option<Streamed>,
    /// Up direction, if it differs from the cameras'.
    pub up: Option<Vec3>,
}

#[derive(Clone, Debug)]
pub struct ScenePart {
    pub name: String,
    pub file: Option<PathBuf>,
    pub count: usize,
}

/// State of the open scenes that a joining scene needs.
#[derive(Clone)]
pub struct OpenScenes {
    pub parts: Vec<ScenePart>,
    /// True if cameras are shown, which a scene that is added removes.
    pub has_cameras: bool,
    pub frame: WorldFrame,
    pub base: RenderSettings,
}

/// A tree of tiles, of which the viewer loads the visible ones.
#[derive(Clone)]
pub struct Streamed {
    pub tree: Arc<Tree>,
    pub read: ReadOptions,
    /// Most Gaussians of a picture.
    pub budget: usize,
    /// Tiles whose links lead out of this folder are not read.
    pub within: Option<PathBuf>,
}

/// Options that select parts of a scene.
#[derive(Args)]
pub struct SceneArguments {
    /// Photos and cameras of this data set [default: that of the training]
    #[arg(short, long, value_name = "DATASET")]
    source_path: Option<PathBuf>,
    /// Folder of the photos within the data set [default: as in training, else images]
    #[arg(short, long, value_name = "NAME")]
    images: Option<String>,
    /// Iteration of the model folder's PLY [default: what was saved last]
    #[arg(long, value_name = "N")]
    iteration: Option<u32>,
    /// Most Gaussians in a picture of a folder of tiles; the tiles whose error is largest in pixels are refined first
    /// [default: 1000000; pages can change it]
    #[arg(long, value_name = "N|N%", value_parser = parse_target)]
    budget: Option<Target>,
}

/// Default budget of a tree, Gaussians.
const BUDGET: usize = 1_000_000;

impl LoadedScene {
    /// The scene before any is chosen.
    pub fn nothing() -> LoadedScene {
        let note = "No scene is open. Start the viewer with something to look at: `ashsplat view scene.ply`, \
                    `ashsplat view MODEL` (a folder as `ashsplat train -m` leaves it) or `ashsplat view DATASET`.";
        LoadedScene { name: "nothing".into(), note: Some(note.into()), ..LoadedScene::default() }
    }

    /// A tree of tiles: reads only its coarsest tile.
    fn of_tree(
        tree: Tree,
        path: &Path,
        (budget, within): (Option<Target>, Option<&Path>),
        (look, host): (&LookArguments, &HostArguments),
    ) -> Result<LoadedScene> {
        let coarsest = tree.path(0).ok_or_else(|| Error::input(path, "has no tiles", "write it again"))?;
        let streamed = |tree: Tree| Streamed {
            read: host.reading(look.drop_invalid),
            budget: budget.map_or(BUDGET, |budget| gaussians_of(budget, &tree)),
            within: within.map(Path::to_owned),
            tree: Arc::new(tree),
        };
        if let Some(folder) = within
            && !dunce::canonicalize(&coarsest).is_ok_and(|real| real.starts_with(folder))
        {
            return Err(Error::input(
                coarsest,
                "leads out of the folder that may be opened",
                "name the tree itself",
            ));
        }
        let scene = tree.read(0, &host.reading(look.drop_invalid))?;
        if scene.gaussians.is_empty() {
            return Err(Error::input(
                coarsest,
                "has no Gaussians",
                "write the tree again with `ashsplat tiles`",
            ));
        }
        Ok(LoadedScene {
            name: path.display().to_string(),
            base: look.settings(&Settings::reference(), &scene.header)?,
            gaussians: scene.gaussians,
            frame: scene.frame,
            note: Some(format!(
                "{} Gaussians in {} tiles",
                thousands(tree.gaussians() as u64),
                tree.tiles().len()
            )),
            tree: Some(streamed(tree)),
            ..LoadedScene::default()
        })
    }

    /// Loads a file of Gaussians, a model folder, a tree of tiles, or the points of a data set. Photos outside the folder `within` are not
    /// read: a model may name any folder.
    pub fn load(
        path: &Path,
        within: Option<&Path>,
        arguments: &SceneArguments,
        look: &LookArguments,
        host: &HostArguments,
        stop: &AtomicBool,
    ) -> Result<LoadedScene> {
        let folder = model::folder_of_tiles(path);
        if let Some(tree) = tree_of(folder, arguments.budget.is_some())? {
            return LoadedScene::of_tree(tree, path, (arguments.budget, within), (look, host));
        }
        if model::is_dataset(path) {
            return LoadedScene::of_dataset(path, arguments.images.as_deref(), host, stop);
        }
        let model = Model::locate(path, arguments.iteration)?;
        let scene = look.load(&model.ply, host)?;
        let mut data = model.settings.data.clone();
        if let Some(source) = &arguments.source_path {
            data.source_path.clone_from(source);
        }
        data.images = arguments.images.clone().unwrap_or(data.images);
        let requested = arguments.source_path.is_some() || arguments.images.is_some();
        let white = model.settings.train.white_background;
        // The user names this data set, so it may lie anywhere; a stranger's model may still name its photos' folder.
        let own = arguments.source_path.as_ref().and_then(|source| dunce::canonicalize(source).ok());
        let is_users = own.is_some() && arguments.images.is_some();
        if within.is_some_and(|folder| !is_users && !lies_within(&data, own.as_deref().unwrap_or(folder))) {
            data.source_path = PathBuf::new();
        }
        let gallery = match (requested, photos_of(&data, (white, &scene.frame), host, stop)) {
            (true, gallery) => Some(gallery?),
            (false, Err(Error::Interrupted)) => return Err(Error::Interrupted),
            // The training's data set may be gone.
            (false, gallery) => gallery.ok(),
        };
        let cameras = match (&gallery, model.cameras_file()) {
            (Some(gallery), _) => gallery.cameras(),
            (None, Some(own)) => cameras_of(&own, &scene.frame)?,
            (None, None) => Vec::new(),
        };
        let appearances = match &model.folder {
            Some((folder, _)) => Appearances::read(folder)?,
            None => Appearances::default(),
        };
        let newest = model.folder.is_some() && arguments.iteration.is_none();
        let file = if newest { path.to_owned() } else { model.ply };
        Ok(LoadedScene {
            name: path.display().to_string(),
            base: look.settings(&model.settings, &scene.header)?,
            gaussians: scene.gaussians,
            frame: scene.frame,
            appearances: PhotoAppearances::kept(&cameras, &appearances),
            cameras,
            photos: gallery.map(|gallery| Arc::new(Photos::new(gallery))),
            note: model.folder.map(|(_, iteration)| format!("iteration {iteration}")),
            file: Some(file),
            ..LoadedScene::default()
        })
    }

    fn of_dataset(
        path: &Path,
        images: Option<&str>,
        host: &HostArguments,
        stop: &AtomicBool,
    ) -> Result<LoadedScene> {
        let data = DataSettings { source_path: path.to_owned(), ..Default::default() };
        let mut options = DatasetOptions { host_memory: host.memory(), ..Default::default() };
        if let Some(images) = images {
            options.images = images.to_owned();
        }
        let gallery = session::open(&data, &options, stop)?;
        let points = gallery.points();
        let (gaussians, note) = if points.is_empty() {
            (Gaussians::default(), "This data set has no points to show; its photos are on the right.")
        } else {
            (
                ashsplat_files::initial_gaussians(points, POINTS_SH_DEGREE)?,
                "the data set's points: nothing is trained yet",
            )
        };
        Ok(LoadedScene {
            name: path.display().to_string(),
            gaussians,
            frame: *gallery.frame(),
            cameras: gallery.cameras(),
            photos: Some(Arc::new(Photos::new(gallery))),
            note: Some(note.into()),
            ..LoadedScene::default()
        })
    }

    /// Returns the state that a joining scene needs.
    pub fn open_scenes(&self) -> OpenScenes {
        let alone =
            || ScenePart { name: self.name.clone(), file: self.file.clone(), count: self.gaussians.len() };
        let parts = if self.parts.is_empty() { vec![alone()] } else { self.parts.clone() };
        OpenScenes { parts, has_cameras: !self.cameras.is_empty(), frame: self.frame, base: self.base }
    }

    /// Adds this scene to those that are open, whose Gaussians are `all`. It is drawn with their settings.
    pub fn added_to(self, mut open: OpenScenes, all: Gaussians) -> LoadedScene {
        let degree = self.gaussians.sh_degree.max(all.sh_degree);
        let trained = |base: &RenderSettings| (base.antialias, base.dilation_px2);
        let differs = trained(&self.base) != trained(&open.base);
        let mut added = self.open_scenes();
        // `convert` cannot join files that are drawn differently.
        added.parts.iter_mut().filter(|_| differs).for_each(|part| part.file = None);
        let notes = [
            (differs, "they were trained differently, and are drawn as the first"),
            (
                open.has_cameras || added.has_cameras,
                "cameras and photographs are only shown for a scene alone",
            ),
        ];
        let notes: Vec<&str> = notes.iter().filter(|(is_so, _)| *is_so).map(|(_, note)| *note).collect();
        open.parts.extend(added.parts);
        let mut own = self.gaussians.with_sh_degree(degree);
        own.transform(&Similarity::between(&self.frame, &open.frame));
        let mut gaussians = all.with_sh_degree(degree);
        gaussians.append(&own);
        let names: Vec<&str> = open.parts.iter().map(|part| part.name.as_str()).collect();
        LoadedScene {
            name: names.join(" + "),
            note: (!notes.is_empty()).then(|| notes.join("; ")),
            gaussians,
            frame: open.frame,
            base: open.base,
            parts: open.parts,
            up: self.up,
            ..LoadedScene::default()
        }
    }

    /// The scenes that this one was shown beside; nothing if it is alone.
    pub fn without_last(&self) -> LoadedScene {
        let Some((_, parts @ [_, ..])) = self.parts.split_last() else { return LoadedScene::nothing() };
        let count = parts.iter().map(|part| part.count).sum();
        let names: Vec<&str> = parts.iter().map(|part| part.name.as_str()).collect();
        LoadedScene {
            name: names.join(" + "),
            gaussians: self.gaussians.select(&(0..count).collect::<Vec<_>>()),
            frame: self.frame,
            base: self.base,
            parts: parts.to_vec(),
            up: self.up,
            ..LoadedScene::default()
        }
    }

    /// The orbit that shows the scene, and the camera of the first picture.
    pub fn first_view(&self) -> (Orbit, Option<Camera>) {
        let [width, height] = START_SIZE;
        let intrinsics = Intrinsics::from_fov_x(1.0, width, height);
        let cameras: Vec<Camera> = self.cameras.iter().map(|named| named.camera).collect();
        let middle = self.gaussians.statistics().central_bounds.map(|bounds| bounds.center());
        let orbit = Orbit::around_scene(&cameras, middle, 1, intrinsics)
            .unwrap_or_else(|| orbit_around(&self.gaussians, self.up.unwrap_or(Vec3::NEG_Y), 1, intrinsics));
        let first = without_strays(&cameras, Camera::position).first().copied();
        let start = first.or_else(|| orbit.cameras().first().copied());
        (Orbit { up: self.up.unwrap_or(orbit.up), ..orbit }, start)
    }

    pub fn greeting(&self, device: &str, training: Option<u32>) -> Value {
        let (orbit, start) = self.first_view();
        let statistics = self.gaussians.statistics();
        let tree = self.tree.as_ref();
        let corners = |bounds: Bounds| json!([bounds.min.to_array(), bounds.max.to_array()]);
        let names: Vec<&str> = self.cameras.iter().map(|named| named.name.as_str()).collect();
        let photo = |(index, (named, label)): (usize, (&NamedCamera, String))| {
            let camera = CameraMessage::of(&named.camera);
            let held_out = self.photos.as_ref().is_some_and(|photos| photos.is_held_out(index));
            let lit = self.appearances.has(index);
            json!({ "name": named.name, "label": label, "camera": camera, "lit": lit, "held_out": held_out })
        };
        let photos = self.cameras.iter().zip(labels(&names)).enumerate().map(photo);
        // Unique to this run, so that no browser reuses another run's photos.
        let run = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default().as_nanos();
        json!({
            "type": "scene",
            "name": self.name,
            "run": format!("{run:x}"),
            "joined": self.joined,
            "note": self.note,
            "frame": { "origin": self.frame.origin.to_array(), "unit": self.frame.unit },
            "empty": self.gaussians.is_empty(),
            "gaussians": tree.map_or(self.gaussians.len(), |tree| tree.tree.gaussians()),
            "tree": tree.map(|tree| json!({ "budget": tree.budget, "least": self.gaussians.len() })),
            "sh_degree": self.gaussians.sh_degree,
            "bounds": tree.and_then(|tree| Some(tree.tree.tiles().first()?.bounds)).or(statistics.bounds).map(corners),
            "central_bounds": statistics.central_bounds.map(corners),
            "densities": statistics.density_percentiles,
            "scenes": self.parts.iter().map(|part| json!({ "name": part.name, "count": part.count })).collect::<Vec<_>>(),
            "stem": self.stem(),
            // Formats of exports.
            "formats": openings::single_files(&Format::WRITTEN),
            "convert": self.convert_command(),
            "background": self.base.background,
            "device": device,
            "version": env!("CARGO_PKG_VERSION"),
            "cameras": photos.collect::<Vec<_>>(),
            "has_photos": self.photos.is_some(),
            "start": start.map(|camera| CameraMessage::of(&camera)),
            "pivot": orbit.center.to_array(),
            "up": orbit.up.to_array(),
            "radius": orbit.radius,
            "training": training,
        })
    }

    /// The scene's name without its ending, for new files.
    fn stem(&self) -> String {
        let name = self.parts.first().map_or(&self.name, |first| &first.name);
        let name = Path::new(name).file_name().unwrap_or_default().to_string_lossy().into_owned();
        let ending = Format::of_extension(&name).map_or(0, |format| format.extension().len());
        let stem = name[..name.len() - ending].trim_start_matches('.');
        if stem.is_empty() { "scene".into() } else { stem.into() }
    }

    fn convert_command(&self) -> Option<String> {
        let parts = self.open_scenes().parts;
        let files: Option<Vec<&str>> = parts.iter().map(|part| part.file.as_ref()?.to_str()).collect();
        let files = files?;
        // Files of one name may have been sent from two folders.
        let is_alone = |(index, file): (usize, &&str)| !files[..index].contains(file);
        let cut = format!("{}_cut.ply", self.stem());
        let words: Option<Vec<String>> = files.iter().copied().chain([&*cut]).map(word_of).collect();
        words
            .filter(|_| files.iter().enumerate().all(is_alone))
            .map(|w| format!("ashsplat convert {}", w.join(" ")))
    }
}

/// True for a name that can be typed on any system.
pub fn is_plain_name(name: &str) -> bool {
    let plain = |c: char| c.is_ascii_alphanumeric() || "_. -".contains(c);
    name.chars().all(plain) && !name.starts_with('-')
}

/// Quotes a path for all shells of this system; a plain name suits those of other systems too. None if shells would need
/// different quotes.
fn word_of(path: &str) -> Option<String> {
    if is_plain_name(path) && path.contains(' ') {
        return Some(format!("\"{path}\""));
    }
    if cfg!(windows)
        && path.contains(['$', '`', '%', '\u{2018}', '\u{2019}', '\u{201c}', '\u{201d}', '\u{201e}'])
    {
        return None;
    }
    // These letters begin an option or have a meaning for a shell.
    Some(if path.starts_with(['-', '=', '@']) { quoted(&format!("./{path}")) } else { quoted(path) })
}

/// The cameras of a model, without the orthographic ones: the viewer shows none of these.
fn cameras_of(file: &Path, frame: &WorldFrame) -> Result<Vec<NamedCamera>> {
    let mut cameras = cameras_json::read(file, frame)?;
    let all = cameras.len();
    cameras.retain(|named| !named.camera.is_orthographic());
    if cameras.len() < all {
        errln!("{}: {} orthographic cameras are left out", file.display(), all - cameras.len());
    }
    Ok(cameras)
}

/// True if a data set and its photos lie in `folder`, a path without links. A stranger's model may name any path.
fn lies_within(data: &DataSettings, folder: &Path) -> bool {
    let Ok(source) = dunce::canonicalize(&data.source_path) else { return false };
    let images = Path::new(&data.images);
    // The masks' folder is named after the photos' folder, so a `..` would lead it out too.
    let climbs = images.components().any(|part| part == Component::ParentDir);
    let photos_lie_within = match dunce::canonicalize(source.join(images)) {
        Ok(photos) => photos.starts_with(folder),
        // The folder does not exist, or lies in a ZIP, which is unpacked elsewhere.
        Err(_) => !images.has_root() && !images.is_absolute(),
    };
    source.starts_with(folder) && !climbs && photos_lie_within
}

/// The photos of a training's data set, at the size that training uses.
fn photos_of(
    data: &DataSettings,
    (white_background, frame): (bool, &WorldFrame),
    host: &HostArguments,
    stop: &AtomicBool,
) -> Result<Gallery> {
    if data.source_path.as_os_str().is_empty() {
        return Err(Error::argument("data set", "is not known; name it with -s DATASET"));
    }
    let options = DatasetOptions { frame: Some(*frame), ..session::options(data, white_background, host)? };
    session::open(data, &options, stop)
}
