//! `block.json` in a block's model folder: the note for the merge, written when training is complete.

use super::job::Job;
use super::rounds::ROUND_FILE;
use super::{Block, BlocksFile};
use crate::{model, output};
use ashsplat::{Error, Result};
use ashsplat_files::file_hash;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Name of the note in the model folder.
pub const RESULT_FILE: &str = "block.json";

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct BlockNote {
    /// Hash of the division's file.
    blocks: String,
    block: u32,
    iteration: u32,
    /// Hash of that iteration's point cloud.
    hash: String,
}

pub fn note(job: &Job, folder: &Path, iteration: u32) -> Result<()> {
    let hash = file_hash(model::point_cloud_path(folder, iteration))?;
    let trained = BlockNote { blocks: job.file.hash.clone(), block: job.block().number, iteration, hash };
    output::write_json(&folder.join(RESULT_FILE), &trained)
}

/// True if a job's training is complete, and its scene is unchanged.
pub fn is_done(job: &Job) -> bool {
    matches!(scene_of(&job.file, job.block()), Ok(Ok(_)))
}

/// True if any training in a folder has been noted as complete, or as at the end of a round.
pub fn is_noted(folder: &Path) -> bool {
    [RESULT_FILE, ROUND_FILE].iter().any(|note| folder.join(note).is_file())
}

/// True if a block's training is noted as complete for this division, false for another one; `None` without a readable
/// note. The scene itself is not checked.
pub fn noted(file: &BlocksFile, block: &Block) -> Option<bool> {
    let trained = read(&file.at(&block.folder)).ok().flatten()?;
    Some(trained.blocks == file.hash && trained.block == block.number)
}

/// Returns `None` if there is no note.
fn read(folder: &Path) -> Result<Option<BlockNote>> {
    let path = folder.join(RESULT_FILE);
    let Some(text) = output::read_note(&path) else { return Ok(None) };
    let damaged = |e: serde_json::Error| Error::input(&path, e.to_string(), "train the block again");
    serde_json::from_str(&text).map(Some).map_err(damaged)
}

/// Blocks that cannot be used, by their numbers, for each reason.
pub type UnusableBlocks = BTreeMap<&'static str, Vec<String>>;

impl BlocksFile {
    /// Refuses a division with unsuitable blocks, and names them by reason. `before` is the beginning of the error.
    pub fn check_all_usable(&self, before: &str, unusable: &UnusableBlocks) -> Result<()> {
        let Some(first) = unusable.values().next().map(|numbers| &numbers[0]) else { return Ok(()) };
        let reported = unusable.iter().map(|(why, numbers)| format!("{} {why}", numbers.join(", ")));
        let reported = reported.collect::<Vec<_>>().join("; ");
        let problem = format!("{before}of its {} blocks {reported}", self.division.blocks.len());
        let remedy = format!("train them: `ashsplat train --job {}:{first}`", self.path.display());
        Err(Error::input(&self.path, problem, remedy))
    }
}

/// The scene of a trained block, after a check of its hash; or why it cannot be merged.
pub fn scene_of(file: &BlocksFile, block: &Block) -> Result<Result<PathBuf, &'static str>> {
    const DAMAGED: &str = "damaged (its scene is not as training left it)";
    let folder = file.at(&block.folder);
    let trained = match read(&folder) {
        Ok(Some(trained)) => trained,
        Ok(None) => return Ok(Err("not trained to the end")),
        Err(_) => return Ok(Err(DAMAGED)),
    };
    if trained.blocks != file.hash || trained.block != block.number {
        return Ok(Err("trained for another division"));
    }
    let path = model::point_cloud_path(&folder, trained.iteration);
    if !path.is_file() {
        return Ok(Err(DAMAGED));
    }
    Ok(if file_hash(&path)? == trained.hash { Ok(path) } else { Err(DAMAGED) })
}
