//! Rounds: all blocks are trained for a share of their iterations, exchange the Gaussians near their borders, and
//! continue. This module keeps the notes about rounds.

use super::job::Job;
use super::{Block, BlocksFile, Division};
use crate::output;
use ashsplat::Result;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Name of the note in a block's model folder, written at the end of each round except the last.
pub const ROUND_FILE: &str = "round.json";
/// Largest number of rounds; more would exchange every few iterations.
pub const MAX_ROUNDS: u32 = 100;
/// Iterations; each round ends at a multiple of this. Other ends would change the bits of trainings in rounds.
const STEP: u32 = 20;

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RoundNote {
    /// Hash of the division's file.
    pub blocks: String,
    pub block: u32,
    /// Number of the round, from 1.
    pub round: u32,
    /// Iteration of its checkpoint.
    pub iteration: u32,
}

/// A complete exchange.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct ExchangeNote {
    /// Hash of the division's file.
    blocks: String,
    /// The round before the exchange.
    round: u32,
}

impl Division {
    /// The iteration at which a round (from 1) of a block ends.
    pub fn round_end(&self, block: &Block, round: u32) -> u32 {
        if round >= self.rounds {
            return block.iterations;
        }
        let share = u64::from(block.iterations) * u64::from(round) / u64::from(self.rounds);
        let share = share as u32;
        if share < STEP { share } else { share / STEP * STEP }
    }

    /// Refuses a number of rounds that leaves some block a round without iterations.
    pub fn check_rounds(&self) -> Result<(), String> {
        let rounds = self.rounds;
        if !(1..=MAX_ROUNDS).contains(&rounds) {
            return Err(format!("its rounds are {rounds}, must be 1 to {MAX_ROUNDS}"));
        }
        for block in &self.blocks {
            let ends: Vec<u32> = (1..=rounds).map(|round| self.round_end(block, round)).collect();
            if ends[0] == 0 || ends.windows(2).any(|ends| ends[0] >= ends[1]) {
                let Block { number, iterations, .. } = block;
                return Err(format!(
                    "block {number} has {iterations} iterations, too few for {rounds} rounds"
                ));
            }
        }
        Ok(())
    }
}

impl BlocksFile {
    /// Path of the scene of all blocks that the exchange after a round writes.
    pub fn exchanged_scene(&self, round: u32) -> PathBuf {
        self.path.with_extension("").join(format!("round_{round}.ply"))
    }

    fn exchange_note(&self, round: u32) -> PathBuf {
        self.path.with_extension("").join(format!("round_{round}.json"))
    }

    pub fn exchanges(&self) -> u32 {
        (1..self.division.rounds).rev().find(|&round| self.is_exchanged(round)).unwrap_or(0)
    }

    fn is_exchanged(&self, round: u32) -> bool {
        let note = output::read_note(&self.exchange_note(round));
        let note: Option<ExchangeNote> = note.and_then(|text| serde_json::from_str(&text).ok());
        note == Some(ExchangeNote { blocks: self.hash.clone(), round })
    }

    pub fn note_exchange(&self, round: u32) -> Result<()> {
        output::write_json(&self.exchange_note(round), &ExchangeNote { blocks: self.hash.clone(), round })
    }

    pub fn ended_own(&self, block: &Block) -> Option<RoundNote> {
        self.ended(block).filter(|ended| ended.blocks == self.hash && ended.block == block.number)
    }

    /// The last round that a block has ended in any division.
    pub fn ended(&self, block: &Block) -> Option<RoundNote> {
        serde_json::from_str(&output::read_note(&self.at(&block.folder).join(ROUND_FILE))?).ok()
    }
}

pub struct CurrentRound {
    /// Number of the round, from 1.
    pub round: u32,
    pub rounds: u32,
    file: PathBuf,
    pub until: u32,
    pub from: u32,
    /// The scene around the block, unless it is the coarse model.
    pub surroundings: Option<PathBuf>,
    pub is_done: bool,
}

impl CurrentRound {
    /// The round after all complete exchanges.
    pub fn of(job: &Job) -> CurrentRound {
        let (file, block) = (&job.file, job.block());
        let division = &file.division;
        let before = file.exchanges();
        let round = before + 1;
        let end = |round: u32| if round > 0 { division.round_end(block, round) } else { 0 };
        let ended = file.ended_own(block);
        CurrentRound {
            round,
            rounds: division.rounds,
            file: file.path.clone(),
            until: end(round),
            from: end(before),
            surroundings: (before > 0).then(|| file.exchanged_scene(before)),
            is_done: round < division.rounds && ended.is_some_and(|ended| ended.round == round),
        }
    }

    /// True if the block's training ends with this round.
    pub fn is_last(&self) -> bool {
        self.round == self.rounds
    }

    /// Reports that the round has ended, and the next command.
    pub fn print_done(&self) {
        let CurrentRound { round, rounds, .. } = self;
        let file = self.file.display();
        outln!("round {round} of {rounds} is done; when it is for all blocks: ashsplat exchange {file}");
    }

    /// The checkpoint that an exchange has left in a model folder; `None` in the first round.
    pub fn exchanged(&self, folder: &Path) -> Option<PathBuf> {
        (self.round > 1).then(|| exchanged_checkpoint(folder, self.from))
    }
}

pub fn note(job: &Job, folder: &Path, current: &CurrentRound) -> Result<()> {
    let (blocks, block) = (job.file.hash.clone(), job.block().number);
    let ended = RoundNote { blocks, block, round: current.round, iteration: current.until };
    output::write_json(&folder.join(ROUND_FILE), &ended)
}

/// `exchangedN.safetensors` of a model folder.
pub fn exchanged_checkpoint(folder: &Path, iteration: u32) -> PathBuf {
    folder.join(format!("exchanged{iteration}.safetensors"))
}
