//! A training under attack. It must end with the same bits as without the attack.

use crate::data;
use crate::page::Page;
use crate::program::{Limits, Program};
use crate::siege::{Result, Siege, ensure, text};
use std::path::{Path, PathBuf};
use std::time::Duration;

pub const ITERATIONS: u32 = 120;
pub const CHECKPOINTS: [&str; 4] = ["30", "60", "90", "120"];
/// Longest time of an attacked training.
pub const LONGEST: Duration = Duration::from_secs(60);

/// Covers densification, an opacity reset, tests and checkpoints.
const SCHEDULE: [&str; 14] = [
    "--quiet",
    "--eval",
    "--sh_degree=1",
    "--densify_from_iter=5",
    "--densification_interval=20",
    "--densify_until_iter=75",
    "--opacity_reset_interval=62",
    "--iterations=120",
    "--test_iterations=40",
    "--save_iterations=50",
    "--checkpoint_iterations",
    CHECKPOINTS[0],
    CHECKPOINTS[1],
    CHECKPOINTS[2],
];

pub struct Training {
    pub program: Program,
    pub host: String,
    pub model: PathBuf,
}

pub fn arguments<'a>(data: &'a str, model: &'a str, more: &[&'a str]) -> Vec<&'a str> {
    [&["train", "-s", data, "-m", model], &SCHEDULE[..], &[CHECKPOINTS[3]], more].concat()
}

pub fn data_of(siege: &Siege) -> Result<PathBuf> {
    let folder = siege.place("small");
    if !folder.exists() {
        data::write_small(&folder)?;
    }
    Ok(folder)
}

/// The final scene of a training without attacks.
pub fn undisturbed(siege: &Siege) -> Result<Vec<u8>> {
    let model = siege.place("undisturbed");
    if !result_of(&model).exists() {
        let data = data_of(siege)?;
        let arguments = arguments(text(&data)?, text(&model)?, &[]);
        let ending = Program::start(siege, &arguments)?.end(2 * LONGEST)?;
        ensure!(ending.code == Some(0), "training fails without an attack: {ending}");
    }
    Ok(std::fs::read(result_of(&model))?)
}

/// File of a model folder's final scene.
pub fn result_of(model: &Path) -> PathBuf {
    model.join(format!("point_cloud/iteration_{ITERATIONS}/point_cloud.ply"))
}

impl Training {
    pub fn start(siege: &Siege, limits: &Limits) -> Result<Training> {
        // Runs first, so that its memory does not count for the attacked training.
        undisturbed(siege)?;
        let (data, model) = (data_of(siege)?, siege.new_folder("attacked")?);
        let arguments = arguments(text(&data)?, text(&model)?, &["--view=0"]);
        let mut program = Program::limited(siege, limits, &arguments)?;
        let host = program.host()?;
        Ok(Training { program, host, model })
    }

    /// Replaces a page's error by its cause: the training may have ended.
    pub fn explain<T>(&mut self, done: Result<T>) -> Result<T> {
        done.map_err(|error| match self.program.end(Duration::from_secs(2)) {
            Ok(ending) => format!("training ended with {ending}").into(),
            Err(_) => error,
        })
    }

    pub fn held(&self) -> Result<Page> {
        let mut page = Page::open(&self.host)?;
        page.hold()?;
        Ok(page)
    }

    /// Waits for the end, which must be the same as without an attack.
    pub fn check_end(&mut self, siege: &Siege) -> Result<()> {
        self.end()?;
        check_result(siege, &self.model, &CHECKPOINTS)
    }

    /// Waits for the end without an error; returns the program's stderr.
    pub fn end(&mut self) -> Result<String> {
        let ending = self.program.end(LONGEST)?;
        ensure!(ending.code == Some(0), "training ended with {ending}");
        Ok(ending.errors)
    }
}

/// Checks that the final scene and these checkpoints are there, the scene with the same bits as without an attack.
pub fn check_result(siege: &Siege, model: &Path, checkpoints: &[&str]) -> Result<()> {
    let result = std::fs::read(result_of(model)).map_err(|error| format!("the last scene: {error}"))?;
    ensure!(result == undisturbed(siege)?, "the last scene has other bits than without the attack");
    for iteration in checkpoints {
        let file = model.join(format!("chkpnt{iteration}.safetensors"));
        ensure!(file.is_file(), "there is no checkpoint of iteration {iteration}");
    }
    Ok(())
}
