//! Runs the attacks one after the other and prints a row for each.

use crate::attacks::ATTACKS;
use crate::siege::Siege;
use clap::Parser;
use std::error::Error;
use std::io::ErrorKind;
use std::process::ExitCode;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

/// Attack a running trainer and viewer, the ashsplat beside this program: connections, floods, bombs, a full disk, limits.
#[derive(Parser)]
#[command(name = "siege", version)]
struct Arguments {
    /// Fewer and shorter attacks, on smaller data: half a minute
    #[arg(long)]
    short: bool,
}

/// No attack starts after this time.
const LONGEST: Duration = Duration::from_secs(600);

/// Exit code if the siege could not begin.
const FAILURE: u8 = 2;

pub fn run() -> ExitCode {
    let arguments = Arguments::parse();
    let siege = match begin(arguments.short) {
        Ok(siege) => siege,
        Err(error) => {
            eprintln!("error: {error}");
            return ExitCode::from(FAILURE);
        }
    };
    let start = Instant::now();
    println!("| attack | outcome | peak memory | time | |\n|---|---|---|---|---|");
    let (mut passed, mut skipped, mut failed) = (0, 0, 0);
    for (name, attack) in ATTACKS {
        siege.peak.store(0, Ordering::Relaxed);
        let begun = Instant::now();
        let outcome = match start.elapsed() < LONGEST {
            true => attack(&siege),
            false => Err("there was no time left for it".into()),
        };
        let (text, verdict, count) = match outcome {
            Ok(text) => (text, "passed", &mut passed),
            Err(reason) if is_impossible(&*reason) => (reason.to_string(), "skipped", &mut skipped),
            Err(error) => (error.to_string(), "**FAILED**", &mut failed),
        };
        *count += 1;
        let text = text.replace('|', "/").split_whitespace().collect::<Vec<_>>().join(" ");
        let (peak, seconds) = (siege.peak_mib(), begun.elapsed().as_secs_f64());
        println!("| {name} | {text} | {peak} MiB | {seconds:.1} s | {verdict} |");
    }
    println!(
        "\n{passed} passed, {failed} failed, {skipped} skipped in {:.0} s",
        start.elapsed().as_secs_f64()
    );
    if failed == 0 && passed > 0 { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

fn is_impossible(error: &(dyn Error + 'static)) -> bool {
    error.downcast_ref::<std::io::Error>().is_some_and(|error| error.kind() == ErrorKind::Unsupported)
}

/// The siege of the program beside this one.
fn begin(short: bool) -> crate::siege::Result<Siege> {
    let program = std::env::current_exe()?.with_file_name("ashsplat");
    if !program.is_file() {
        return Err(format!("{} is missing: cargo build --release", program.display()).into());
    }
    Siege::new(program, short)
}
