//! `ashsplat tiles`.

mod comparison;

use ashsplat::{Error, Renderer, Result};
use ashsplat_files::tiles::{self, TILESET_FILE, TileOptions};
use ashsplat_files::{Progress, splats};
use ashsplat_program::args::DeviceArguments;
use ashsplat_program::look::render_settings_of;
use ashsplat_program::model::Model;
use ashsplat_program::output;
use ashsplat_program::progress::{counting, thousands};
use ashsplat_program::session;
use clap::Args;
use comparison::TileComparison;
use std::path::PathBuf;

/// Write a scene as a tree of tiles for viewers that stream: 3D Tiles 1.1 with KHR_gaussian_splatting in GLB, or streamed SOG.
///
/// Distant tiles are drawn with fewer Gaussians, merged from the others. A tile's geometric error is the difference between
/// its picture and that of its finer tiles, measured by rendering both: its screen-space error is the root of the squared
/// difference, summed over the pixels that the tile covers.
#[derive(Args)]
pub struct Arguments {
    /// A file of Gaussians or a model folder
    #[arg(value_name = "SCENE")]
    scene: PathBuf,
    /// The folder, which must not be there yet
    #[arg(short, long, value_name = "DIR")]
    out: PathBuf,
    /// Gaussians of a tile, at most
    #[arg(long, value_name = "N", default_value_t = TileOptions::default().max_gaussians, value_parser = max_gaussians)]
    max_gaussians: usize,
    /// Pack the tiles' attributes as SPZ version 2 (KHR_gaussian_splatting_compression_spz_2): smaller, less exact, and the
    /// only form that CesiumJS reads
    #[arg(long)]
    spz: bool,
    /// Write the streamed SOG of PlayCanvas instead, lod-meta.json: regions of so many Gaussians with several levels of detail
    #[arg(long, conflicts_with = "spz")]
    sog: bool,
    /// Drop the Gaussians whose parameters are not finite, instead of refusing them
    #[arg(long)]
    drop_invalid: bool,
    #[command(flatten)]
    device: DeviceArguments,
    /// No progress; only results and errors
    #[arg(long)]
    quiet: bool,
}

fn max_gaussians(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(max_gaussians) if max_gaussians >= 2 => Ok(max_gaussians),
        _ => Err("expected a number of 2 or more".into()),
    }
}

pub fn run(arguments: &Arguments) -> Result<()> {
    let model = Model::locate(&arguments.scene, None)?;
    if arguments.out.is_file() {
        return Err(Error::input(&arguments.out, "is a file", "give a folder that is not there yet"));
    }
    let stop = session::stop_on_ctrl_c()?;
    let read = arguments.device.host.reading(arguments.drop_invalid);
    let bar = counting("tiles", 0, arguments.quiet);
    let report = |done: usize, total: usize| {
        bar.set_length(total as u64);
        bar.set_position(done as u64);
    };
    let progress = Progress { report: Some(&report), interrupted: Some(&stop) };
    let max_gaussians = arguments.max_gaussians;
    let done = output::in_folder(&arguments.out, |out| {
        if arguments.sog {
            return tiles::write_streamed_sog(&model.ply, out, max_gaussians, &read, &progress);
        }
        let context = arguments.device.context()?;
        let look = render_settings_of(&model.settings, &splats::header(&model.ply, &read)?);
        let mut comparison = TileComparison::new(Renderer::new(&context)?, look);
        let options = TileOptions { max_gaussians, packed: arguments.spz };
        let mut measure = |fine: &_, merged: &_| comparison.difference(fine, merged);
        let done = tiles::write(&model.ply, out, &options, &read, &mut measure, &progress);
        arguments.device.report_validation(&context);
        done
    });
    bar.finish_and_clear();
    let done = done?;
    for warning in &done.warnings {
        errln!("warning: {warning}");
    }
    if !arguments.quiet {
        let out = arguments.out.join(if arguments.sog { "lod-meta.json" } else { TILESET_FILE });
        let (tiles, leaves, levels) = (done.tiles, done.leaves, done.levels);
        let [own, written] = [done.gaussians, done.written].map(thousands);
        outln!(
            "{own} Gaussians -> {} ({tiles} tiles, {leaves} of them the finest, {levels} levels, {written} Gaussians in all)",
            out.display()
        );
    }
    Ok(())
}
