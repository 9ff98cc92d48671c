//! Checkpoints of a run: their paths, the newest one, and the one to continue from.

use super::Run;
use ashsplat::train::strategy::Actions;
use ashsplat::train::{Checkpoint, TrainParts, TrainSettings, TrainView, Trainer};
use ashsplat::vk::Context;
use ashsplat::{Error, Result};
use ashsplat_files::{CheckpointFile, quoted};
use ashsplat_program::args::{DeviceArguments, HostArguments};
use ashsplat_program::config::SETTINGS_FILE;
use ashsplat_program::model::{CHECKPOINT_EXTENSION, checkpoint_path};
use ashsplat_program::{args, output};
use std::ffi::OsString;
use std::path::{Path, PathBuf};

/// Name for [`StartFrom::Latest`] in place of a file.
const LATEST: &str = "latest";
/// File with the iteration of the newest checkpoint. It may not be the highest, if an earlier training left its
/// checkpoints.
const LAST_FILE: &str = "last_checkpoint";
/// File with the iterations of passing checkpoints, which are removed when a newer one is written.
const PASSING_FILE: &str = "passing_checkpoints";

#[derive(Clone, Debug, PartialEq, Eq)]
pub enum StartFrom {
    Latest,
    /// The newest checkpoint, or a new start without one: for schedulers that retry.
    Auto,
    File(PathBuf),
    /// The checkpoint that an exchange has made at the end of a round.
    Exchanged(PathBuf),
}

impl From<OsString> for StartFrom {
    fn from(text: OsString) -> Self {
        match text.to_str() {
            Some(LATEST) => Self::Latest,
            Some("auto") => Self::Auto,
            _ => Self::File(text.into()),
        }
    }
}

pub struct ResumePoint {
    pub from: StartFrom,
    path: PathBuf,
    pub checkpoint: Checkpoint,
}

impl ResumePoint {
    /// Finds and reads the checkpoint; `None` if [`StartFrom::Auto`] finds none.
    pub fn find(from: &StartFrom, folder: &Path, host: &HostArguments) -> Result<Option<ResumePoint>> {
        let path = match from {
            StartFrom::Latest => newest(folder).ok_or_else(|| no_checkpoint(folder))?,
            StartFrom::Auto => match newest(folder) {
                Some(path) => path,
                None => return Ok(None),
            },
            StartFrom::File(path) | StartFrom::Exchanged(path) => path.clone(),
        };
        let checkpoint = Checkpoint::read_within(&path, &host.memory())?;
        Ok(Some(ResumePoint { from: from.clone(), path, checkpoint }))
    }

    /// Prepares to continue in the model folder. A passing checkpoint that was named explicitly is kept.
    pub fn keep(&self, folder: &Path) -> Result<()> {
        let passing = passing(folder);
        if matches!(self.from, StartFrom::File(_)) && passing.contains(&self.iteration()) {
            return note_passing(folder, passing.into_iter().filter(|n| *n != self.iteration()));
        }
        Ok(())
    }

    /// True if it is a checkpoint of the training in this folder.
    pub fn is_of(&self, folder: &Path) -> bool {
        let parent = self.path.canonicalize().ok().and_then(|path| Some(path.parent()?.to_owned()));
        parent.is_some() && parent == folder.canonicalize().ok()
    }

    pub fn iteration(&self) -> u32 {
        self.checkpoint.iteration
    }

    /// Warns of differences that may change the result's bits.
    pub fn warn(&self, context: &Context) {
        let (device, driver) = (context.device_name(), &context.description().driver);
        for difference in self.checkpoint.differences(device, driver, &context.limits().kernel_forms()) {
            errln!(
                "warning: {}: {difference}; the result may differ from that of a run without interruption",
                self.path.display()
            );
        }
        let size_text = |bytes: Option<u64>| bytes.map_or("none".into(), args::size);
        let (there, here) = (self.checkpoint.capacities.max_memory, context.max_memory());
        if there != here {
            errln!(
                "warning: {}: was made with --max-memory {}, here it is {}; densification may stop elsewhere, and the \
                 result may differ from that of a run without interruption",
                self.path.display(),
                size_text(there),
                size_text(here)
            );
        }
    }

