//! Defines and parses the command line.

use crate::{convert, demo, devices, eval, info, inspect, mesh, poses, render, train};
use ashsplat::Result;
use ashsplat_files::HostMemory;
use ashsplat_program::output;
#[cfg(feature = "scale")]
use ashsplat_scale::{block_status, exchange, merge, partition, tiles};
use clap::error::{ContextKind, ContextValue, ErrorKind};
use clap::{ArgMatches, CommandFactory, FromArgMatches, Parser, Subcommand};
use std::ffi::OsString;
use std::process::ExitCode;

/// 3D Gaussian Splatting on any Vulkan device: train, render, examine.
///
/// Names may be written with hyphens or underscores (--sh-degree, --sh_degree).
#[derive(Parser)]
// Errors are formatted below, with the same name whatever the executable is called.
#[command(name = "ashsplat", bin_name = "ashsplat", version)]
struct CommandLine {
    #[command(subcommand)]
    command: Command,
}

/// Subcommands of the program.
#[derive(Subcommand)]
pub enum Command {
    /// Train a scene from a data set: COLMAP, transforms.json, or a ZIP of one
    Train(Box<train::Arguments>),
    /// Find the cameras of photographs or of a video by COLMAP: makes a data set for training
    Poses(poses::Arguments),
    /// Render a trained scene: a data set's views, an orbit or a camera path
    Render(render::Arguments),
    /// Look at a scene, a model or a data set in a browser
    #[cfg(feature = "view")]
    View(ashsplat_view::Arguments),
    /// PSNR and SSIM of a trained scene on a data set
    Eval(eval::Arguments),
    /// Show the contents of a file of Gaussians, a model folder or a data set, and whether it can be used
    Info(info::Arguments),
    /// Convert Gaussians between PLY, compressed PLY, .splat, SPZ, glTF and SOG; crop, move, thin out
    Convert(convert::Arguments),
    /// Divide a scene into blocks that are trained one by one, on any machines
    #[cfg(feature = "scale")]
    Partition(Box<partition::Arguments>),
    /// Show the training progress of each block
    #[cfg(feature = "scale")]
    Blocks(block_status::Arguments),
    /// Between two rounds of training in blocks: give each what its neighbours have trained
    #[cfg(feature = "scale")]
    Exchange(exchange::Arguments),
    /// Merge trained blocks into one scene
    #[cfg(feature = "scale")]
    Merge(merge::Arguments),
    /// Write a scene as a tree of tiles for viewers that stream: 3D Tiles
    #[cfg(feature = "scale")]
    Tiles(tiles::Arguments),
    /// Make a mesh of a trained scene: PLY, OBJ or GLB
    Mesh(mesh::Arguments),
    /// The Gaussians blended at one pixel, front to back
    Inspect(inspect::Arguments),
    /// The Vulkan devices of this machine, with the limits that matter
    Devices(devices::Arguments),
    /// Make a small data set, train on it and show the result
    Demo(demo::Arguments),
    /// Time of every kernel: scan, sort, render, train-step; comparisons, quality
    #[cfg(feature = "bench")]
    Bench(Box<ashsplat_bench::Arguments>),
    /// One frame or training step, kernel by kernel: page, trace, other constants, edited shaders
    #[cfg(feature = "bench")]
    Profile(Box<ashsplat_bench::profile::Arguments>),
}

/// Parses the command line. The error is the exit code of a run that is already over: `--help`, or a mistake, which has
/// been printed as one line.
pub fn parse(arguments: impl Iterator<Item = OsString>) -> Result<Command, ExitCode> {
    let mut definition = CommandLine::command();
    let read = definition.try_get_matches_from_mut(arguments.map(hyphenated)).and_then(|mut matches| {
        // Readers of small files get no budget from their callers, so the option sets the process's default.
        max_host_memory(&matches).into_iter().for_each(HostMemory::set_default);
        CommandLine::from_arg_matches_mut(&mut matches)
    });
    match read.map_err(|error| error.format(&mut definition)) {
        Ok(line) => Ok(line.command),
        Err(error) if matches!(error.kind(), ErrorKind::DisplayHelp | ErrorKind::DisplayVersion) => {
            // A closed pipe (`ashsplat --help | head`) is not a failure.
            output::note(error.print());
            Err(match output::check_stdout() {
                Ok(()) => ExitCode::SUCCESS,
                Err(error) => {
                    errln!("error: {}", crate::one_line(&error.to_string()));
                    ExitCode::from(crate::FAILURE)
                }
            })
        }
        Err(error) => {
            errln!("{}", summary(&error));
            Err(ExitCode::from(crate::FAILURE))
        }
    }
}

