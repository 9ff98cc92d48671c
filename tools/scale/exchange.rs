//! `ashsplat exchange`.

use ashsplat::scene::{Bounds, Gaussians};
use ashsplat::train::{BlockState, Checkpoint, SceneBlock, TrainSettings};
use ashsplat::{Error, Result};
use ashsplat_files::splats::WriteOptions;
use ashsplat_files::{CheckpointFile, splats};
use ashsplat_program::args::HostArguments;
use ashsplat_program::blocks::result::UnusableBlocks;
use ashsplat_program::blocks::rounds::exchanged_checkpoint;
use ashsplat_program::blocks::{Block, BlocksFile};
use ashsplat_program::lock::{FolderLock, LockKind};
use ashsplat_program::model::checkpoint_path;
use ashsplat_program::output;
use ashsplat_program::progress::{counting, thousands};
use clap::Args;
use glam::Vec3;
use std::path::PathBuf;

/// Between two rounds of training in blocks (`partition --rounds`): give each block what its neighbours have trained.
///
/// Every block must have come to the end of the round, where `train --job` ends. Its margin receives what the neighbours have
/// trained there, with everything that checkpoints hold of it, and its surroundings the scene of all blocks. Then `train --job`
/// continues. Blocks that were exchanged already stay as they are.
#[derive(Args)]
pub struct Arguments {
    /// The file that `ashsplat partition` wrote
    #[arg(value_name = "BLOCKS.json")]
    blocks: PathBuf,
    /// The round that all blocks have completed [default: that of the most advanced block]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    round: Option<u32>,
    #[command(flatten)]
    host: HostArguments,
    /// Print only errors
    #[arg(long)]
    quiet: bool,
}

const WORK: LockKind = LockKind { file: ".exchange.lock", what: "exchange", option: "BLOCKS.json" };

pub fn run(arguments: &Arguments) -> Result<()> {
    let file = BlocksFile::read(&arguments.blocks)?;
    let rounds = file.division.rounds;
    if rounds < 2 {
        let problem = "is of one round, without an exchange";
        let remedy =
            "make it anew: `ashsplat partition --rounds 5`, or merge its blocks when they are trained";
        return Err(Error::input(&file.path, problem, remedy));
    }
    let blocks = &file.division.blocks;
    let farthest = || blocks.iter().filter_map(|block| file.ended_own(block)).map(|ended| ended.round).max();
    let round = arguments.round.or_else(farthest).unwrap_or(1);
    if round >= rounds {
        let problem =
            format!("is {round}, but after the last of {rounds} rounds there is nothing to exchange");
        return Err(Error::argument("--round", problem + ": merge the blocks"));
    }
    let folder = file.path.with_extension("");
    let _lock = FolderLock::take(&folder, &WORK, None)?;
    if round <= file.exchanges() {
        if !arguments.quiet {
            outln!("round {round} of {rounds} is exchanged already");
        }
        return Ok(());
    }
    output::remove_leftovers(&folder, 0);
    Exchange::new(&file, round, arguments)?.run()
}

struct Exchange<'a> {
    file: &'a BlocksFile,
    round: u32,
    arguments: &'a Arguments,
}

impl<'a> Exchange<'a> {
    /// Refuses a division with blocks that have not ended the round, and names them.
    fn new(file: &'a BlocksFile, round: u32, arguments: &'a Arguments) -> Result<Self> {
        let mut unusable = UnusableBlocks::new();
        for block in &file.division.blocks {
            let folder = file.at(&block.folder);
            let iteration = file.division.round_end(block, round);
            let problem = match file.ended(block) {
                None => "not trained to the end of the round",
                Some(ended) if ended.blocks != file.hash || ended.block != block.number => {
                    "trained for another division"
                }
                Some(ended) if ended.round != round || ended.iteration != iteration => {
                    "at the end of another round"
                }
                Some(_) if !checkpoint_path(&folder, iteration).is_file() => {
                    "without the checkpoint of the round's end"
                }
                Some(_) => continue,
            };
            unusable.entry(problem).or_default().push(block.number.to_string());
        }
        file.check_all_usable(&format!("round {round}: "), &unusable)?;
        Ok(Exchange { file, round, arguments })
    }

    fn checkpoint(&self, block: &Block) -> Result<Checkpoint> {
        let iteration = self.file.division.round_end(block, self.round);
        let path = checkpoint_path(&self.file.at(&block.folder), iteration);
        let checkpoint = Checkpoint::read_within(&path, &self.arguments.host.memory())?;
        let (core, _) = self.file.division.core_and_margin(block);
        let other_core = |state: &BlockState| state.core != [core.min.to_array(), core.max.to_array()];
        let is_of_block = !checkpoint.block.as_ref().is_some_and(other_core);
        if checkpoint.iteration == iteration && checkpoint.frame == self.file.division.frame() && is_of_block
        {
            return Ok(checkpoint);
        }
        let problem = format!("is not that of iteration {iteration} of block {}", block.number);
        Err(Error::input(path, problem, "train the block again"))
    }

