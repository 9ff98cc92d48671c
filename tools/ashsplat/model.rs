//! Where a trained scene lies: a PLY, or a folder as training leaves it.

use crate::config::Settings;
use ashsplat::{Error, Result};
use std::path::{Path, PathBuf};

/// A trained scene.
pub struct Model {
    /// The Gaussians.
    pub ply: PathBuf,
    /// The model folder and the iteration of the PLY in it; none for a bare PLY.
    pub folder: Option<(PathBuf, u32)>,
    /// What the run was made with; defaults for a bare PLY.
    pub settings: Settings,
}

impl Model {
    /// Finds the PLY of a model folder (of the given iteration, else of the last) or takes a PLY as it is.
    pub fn locate(path: &Path, iteration: Option<u32>) -> Result<Model> {
        if !path.is_dir() {
            std::fs::metadata(path).map_err(|e| Error::io(path, "read", e))?;
            return Ok(Model { ply: path.to_owned(), folder: None, settings: Settings::default() });
        }
        let clouds = path.join("point_cloud");
        let iteration = match iteration {
            Some(iteration) => iteration,
            None => last_iteration(&clouds).ok_or_else(|| {
                let remedy = "give a model folder as `ashsplat train -m` writes it, or a PLY";
                Error::input(path, "has no point_cloud/iteration_N/point_cloud.ply", remedy)
            })?,
        };
        let ply = point_cloud_path(path, iteration);
        std::fs::metadata(&ply).map_err(|e| Error::io(&ply, "read", e))?;
        Ok(Model { ply, folder: Some((path.to_owned(), iteration)), settings: Settings::of_model(path)? })
    }
}

/// `point_cloud/iteration_N/point_cloud.ply` of a model folder.
pub fn point_cloud_path(folder: &Path, iteration: u32) -> PathBuf {
    folder.join("point_cloud").join(format!("iteration_{iteration}")).join("point_cloud.ply")
}

fn last_iteration(clouds: &Path) -> Option<u32> {
    let entries = std::fs::read_dir(clouds).ok()?.filter_map(|entry| entry.ok());
    let iteration = |name: &str| name.strip_prefix("iteration_")?.parse::<u32>().ok();
    let saved = entries.filter(|entry| entry.path().join("point_cloud.ply").is_file());
    saved.filter_map(|entry| iteration(entry.file_name().to_str()?)).max()
}
