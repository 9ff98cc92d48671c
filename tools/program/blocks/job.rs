//! Training of one block: `ashsplat train --job blocks.json:3`.

use super::{Block, BlocksFile};
use crate::output;
use ashsplat::{Error, Result};
use ashsplat_files::{Gallery, file_hash};
use std::path::Path;
use toml::{Table, Value};

pub struct Job {
    pub file: BlocksFile,
    index: usize,
}

impl Job {
    /// Parses FILE:NUMBER. In a training's settings, the hash of the file follows: FILE:NUMBER@HASH.
    pub fn find(text: &str) -> Result<Job> {
        let problem =
            || Error::argument("job", format!("'{text}': expected a file and a number, as blocks.json:3"));
        let (path, number) = text.rsplit_once(':').ok_or_else(problem)?;
        let (number, hash) = number.split_once('@').map_or((number, None), |(n, hash)| (n, Some(hash)));
        let number: usize = number.parse().map_err(|_| problem())?;
        let file = BlocksFile::read(Path::new(path))?;
        if hash.is_some_and(|hash| hash != file.hash) {
            let problem = format!("is another division than the one that block {number} was trained for");
            let again = format!("train it as a block of this one: `ashsplat train --job {path}:{number}`");
            let remedy = format!("{again}; to look at what was trained, give its data set by -s");
            return Err(Error::input(path, problem, remedy));
        }
        let blocks = file.division.blocks.len();
        match number.checked_sub(1).filter(|&index| index < blocks) {
            Some(index) => Ok(Job { file, index }),
            None => Err(Error::argument("job", format!("{path} has the blocks 1 to {blocks}, not {number}"))),
        }
    }

    /// The job named in a training's settings, if any.
    pub fn of(text: &str) -> Result<Option<Job>> {
        if text.is_empty() { Ok(None) } else { Job::find(text).map(Some) }
    }

    pub fn block(&self) -> &Block {
        &self.file.division.blocks[self.index]
    }

    /// Settings of the job, by their names in settings.toml.
    pub fn settings(&self) -> Result<Table> {
        let (division, block) = (&self.file.division, self.block());
        let absolute = |path: &Path| output::absolute(&self.file.at(path)).to_string_lossy().into_owned();
        let path = output::absolute(&self.file.path);
        let own: [(&str, Value); 10] = [
            ("job", format!("{}:{}@{}", path.display(), block.number, self.file.hash).into()),
            ("source_path", absolute(&division.dataset.path).into()),
            ("model_path", absolute(&block.folder).into()),
            ("eval_split", "reference".into()),
            // A block is part of a large scene and does not begin with points.
            ("few_photos", "off".into()),
            ("init", absolute(&division.coarse.path).into()),
            ("block", block.core.corners().map(|corner| corner.to_array()).concat().into()),
            ("margin", f64::from(division.margin).into()),
            ("scene_extent", f64::from(division.scene_extent).into()),
            ("iterations", i64::from(block.iterations).into()),
        ];
        let all = Table::try_from(&division.dataset).map_err(|e| Error::argument("job", e.to_string()))?;
        let of_dataset = all.into_iter().filter(|(name, _)| !["path", "cameras"].contains(&name.as_str()));
        Ok(of_dataset.chain(own.map(|(name, value)| (name.to_owned(), value))).collect())
    }

    /// Removes all photos except the block's. Refuses a data set with other cameras.
    pub fn choose_photos(&self, path: &Path, gallery: &mut Gallery) -> Result<()> {
        self.file.check_cameras(path, gallery)?;
        let block = self.block();
        gallery.keep(&block.photos.iter().chain(&block.held_out).cloned().collect())
    }

    /// Refuses another coarse model than the division's, wherever it lies.
    pub fn check_coarse(&self, path: &Path) -> Result<()> {
        if file_hash(path)? == self.file.division.coarse.hash {
            return Ok(());
        }
        let problem = format!("is not the coarse model that {} was made for", self.file.path.display());
        Err(Error::input(path, problem, "give that file, or make the blocks anew: `ashsplat partition`"))
    }
}