    /// A block's checkpoint with only those Gaussians in its own cell for which `within` is true.
    fn own(&self, block: &Block, within: impl Fn([f32; 3]) -> bool) -> Result<Checkpoint> {
        let mut checkpoint = self.checkpoint(block)?;
        let (core, _) = self.file.division.core_and_margin(block);
        let means = &checkpoint.gaussians.means;
        let is_own = |&row: &usize| core.contains(Vec3::from_array(means[row])) && within(means[row]);
        let rows: Vec<usize> = (0..means.len()).filter(is_own).collect();
        checkpoint.keep(&rows);
        Ok(checkpoint)
    }

    fn run(&self) -> Result<()> {
        let (file, round) = (self.file, self.round);
        let blocks = &file.division.blocks;
        // Checked before anything is written: damaged checkpoints and differing settings are errors.
        let scene = self.gather()?;
        let bar = counting("blocks exchanged", blocks.len() as u64, self.arguments.quiet);
        for block in blocks {
            let (own, neighbours) = self.exchanged(block, &scene)?;
            bar.inc(1);
            if !self.arguments.quiet {
                let [own, neighbours] = [own, neighbours].map(|count| thousands(count as u64));
                outln!("block {}: {own} Gaussians of its own, {neighbours} of its neighbours", block.number);
            }
        }
        bar.finish_and_clear();
        file.note_exchange(round)?;
        // The files of the earlier exchange are not needed any more.
        if round > 1 {
            std::fs::remove_file(file.exchanged_scene(round - 1)).ok();
            for block in blocks {
                let iteration = file.division.round_end(block, round - 1);
                std::fs::remove_file(exchanged_checkpoint(&file.at(&block.folder), iteration)).ok();
            }
        }
        if !self.arguments.quiet {
            let (rounds, path) = (file.division.rounds, file.path.display());
            outln!("round {round} of {rounds} is exchanged; go on with each: ashsplat train --job {path}:1");
        }
        Ok(())
    }

    /// Reads all checkpoints, and writes the scene of all blocks. Returns it as it is read again.
    fn gather(&self) -> Result<Gaussians> {
        let file = self.file;
        let blocks = &file.division.blocks;
        let bar = counting("blocks checked", blocks.len() as u64, self.arguments.quiet);
        let (mut first, mut scene) = (None::<TrainSettings>, Gaussians::default());
        for block in blocks {
            let own = self.own(block, |_| true)?;
            let settings = first.get_or_insert_with(|| own.settings.clone());
            if let Some(difference) = own.difference_of_settings(settings) {
                let problem = format!(
                    "block {} was trained with other settings than block 1: {difference}",
                    block.number
                );
                return Err(Error::input(&file.path, problem, "train all blocks with the same"));
            }
            if own.gaussians.is_empty() {
                let problem = format!("block {} has no Gaussians left in its cell", block.number);
                return Err(Error::input(&file.path, problem, "divide the scene into fewer blocks"));
            }
            match scene.is_empty() {
                true => scene = own.gaussians,
                false => scene.append(&own.gaussians),
            }
            bar.inc(1);
        }
        bar.finish_and_clear();
        let marks = first.map(|settings| WriteOptions::marking(&settings.render_settings()));
        let (path, frame) = (file.exchanged_scene(self.round), file.division.frame());
        let options = WriteOptions { frame, ..marks.unwrap_or_default() };
        splats::write(&path, &scene, &options)?;
        // Read back as trainings will read it: source units round it.
        let mut scene = splats::read(&path, &self.arguments.host.reading(false))?;
        scene.express_in(&frame);
        Ok(scene.gaussians)
    }

    /// Writes the checkpoint that a block continues from. Returns the numbers of its own and its neighbours' Gaussians.
    fn exchanged(&self, block: &Block, scene: &Gaussians) -> Result<(usize, usize)> {
        let file = self.file;
        let (core, margin) = file.division.core_and_margin(block);
        let mut checkpoint = self.own(block, |_| true)?;
        let own = checkpoint.gaussians.len();
        for other in &file.division.blocks {
            if other.number != block.number && touches(file.division.core_and_margin(other).0, core, margin) {
                checkpoint.append(&self.own(other, |mean| SceneBlock::contains(core, margin, mean))?)?;
            }
        }
        let around = SceneBlock::divide(scene, core, margin)?.1;
        checkpoint.settle_in(&around);
        let iteration = file.division.round_end(block, self.round);
        checkpoint.write(exchanged_checkpoint(&file.at(&block.folder), iteration))?;
        Ok((own, checkpoint.gaussians.len() - own))
    }
}

fn touches(cell: Bounds, core: Bounds, margin: f32) -> bool {
    cell.min.cmple(core.max + margin).all() && cell.max.cmpge(core.min - margin).all()
}