/// Value of `--max-host-memory`, in any command.
fn max_host_memory(matches: &ArgMatches) -> Option<u64> {
    let own = matches.try_get_one::<u64>("max_host_memory").ok().flatten().copied();
    own.or_else(|| max_host_memory(matches.subcommand()?.1))
}

/// Clap's message up to its first empty line, as one line.
fn summary(error: &clap::Error) -> String {
    if error.kind() == ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand {
        return "error: no command given; `ashsplat --help` lists them".into();
    }
    let text = error.to_string();
    let first = crate::one_line(text.split("\n\n").next().unwrap_or_default());
    let option: &str = match error.get(ContextKind::InvalidArg) {
        Some(ContextValue::String(option)) if error.kind() == ErrorKind::UnknownArgument => option,
        _ => "",
    };
    let owners = owners(option);
    // An option of another command is likelier than one of this command that begins differently.
    let begin = |word: &str| word.chars().take(LIKE).collect::<String>();
    let suggestion = suggestion(error).filter(|word| owners.is_empty() || begin(word) == begin(option));
    let meant = folder_of_training(error).map(|folder| format!("-s {folder}")).or(suggestion);
    let hint = match meant {
        Some(meant) => format!("; did you mean '{meant}'?"),
        None if owners.is_empty() => ";".to_owned(),
        None => format!(
            ": it is an option of `{}`; leave it out, or give it after the command;",
            owners.join("`, `")
        ),
    };
    format!("{first}{hint} see --help")
}

/// Number of first characters of an option, with its hyphens, that a typing error leaves intact.
const LIKE: usize = 5;

/// A folder after `train` without an option, which is how other programs take the data set.
fn folder_of_training(error: &clap::Error) -> Option<&str> {
    let usage = error.get(ContextKind::Usage)?.to_string();
    match error.get(ContextKind::InvalidArg)? {
        ContextValue::String(word) if !word.starts_with('-') && usage.contains("ashsplat train") => {
            Some(word)
        }
        _ => None,
    }
}

/// The option, command or value with a similar name.
fn suggestion(error: &clap::Error) -> Option<String> {
    let kinds = [ContextKind::SuggestedArg, ContextKind::SuggestedSubcommand, ContextKind::SuggestedValue];
    kinds.into_iter().find_map(|kind| match error.get(kind)? {
        ContextValue::String(word) => Some(word.clone()),
        ContextValue::Strings(words) => words.first().cloned(),
        _ => None,
    })
}

/// The commands that have an option ("--windows").
fn owners(option: &str) -> Vec<String> {
    fn collect(command: &clap::Command, path: &str, name: &str, found: &mut Vec<String>) {
        if command.get_arguments().any(|argument| argument.get_long() == Some(name)) {
            found.push(path.to_owned());
        }
        for next in command.get_subcommands() {
            collect(next, format!("{path} {}", next.get_name()).trim(), name, found);
        }
    }
    let mut found = Vec::new();
    if let Some(name) = option.strip_prefix("--") {
        collect(&CommandLine::command(), "", name.split('=').next().unwrap_or(name), &mut found);
    }
    found
}

/// Turns `--sh_degree=3` into `--sh-degree=3`: the reference's names have underscores.
fn hyphenated(argument: OsString) -> OsString {
    let Some(text) = argument.to_str().filter(|text| text.starts_with("--")) else { return argument };
    match text.split_once('=') {
        Some((name, value)) => format!("{}={value}", name.replace('_', "-")).into(),
        None => text.replace('_', "-").into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn definition_is_consistent() {
        CommandLine::command().debug_assert();
    }

    #[test]
    fn slips_are_told_what_was_meant() {
        let error = |arguments: &[&str]| {
            let words = std::iter::once(&"ashsplat").chain(arguments);
            summary(&CommandLine::try_parse_from(words).err().expect("a slip"))
        };
        assert!(error(&["train", "--iteration", "100"]).contains("did you mean '--iterations'?"));
        assert!(error(&["trian"]).ends_with("did you mean 'train'? see --help"), "{}", error(&["trian"]));
        assert!(error(&["train", "my_scene"]).ends_with("; did you mean '-s my_scene'? see --help"));
        assert!(error(&["bench", "sort", "--xyzzy"]).ends_with("found; see --help"));
        let early = error(&["--iteration", "100"]);
        assert!(early.contains("`render`") && !early.contains("--version"), "{early}");
        let early = error(&["--iterations", "100"]);
        assert!(early.contains("`train`") && early.contains("after the command"), "{early}");
        assert!(error(&["--xyzzy"]).ends_with("found; see --help"), "{}", error(&["--xyzzy"]));
        assert!(error(&["--versoin"]).contains("did you mean '--version'?"), "{}", error(&["--versoin"]));
    }
}
