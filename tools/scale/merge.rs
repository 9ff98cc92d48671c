//! `ashsplat merge`.

mod report;
mod seams;

use ashsplat::Result;
use ashsplat::scene::WorldFrame;
use ashsplat_files::splats::{self, ConvertOptions, Format, Input};
use ashsplat_program::args::DeviceArguments;
use ashsplat_program::blocks::BlocksFile;
use ashsplat_program::blocks::result::{UnusableBlocks, scene_of};
use ashsplat_program::lock::{FolderLock, LockKind};
use ashsplat_program::output;
use ashsplat_program::progress::{counting, thousands};
use clap::Args;
use report::ReportSetup;
use std::path::{Path, PathBuf};

/// Merge the trained blocks of `ashsplat partition` into one scene.
///
/// The scene has the Gaussians of each block with centres in its cell, so that none is lost or doubled. Blocks are read one
/// after another, so memory does not depend on their number, except for .compressed.ply, which is sorted. A block that is
/// missing, damaged or of another division is named before anything is written.
#[derive(Args)]
#[command(
    mut_arg("device", |argument| argument.requires("report")),
    mut_arg("validation", |argument| argument.requires("report")),
    mut_arg("max_memory", |argument| argument.requires("report")),
    mut_arg("subgroup_size", |argument| argument.requires("report")),
    mut_arg("backend", |argument| argument.requires("report"))
)]
pub struct Arguments {
    /// The file that `ashsplat partition` wrote
    #[arg(value_name = "BLOCKS.json")]
    blocks: PathBuf,
    /// The scene; its extension says the format, as for convert
    #[arg(short, long, value_name = "OUT")]
    out: PathBuf,
    /// A page with the quality on held-out photos, overall, inside of blocks and along their seams, with pictures of the worst
    /// seam, and a JSON beside it; needs the memory of the scene
    #[arg(long, value_name = "FILE.html")]
    report: Option<PathBuf>,
    /// Another model to measure beside the merged scene, such as one that was trained as a whole
    #[arg(long, value_name = "MODEL", requires = "report")]
    against: Option<PathBuf>,
    /// Drop the Gaussians whose parameters are not finite, instead of refusing their block
    #[arg(long)]
    drop_invalid: bool,
    #[command(flatten)]
    device: DeviceArguments,
    /// Print only errors
    #[arg(long)]
    quiet: bool,
}

const WORK: LockKind = LockKind { file: ".merge.lock", what: "merge", option: "-o" };

/// Path of the report's JSON, such as quality/page.html.json. It keeps .html, so that a report blocks.html does not replace
/// blocks.json.
fn results_beside(page: &Path) -> PathBuf {
    let mut name = page.as_os_str().to_owned();
    name.push(".json");
    name.into()
}

pub fn run(arguments: &Arguments) -> Result<()> {
    let json = arguments.report.as_deref().map(results_beside);
    let results: [(&'static str, Option<&Path>); 3] = [
        ("--out", Some(&arguments.out)),
        ("--report", arguments.report.as_deref()),
        ("--report's JSON", json.as_deref()),
    ];
    output::check(&results)?;
    Format::of_extension(&arguments.out)?;
    let file = BlocksFile::read(&arguments.blocks)?;
    let scenes = scenes(&file, arguments.quiet)?;
    let others = [arguments.blocks.clone(), file.at(&file.division.coarse.path)];
    output::check_apart(&results, &[&scenes[..], &others].concat())?;
    // Everything that the report needs is checked before the work.
    let setup = arguments.report.as_ref().map(|page| ReportSetup::new(page, arguments, &file)).transpose()?;
    output::in_folder(&arguments.out, |out| {
        let folder = out.parent().filter(|folder| !folder.as_os_str().is_empty());
        let _lock = FolderLock::take(folder.unwrap_or(Path::new(".")), &WORK, None)?;
        output::remove_leftovers_of(out);
        arguments.merge(&file, &scenes, out)
    })?;
    setup.map_or(Ok(()), |setup| setup.measure(arguments, &file))
}

impl Arguments {
    fn merge(&self, file: &BlocksFile, scenes: &[PathBuf], out: &Path) -> Result<()> {
        let blocks = &file.division.blocks;
        // Positions in the blocks' files are in source units.
        let frame = WorldFrame { unit: 1.0, ..file.division.frame() };
        let parts = scenes.iter().zip(blocks);
        let parts: Vec<Input<'_>> = parts
            .map(|(path, block)| Input { within: Some(block.core.bounds(&frame)), ..Input::new(path) })
            .collect();
        let read = self.device.host.reading(self.drop_invalid);
        let done = splats::join(&parts, out, &ConvertOptions { read, ..Default::default() })?;
        for warning in &done.warnings {
            errln!("warning: {warning}");
        }
        if !self.quiet {
            for (block, written) in blocks.iter().zip(&done.taken) {
                outln!("block {}: {} Gaussians", block.number, thousands(*written));
            }
            let (count, sum) = (blocks.len(), done.written);
            let (out, format, degree) = (out.display(), done.format, done.sh_degree);
            outln!("{count} blocks -> {out} ({format}, {} Gaussians, SH degree {degree})", thousands(sum));
        }
        Ok(())
    }
}

/// The trained scenes of all blocks. Refuses a division with unsuitable blocks, and names them.
fn scenes(file: &BlocksFile, quiet: bool) -> Result<Vec<PathBuf>> {
    let blocks = &file.division.blocks;
    let bar = counting("blocks checked", blocks.len() as u64, quiet);
    let (mut scenes, mut unusable) = (Vec::new(), UnusableBlocks::new());
    for block in blocks {
        match scene_of(file, block)? {
            Ok(scene) => scenes.push(scene),
            Err(why) => unusable.entry(why).or_default().push(block.number.to_string()),
        }
        bar.inc(1);
    }
    bar.finish_and_clear();
    file.check_all_usable("", &unusable)?;
    Ok(scenes)
}