    pub fn trainer(
        &self,
        context: &Context,
        views: Vec<TrainView>,
        (settings, scene_extent): (&TrainSettings, f32),
        parts: TrainParts,
    ) -> Result<Trainer> {
        let trainer = Trainer::resume_with_parts(
            context,
            views,
            scene_extent,
            settings.clone(),
            parts,
            &self.checkpoint,
        );
        trainer.map_err(|error| match error {
            Error::Argument { problem, .. } => {
                Error::input(&self.path, problem, "or start anew without --start-checkpoint")
            }
            other => other,
        })
    }
}

/// Same as [`write`], and removes the passing checkpoints. The new one is passing too, unless it `stays`.
fn write_passing(folder: &Path, checkpoint: &Checkpoint, stays: bool) -> Result<PathBuf> {
    let iteration = checkpoint.iteration;
    let before: Vec<u32> = passing(folder).into_iter().filter(|n| *n != iteration).collect();
    let own = if stays { None } else { Some(iteration) };
    // The note comes first, so that after a kill it still lists every passing checkpoint.
    note_passing(folder, before.iter().copied().chain(own))?;
    let path = write(folder, checkpoint)?;
    for n in before {
        std::fs::remove_file(checkpoint_path(folder, n)).ok();
    }
    note_passing(folder, own)?;
    Ok(path)
}

fn passing(folder: &Path) -> Vec<u32> {
    let note = output::read_note(&folder.join(PASSING_FILE)).unwrap_or_default();
    note.split_whitespace().filter_map(|n| n.parse().ok()).collect()
}

fn note_passing(folder: &Path, iterations: impl IntoIterator<Item = u32>) -> Result<()> {
    let lines: String = iterations.into_iter().map(|n| format!("{n}\n")).collect();
    output::write_text(&folder.join(PASSING_FILE), &lines)
}

/// Writes a checkpoint, and notes that it is the newest.
pub fn write(folder: &Path, checkpoint: &Checkpoint) -> Result<PathBuf> {
    let path = checkpoint_path(folder, checkpoint.iteration);
    checkpoint.write(&path)?;
    output::write_text(&folder.join(LAST_FILE), &format!("{}\n", checkpoint.iteration))?;
    Ok(path)
}

impl Run {
    /// Notes the arguments that settings.toml lacks and the result's bits depend on.
    pub fn repeat(
        &mut self,
        device: &DeviceArguments,
        photo_memory: Option<u64>,
        offload: Option<Option<u64>>,
    ) {
        let photos = photo_memory.map(|bytes| format!(" --photo-memory {}", args::size(bytes)));
        let size = |bytes: u64| format!(" {}", args::size(bytes));
        let offload = offload.map(|bytes| format!(" --offload{}", bytes.map_or_else(String::new, size)));
        self.repeated = device.repeated() + &photos.unwrap_or_default() + &offload.unwrap_or_default();
    }

    /// The command line that continues from the newest checkpoint.
    fn command_to_go_on(&self) -> String {
        let data = &self.settings.data;
        // It must work in any folder, but the settings have paths as they were typed.
        let absolute = |path: &Path| quoted(&output::absolute(path).to_string_lossy());
        let relative = [("-s", &data.source_path), ("-m", &data.model_path)];
        let relative = relative.iter().filter(|(_, path)| path.is_relative());
        let mut places: String =
            relative.map(|(option, path)| format!(" {option} {}", absolute(path))).collect();
        if data.lpips_weights.iter().any(|path| path.is_relative()) {
            // On a command line, --lpips-weights replaces the whole list of the settings, so absolute paths are repeated too.
            places
                .extend(data.lpips_weights.iter().map(|path| format!(" --lpips-weights {}", absolute(path))));
        }
        let settings = absolute(&data.model_path.join(SETTINGS_FILE));
        format!("ashsplat train --config {settings}{places} --start-checkpoint {LATEST}{}", self.repeated)
    }

    /// Advice on an older checkpoint, for when the current state is lost.
    pub(super) fn older_checkpoint(&self) -> Option<String> {
        let older = self.checkpointed?;
        Some(format!("; to go on from iteration {older}, {}", self.command_to_go_on()))
    }

    pub(super) fn print_how_to_resume(&self, iteration: u32) {
        let command = self.command_to_go_on();
        // Printed even with --quiet: whoever stops a training needs it.
        self.progress.warn(&match iteration == self.settings.train.iterations {
            true => {
                format!("interrupted after the last iteration: to train longer, {command} --iterations N")
            }
            false => format!("interrupted: to go on, {command}"),
        });
    }

