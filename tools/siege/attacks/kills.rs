//! Trainings that are killed or interrupted, and resumed.

use crate::page::Page;
use crate::program::Program;
use crate::siege::{Result, Siege, ensure, text};
use crate::training::{self, LONGEST};
use std::path::Path;
use std::time::{Duration, Instant};

/// Exit code after Ctrl-C.
const INTERRUPTED: i32 = 130;
/// Fraction of a run between two ends. The golden ratio spreads them, so that no two fall on the same moment.
const GOLDEN: f64 = 0.618_033_988_75;

pub fn killed(siege: &Siege) -> Result<String> {
    besiege(siege, true)
}

pub fn interrupted(siege: &Siege) -> Result<String> {
    besiege(siege, false)
}

/// After this time the fewest ends suffice.
const LONG: Duration = Duration::from_secs(90);
const FEWEST: u32 = 2;

/// Ends trainings at moments spread over their duration. Each resumes from the last one's files, to the same bits.
fn besiege(siege: &Siege, kills: bool) -> Result<String> {
    let wanted = siege.choose(2, 12);
    let begun = Instant::now();
    let data = training::data_of(siege)?;
    training::undisturbed(siege)?;
    let model = siege.new_folder("attacked")?;
    // A checkpoint after every iteration, so that one is always being written.
    let every: Vec<String> = (1..=training::ITERATIONS).map(|iteration| iteration.to_string()).collect();
    let every: Vec<&str> = every.iter().map(String::as_str).collect();
    let mut begin = training::arguments(text(&data)?, text(&model)?, &every);
    begin.push("--view=0");
    let go_on = [&begin[..], &["--start-checkpoint", "latest"]].concat();
    // Duration of a run once it is ready, measured on the first, which is not ended.
    let mut whole = None;
    let (mut ended, mut resumed, mut whole_runs) = (0, 0, 0);
    for moment in 0..4 * wanted {
        let enough = resumed > 0 && (ended >= wanted || ended >= FEWEST && begun.elapsed() > LONG);
        if enough && whole_runs > 1 {
            break;
        }
        let continues = model.join("last_checkpoint").exists();
        let arguments = if continues { &go_on } else { &begin };
        let mut program = Program::start(siege, arguments)?;
        let host = program.host()?;
        let start = Instant::now();
        let page = Page::open(&host);
        if let Some(whole) = whole.filter(|_| !enough) {
            std::thread::sleep(Duration::mul_f64(whole, (GOLDEN * f64::from(moment)) % 1.0));
            if kills {
                program.kill();
            } else {
                program.interrupt();
            }
        }
        let ending = program.end(LONGEST)?;
        drop(page);
        match ending.code {
            None if kills => ended += 1,
            Some(INTERRUPTED) if !kills => ended += 1,
            Some(0) => {
                whole.get_or_insert(start.elapsed());
                whole_runs += 1;
                check(siege, &model)?;
                std::fs::remove_dir_all(&model)?;
                continue;
            }
            _ => return Err(format!("ends otherwise: {ending}").into()),
        }
        resumed += u32::from(continues);
    }
    ensure!(
        ended >= FEWEST && resumed > 0 && whole_runs > 1,
        "{ended} were ended, {resumed} of them had gone on, {whole_runs} came to their end"
    );
    let what = if kills { "killed" } else { "interrupted" };
    Ok(format!("{ended} {what}, {resumed} of them had gone on from a checkpoint; same bits at each end"))
}

/// The result has the same bits as without an attack, and no half-written file remains.
fn check(siege: &Siege, model: &Path) -> Result<()> {
    training::check_result(siege, model, &training::CHECKPOINTS)?;
    let mut folders = vec![model.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder)? {
            let entry = entry?;
            let name = entry.file_name().to_string_lossy().into_owned();
            ensure!(!name.starts_with('.') && !name.ends_with(".tmp"), "{name} was left over");
            if entry.file_type()?.is_dir() {
                folders.push(entry.path());
            }
        }
    }
    Ok(())
}
