//! Locates a trained scene: a PLY, or a model folder.

use crate::config::{CAMERAS_FILE, Settings};
use crate::output;
use ashsplat::{Error, Result};
use ashsplat_files::tiles::{TILESET_FILE, Tree};
use ashsplat_files::{Dataset, splats};
use clap::Args;
use std::path::{Path, PathBuf};

/// Which trained scene a command takes.
#[derive(Args)]
pub struct ModelArguments {
    /// A model folder or a file of Gaussians
    #[arg(value_name = "MODEL")]
    pub model: PathBuf,
    /// Iteration of the model folder's PLY [default: what was saved last]
    #[arg(long, value_name = "N")]
    pub iteration: Option<u32>,
}

impl ModelArguments {
    pub fn locate(&self) -> Result<Model> {
        Model::locate(&self.model, self.iteration)
    }
}

pub struct Model {
    pub ply: PathBuf,
    /// The model folder and the iteration of its PLY; `None` for a bare PLY.
    pub folder: Option<(PathBuf, u32)>,
    /// Settings of the training; defaults for a bare PLY.
    pub settings: Settings,
}

impl Model {
    /// Finds the PLY of a model folder (of the given iteration, else the newest). A path to a PLY is used directly.
    pub fn locate(path: &Path, iteration: Option<u32>) -> Result<Model> {
        let path = folder_of_tiles(path);
        if let Some(error) = splats::foreign(path) {
            return Err(error);
        }
        if !path.is_dir() || splats::is_sog(path) {
            std::fs::metadata(path).map_err(|e| Error::io(path, "read", e))?;
            if iteration.is_some() {
                let problem = format!("is for model folders; {} is a file", path.display());
                return Err(Error::argument("--iteration", problem));
            }
            return Ok(Model { ply: path.to_owned(), folder: None, settings: Settings::reference() });
        }
        if is_tiles(path) {
            Tree::open(path)?;
            let remedy = "give the scene that they were made of; `ashsplat render` draws the tiles";
            return Err(Error::input(path, "is a folder of tiles", remedy));
        }
        let iteration = match iteration {
            Some(iteration) => iteration,
            None => newest_iteration(path).ok_or_else(|| {
                let remedy = "give a model folder as `ashsplat train -m` writes it, or a PLY";
                Error::input(path, "has no point_cloud/iteration_N/point_cloud.ply", remedy)
            })?,
        };
        let ply = point_cloud_path(path, iteration);
        std::fs::metadata(&ply).map_err(|e| Error::io(&ply, "read", e))?;
        Ok(Model { ply, folder: Some((path.to_owned(), iteration)), settings: Settings::of_model(path)? })
    }

    /// The list of the training's cameras, if it is there.
    pub fn cameras_file(&self) -> Option<PathBuf> {
        let (folder, _) = self.folder.as_ref()?;
        Some(folder.join(CAMERAS_FILE)).filter(|path| path.is_file())
    }
}

/// `point_cloud/iteration_N/point_cloud.ply` of a model folder.
pub fn point_cloud_path(folder: &Path, iteration: u32) -> PathBuf {
    folder.join(POINT_CLOUDS).join(format!("iteration_{iteration}")).join("point_cloud.ply")
}

pub const CHECKPOINT_EXTENSION: &str = "safetensors";

/// `chkpntN.safetensors` of a model folder, named after the reference's chkpntN.pth.
pub fn checkpoint_path(folder: &Path, iteration: u32) -> PathBuf {
    folder.join(format!("chkpnt{iteration}.{CHECKPOINT_EXTENSION}"))
}

pub const POINT_CLOUDS: &str = "point_cloud";

fn is_tiles(path: &Path) -> bool {
    path.join(TILESET_FILE).is_file()
}

/// The folder of a tree of tiles whose description is named; other paths are unchanged.
pub fn folder_of_tiles(path: &Path) -> &Path {
    match path.parent().filter(|_| path.file_name().is_some_and(|name| name == TILESET_FILE)) {
        Some(parent) if parent.as_os_str().is_empty() => Path::new("."),
        parent => parent.unwrap_or(path),
    }
}

/// True if a path is a data set, not a scene or a model folder.
pub fn is_dataset(path: &Path) -> bool {
    let is_archive = path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("zip"))
        || Dataset::is_archive(path);
    let may_be = is_archive || path.is_dir() && !path.join(POINT_CLOUDS).is_dir() && !is_tiles(path);
    may_be && splats::foreign(path).is_none() && !splats::is_sog(path)
}

/// The model folder to propose for a data set: `out/NAME`.
pub fn usual_folder(dataset: &Path) -> String {
    let whole = dataset.canonicalize().ok();
    let whole = whole.as_deref().unwrap_or(dataset);
    let is_zip = whole.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("zip"));
    let name = if is_zip { whole.file_stem() } else { whole.file_name() };
    let name = name.map_or("scene".into(), |name| name.to_string_lossy());
    format!("out/{}", name.strip_suffix("_dataset").unwrap_or(&name))
}

/// File with the iteration that was saved last. It may not be the highest, if an earlier training left its point
/// clouds.
pub const LAST_ITERATION_FILE: &str = "last_iteration";

/// Notes the iteration whose point cloud was saved last.
pub fn note_saved(folder: &Path, iteration: u32) -> Result<()> {
    output::write_text(&folder.join(LAST_ITERATION_FILE), &format!("{iteration}\n"))
}

/// The iterations with a point cloud in a model folder, ascending.
fn saved_iterations(folder: &Path) -> Vec<u32> {
    let Ok(entries) = std::fs::read_dir(folder.join(POINT_CLOUDS)) else { return Vec::new() };
    let iteration = |name: &str| name.strip_prefix("iteration_")?.parse::<u32>().ok();
    let numbers = entries.filter_map(|entry| iteration(entry.ok()?.file_name().to_str()?));
    let mut saved: Vec<u32> = numbers.filter(|&n| point_cloud_path(folder, n).is_file()).collect();
    saved.sort_unstable();
    saved
}

/// The noted iteration, if its point cloud exists; else the highest, for folders of other programs.
fn newest_iteration(folder: &Path) -> Option<u32> {
    let note = output::read_note(&folder.join(LAST_ITERATION_FILE));
    let noted = note.and_then(|text| text.trim().parse::<u32>().ok());
    let noted = noted.filter(|&iteration| point_cloud_path(folder, iteration).is_file());
    noted.or_else(|| saved_iterations(folder).last().copied())
}