    /// Writes the log first, so that all iterations of the checkpoint are on disk.
    pub(super) fn write_checkpoint(&mut self) -> Result<()> {
        self.write_that(self.trainer.checkpoint()?)
    }

    fn write_that(&mut self, checkpoint: Checkpoint) -> Result<()> {
        let checkpoint = &Checkpoint { frame: self.views.frame, ..checkpoint };
        self.log.flush();
        let data = &self.settings.data;
        let (folder, iteration) = (&data.model_path, checkpoint.iteration);
        let path = match data.checkpoint_every {
            0 if !self.is_in_rounds => write(folder, checkpoint)?,
            _ => write_passing(folder, checkpoint, data.checkpoint_iterations.contains(&iteration))?,
        };
        self.checkpointed = Some(iteration);
        self.progress.note(&format!("checkpoint {}", path.display()));
        Ok(())
    }

    /// After a failure, saves the state of the earlier iterations, if it is not saved. A scene whose opacities the
    /// failed iteration has reset is nearly invisible, so only the checkpoint is written.
    pub(super) fn rescue(&mut self) {
        let iteration = self.trainer.iteration();
        if iteration == 0 || self.gaussians == 0 {
            return;
        }
        let checkpoint = self.trainer.checkpoint();
        // If the state is unavailable, the worst is assumed.
        let still_due = checkpoint.as_ref().map_or(Actions::NONE, |checkpoint| checkpoint.due);
        let done = self.trainer.actions_at(iteration).without(still_due);
        let reset = done.contains(Actions::RESET_OPACITY);
        let densified = done.contains(Actions::DENSIFY);
        if self.saved != Some(iteration) {
            let reason = if densified { "failed, densified already: " } else { "failed: " };
            let saved = match reset {
                true => Err(Error::argument("trainer", "the opacities may be reset already")),
                false => self.save(iteration, reason),
            };
            if let Err(error) = saved {
                errln!("warning: the scene is not saved: {error}");
            }
        }
        if self.checkpointed != Some(iteration)
            && let Err(error) = checkpoint.and_then(|checkpoint| self.write_that(checkpoint))
        {
            errln!("warning: no checkpoint: {error}{}", self.older_checkpoint().unwrap_or_default());
        }
    }
}

/// The names of all checkpoints in a folder, and of the notes about them.
pub fn names(folder: &Path) -> Vec<PathBuf> {
    let found = output::names(folder).into_iter();
    let notes = [LAST_FILE, PASSING_FILE];
    found
        .filter(|name| {
            notes.contains(&name.as_str()) || iteration_of(name).or(number_of(name, "exchanged")).is_some()
        })
        .map(PathBuf::from)
        .collect()
}

/// The number N of chkpntN.safetensors.
fn iteration_of(name: &str) -> Option<u32> {
    number_of(name, "chkpnt")
}

fn number_of(name: &str, kind: &str) -> Option<u32> {
    name.strip_prefix(kind)?.strip_suffix(CHECKPOINT_EXTENSION)?.strip_suffix('.')?.parse().ok()
}

/// The noted checkpoint, if it exists; else the one with the highest iteration.
fn newest(folder: &Path) -> Option<PathBuf> {
    let note = output::read_note(&folder.join(LAST_FILE));
    let noted =
        note.and_then(|text| text.trim().parse().ok()).map(|iteration| checkpoint_path(folder, iteration));
    if let Some(noted) = noted.filter(|path| path.is_file()) {
        return Some(noted);
    }
    let highest = names(folder).iter().filter_map(|name| iteration_of(name.to_str()?)).max();
    highest.map(|iteration| checkpoint_path(folder, iteration))
}

pub fn newest_iteration(folder: &Path) -> Option<u32> {
    iteration_of(newest(folder)?.file_name()?.to_str()?)
}

fn no_checkpoint(folder: &Path) -> Error {
    let earlier: Option<PathBuf> = (1..)
        .map(|n| folder.join(format!("earlier_{n}")))
        .take_while(|earlier| earlier.is_dir())
        .filter(|earlier| !names(earlier).is_empty())
        .last();
    let remedy = match earlier {
        Some(earlier) => {
            format!("those of an earlier training are in {0}: give -m {0}", earlier.display())
        }
        None => "checkpoints are written where --checkpoint-iterations and --checkpoint-every ask for them, and on Ctrl-C"
            .into(),
    };
    Error::input(folder, "has no checkpoint (chkpntN.safetensors) to go on from", remedy)
}
