//! `ashsplat partition`.

mod cameras;
mod correlation;

use ashsplat::scene::{Camera, Cells, Gaussians, scene_extent};
use ashsplat::train::SceneBlock;
use ashsplat::{Error, RenderSettings, Renderer, Result};
use ashsplat_files::cameras_json::NamedCamera;
use ashsplat_files::{Gallery, cameras_json, file_hash, splats};
use ashsplat_program::args::DeviceArguments;
use ashsplat_program::blocks::rounds::MAX_ROUNDS;
use ashsplat_program::blocks::{
    Block, BlocksFile, Coarse, CoreBox, DatasetOfBlocks, Division, MAX_BLOCKS, cameras_hash, stored,
};
use ashsplat_program::config::{AutoSwitch, DataSettings, Split};
use ashsplat_program::lock::{FolderLock, LockKind};
use ashsplat_program::look::render_settings_of;
use ashsplat_program::model::Model;
use ashsplat_program::progress::{significant, thousands};
use ashsplat_program::{blocks, output, session};
use cameras::Shares;
use clap::Args;
use glam::Vec3;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Divide a scene into blocks that are trained one by one, on any machines: `train --job blocks.json:1`, then `merge`.
///
/// The cells are those of a k-d tree over the coarse model's Gaussians: halved at the median of the longest axis until none
/// has more than --max-gaussians. Together they cover all space, and each place is in exactly one. A block is trained on the
/// photos of which its cell covers --min-share, by the depths of the coarse model, which is drawn once per photo. A photo
/// without such a cell is used for the cell that covers most of it. The same input gives the same file.
#[derive(Args)]
pub struct Arguments {
    /// Data set [default: that of the coarse model's training]
    #[arg(value_name = "DATASET", conflicts_with = "source_path")]
    dataset: Option<PathBuf>,
    /// A model of the whole scene: a model folder or a file of Gaussians; a short training with few Gaussians is enough
    #[arg(long, value_name = "MODEL")]
    coarse: PathBuf,
    /// Most Gaussians of the coarse model in a block, without its margin
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    max_gaussians: u64,
    /// The new file
    #[arg(short, long, value_name = "FILE", default_value = "blocks.json")]
    out: PathBuf,
    /// Width of the margin around its cell in which a block also trains Gaussians, in the data set's units [default: 0.15 of
    /// the usual cell's longest side; in rounds 0.05, except for a single object]
    #[arg(long, value_name = "X")]
    margin: Option<f32>,
    /// Use only the part of each photo that shows the block and its margin; auto: on, but off for a single object, where the average
    /// photo is used for two thirds of the blocks besides its main one
    #[arg(long, value_enum, default_value_t)]
    photo_parts: AutoSwitch,
    /// The share of a picture that a cell must cover for the photo to be used for its block, above 0 and up to 1
    #[arg(long, value_name = "X", default_value_t = 0.02)]
    min_share: f64,
    /// Iterations that training the whole scene would take: a block gets its photos' share of them, so that each photo is
    /// used equally often
    #[arg(long, value_name = "N", default_value_t = 30_000, value_parser = clap::value_parser!(u32).range(1..))]
    iterations: u32,
    /// Train in N rounds, with `ashsplat exchange` between them: a block's margin and surroundings then come from its
    /// trained neighbours instead of the coarse model, which improves the seams
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=MAX_ROUNDS.into()))]
    rounds: u32,
    #[command(flatten)]
    data: session::DataArguments,
    #[command(flatten)]
    device: DeviceArguments,
    /// Print only errors
    #[arg(long)]
    quiet: bool,
}

const WORK: LockKind = LockKind { file: ".partition.lock", what: "partition", option: "-o" };

/// Margin as a share of the usual cell's side.
const MARGIN: f32 = 0.15;
/// Margin in rounds: beyond it lie the neighbours' trained Gaussians, not the coarse model.
const MARGIN_IN_ROUNDS: f32 = 0.05;
/// Photos show a single object if each is used, in the mean, for this share of the blocks besides its main one. Each
/// block then fits nearly whole photos, and its border shows in all of them. Objects have 0.84 and more, cities at most
/// 0.5 (tools/blocks.md).
const SINGLE_OBJECT: f64 = 2.0 / 3.0;
/// Largest distance between the coarse model's cameras and the data set's, in scene extents.
const SAME_PLACE: f64 = 1e-3;
/// Least share of the pictures that a model of the scene covers.
const MIN_COVERED: f64 = 0.02;
/// Least mean correlation of photographs and renders of a model of the scene.
const MIN_CORRELATION: f64 = 0.2;

pub fn run(arguments: &Arguments) -> Result<()> {
    arguments.check()?;
    let coarse = Model::locate(&arguments.coarse, None)?;
    let data = arguments.data.applied_to_dataset(arguments.dataset.as_deref(), &coarse.settings.data)?;
    // Trainings of blocks and their reports hold out the same views.
    let data = DataSettings { eval_split: Split::Reference, ..data };
    let host = &arguments.device.host;
    let mut scene = splats::read(&coarse.ply, &host.reading(false))?;
    if scene.gaussians.is_empty() {
        return Err(Error::input(&coarse.ply, "has no Gaussians", "give a model of the whole scene"));
    }
    let context = arguments.device.context()?;
    let stop = session::stop_on_ctrl_c()?;
    let white = coarse.settings.train.white_background;
    let gallery = session::open(&data, &session::options(&data, white, host)?, &stop)?;
    session::warn(gallery.warnings());
    scene.express_in(gallery.frame());
    check_same_scene(&coarse, &gallery, &data)?;
    let max_gaussians = usize::try_from(arguments.max_gaussians).unwrap_or(usize::MAX);
    let cells = Cells::divide(&scene.gaussians.means, max_gaussians)
        .map_err(|error| Error::argument("--max-gaussians", error.to_string()))?;
    if cells.bounds().len() > MAX_BLOCKS {
        let problem = format!("makes {} blocks, more than {MAX_BLOCKS}", cells.bounds().len());
        return Err(Error::argument("--max-gaussians", problem));
    }
    let mut renderer = Renderer::new(&context)?;
    renderer.upload(&scene.gaussians)?;
    let look = RenderSettings { inverse_depth: true, ..render_settings_of(&coarse.settings, &scene.header) };
    let cameras = gallery.cameras();
    let side = usual_side(&scene.gaussians, &cells);
    let sides = if arguments.rounds > 1 { MARGIN_IN_ROUNDS } else { MARGIN };
    let given = arguments.margin.map(|margin| (f64::from(margin) / gallery.frame().unit) as f32);
    let mut margin = given.unwrap_or(sides * side);
    let shares_of = |margin: f32, renderer: &mut Renderer| {
        let found = (&cells, margin, arguments.min_share);
        Shares::of(renderer, &cameras, found, &look, (arguments.quiet, &stop))
    };
    let mut shares = shares_of(margin, &mut renderer)?;
    let spread = shares.spread();
    let is_object = cells.bounds().len() > 1 && spread >= SINGLE_OBJECT;
    let of_parts = match arguments.photo_parts {
        AutoSwitch::Auto => !is_object,
        AutoSwitch::On => true,
        AutoSwitch::Off => false,
    };
    if is_object && arguments.margin.is_none() && sides < MARGIN {
        margin = MARGIN * side;
        if of_parts {
            shares = shares_of(margin, &mut renderer)?;
        }
    }
    if !of_parts {
        shares.use_whole();
    }
    check_same_pictures(&coarse, &gallery, &data, (&mut renderer, &shares, &look))?;
    let division = arguments.division(&DivisionInputs {
        coarse: &coarse,
        gaussians: &scene.gaussians,
        data: &data,
        gallery: &gallery,
        cells: &cells,
        margin,
        shares: &shares,
    })?;
    division.check_rounds().map_err(|problem| Error::argument("--rounds", problem))?;
    session::check(&stop)?;
    output::in_folder(&arguments.out, |path| {
        let _lock = FolderLock::take(folder_of(path), &WORK, None)?;
        let old = BlocksFile::read(path).ok();
        old.as_ref().map_or(Ok(()), |old| old.check_replaced(&division))?;
        if old.is_some_and(|old| old.division == division) {
            Ok(())
        } else {
            output::write_json(path, &division)
        }
    })?;
    if !arguments.quiet {
        arguments.describe(&division, is_object.then_some(spread));
    }
    arguments.device.report_validation(&context);
    Ok(())
}

struct DivisionInputs<'a> {
    coarse: &'a Model,
    gaussians: &'a Gaussians,
    data: &'a DataSettings,
    gallery: &'a Gallery,
    cells: &'a Cells,
    margin: f32,
    shares: &'a Shares,
}

fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// Refuses a model folder whose cameras are not those of the data set.
fn check_same_scene(coarse: &Model, gallery: &Gallery, data: &DataSettings) -> Result<()> {
    let Some(file) = coarse.cameras_file() else { return Ok(()) };
    let own = cameras_json::read(&file, gallery.frame())?;
    let cameras = gallery.cameras();
    let by_name: BTreeMap<&str, &Camera> =
        cameras.iter().map(|named| (named.name.as_str(), &named.camera)).collect();
    let near = SAME_PLACE * f64::from(scene_extent(cameras.iter().map(|named| named.camera.position())));
    // Optimised poses have moved.
    let moved = coarse.settings.train.pose_opt;
    let is_there = |named: &&NamedCamera| {
        let there = by_name.get(named.name.as_str());
        there.is_some_and(|there| {
            moved || there.exact_position().distance(named.camera.exact_position()) <= near
        })
    };
    let same = own.iter().filter(is_there).count();
    if 2 * same >= own.len() && same > 0 {
        return Ok(());
    }
    let problem = format!(
        "of its {} cameras {same} are in {}: it is of another scene",
        own.len(),
        data.source_path.display()
    );
    Err(Error::input(file, problem, "give a model of this data set"))
}

/// Refuses a model that covers little of the pictures, or does not resemble the photographs.
fn check_same_pictures(
    coarse: &Model,
    gallery: &Gallery,
    data: &DataSettings,
    (renderer, shares, look): (&mut Renderer, &Shares, &RenderSettings),
) -> Result<()> {
    let photos = data.source_path.display();
    let refuse = |problem: String| {
        Err(Error::input(&coarse.ply, problem, "it is of another scene: give a model of this data set"))
    };
    if shares.covered() < MIN_COVERED {
        return refuse(format!("shows next to nothing to the cameras of {photos}"));
    }
    match correlation::with_photos(renderer, gallery, look)? {
        Some(correlation) if correlation < MIN_CORRELATION => {
            refuse(format!("does not look like the photos of {photos} (correlation {correlation:.2})"))
        }
        _ => Ok(()),
    }
}

impl Arguments {
    fn check(&self) -> Result<()> {
        output::check(&[("--out", Some(&self.out))])?;
        if self.out.extension().is_none_or(|extension| extension != "json") {
            let problem =
                format!("{} does not end in .json; models go beside it, without", self.out.display());
            return Err(Error::argument("--out", problem));
        }
        if !(self.min_share > 0.0 && self.min_share <= 1.0) {
            let problem = format!("{} is not above 0 and up to 1", self.min_share);
            return Err(Error::argument("--min-share", problem));
        }
        match self.margin {
            Some(margin) if !(margin.is_finite() && margin >= 0.0) => {
                Err(Error::argument("--margin", format!("is {margin}, must be 0 or more")))
            }
            _ => Ok(()),
        }
    }

    fn division(&self, found: &DivisionInputs<'_>) -> Result<Division> {
        let &DivisionInputs { coarse, gaussians, data, gallery, cells, margin, shares } = found;
        let cameras = gallery.cameras();
        let held_out = gallery.held_out();
        let is_trained = |index: usize| !held_out[index];
        let trained = (0..cameras.len()).filter(|&index| is_trained(index));
        let extent = scene_extent(trained.clone().map(|index| cameras[index].camera.position()));
        let scene_extent = if extent > 0.0 { extent } else { 1.0 };
        let photos = trained.count();
        let mut blocks = Vec::new();
        for (index, &core) in cells.bounds().iter().enumerate() {
            let number = index as u32 + 1;
            let chosen: Vec<usize> =
                (0..cameras.len()).filter(|&camera| shares.is_of(camera, index)).collect();
            let named = |trained: bool| -> Vec<String> {
                let all = chosen.iter().filter(|&&camera| is_trained(camera) == trained);
                all.map(|&camera| cameras[camera].name.clone()).collect()
            };
            let own = named(true);
            if own.is_empty() {
                let max_share = 100.0 * shares.max_share(index, is_trained);
                let problem = format!(
                    "block {number} has no photo to train on: none shows more than {max_share:.2} % of its picture in it; lower \
                     --min-share (it is {}) or raise --max-gaussians",
                    self.min_share
                );
                return Err(Error::argument("partition", problem));
            }
            let count = |margin: Option<f32>| {
                let inside = |mean: &&[f32; 3]| match margin {
                    None => core.contains(Vec3::from_array(**mean)),
                    Some(margin) => SceneBlock::contains(core, margin, **mean),
                };
                gaussians.means.iter().filter(inside).count() as u64
            };
            let part_of_each = chosen
                .iter()
                .filter_map(|&camera| Some((cameras[camera].name.clone(), shares.part(camera, index)?)));
            let pixels = chosen.iter().map(|&camera| {
                let Camera { width, height, .. } = cameras[camera].camera;
                let all = u64::from(width) * u64::from(height);
                shares.part(camera, index).map_or(all, |part| part.pixels(width, height))
            });
            let iterations = (u64::from(self.iterations) * own.len() as u64).div_ceil(photos as u64);
            let folder = self.out.with_extension("").join(format!("{number:03}"));
            blocks.push(Block {
                number,
                core: CoreBox::of(core, gallery.frame()),
                gaussians: count(None),
                trained: count(Some(margin)),
                iterations: iterations as u32,
                folder: stored(&folder, &self.out),
                photos: own,
                held_out: named(false),
                pixels: pixels.sum(),
                parts: part_of_each.collect(),
            });
        }
        let in_source = |length: f32| (gallery.frame().unit * f64::from(length)) as f32;
        Ok(Division {
            version: blocks::VERSION,
            dataset: DatasetOfBlocks {
                path: stored(&data.source_path, &self.out),
                cameras: cameras_hash(&cameras),
                images: data.images.clone(),
                resolution: data.resolution,
                orientation: data.orientation.clone(),
                undistort: data.undistort,
                alpha: data.alpha.clone(),
                level: gallery.level().to_string(),
                eval: data.eval,
            },
            coarse: Coarse {
                path: stored(&coarse.ply, &self.out),
                hash: file_hash(&coarse.ply)?,
                gaussians: gaussians.len() as u64,
            },
            origin: gallery.frame().origin.to_array(),
            unit: gallery.frame().unit,
            scene_extent: in_source(scene_extent),
            margin: in_source(margin),
            min_share: self.min_share,
            max_gaussians: self.max_gaussians,
            iterations: self.iterations,
            rounds: self.rounds,
            blocks,
        })
    }

    fn describe(&self, division: &Division, object: Option<f64>) {
        for block in &division.blocks {
            outln!(
                "block {}: {} Gaussians, {} with the margin; {} photos, {} held out; {} iterations",
                block.number,
                thousands(block.gaussians),
                thousands(block.trained),
                block.photos.len(),
                block.held_out.len(),
                thousands(block.iterations.into())
            );
        }
        let all: u64 = division.blocks.iter().map(|block| u64::from(block.iterations)).sum();
        let times = all as f64 / f64::from(division.iterations);
        outln!("all blocks together: {} iterations, {times:.2} times those of the whole", thousands(all));
        if let Some(spread) = object {
            outln!(
                "a single object: photos show {:.0} % of the other blocks in the mean; blocks use {} and a margin of {}; \
                 training the whole takes less processor time, where it fits",
                100.0 * spread,
                if division.uses_parts() { "parts of photos" } else { "whole photos" },
                significant(division.margin)
            );
        }
        let out = self.out.display();
        let exchange = match division.rounds {
            1 => String::new(),
            rounds => format!(", and ashsplat exchange {out} after each of {rounds} rounds but the last"),
        };
        outln!(
            "written to {out}; train each: ashsplat train --job {out}:1{exchange}, and then: ashsplat merge {out} -o scene.ply"
        );
    }
}

/// The median of the cells' longest sides, world units. A cell's sides are those of the box around nearly all of its
/// Gaussians.
fn usual_side(gaussians: &Gaussians, cells: &Cells) -> f32 {
    let mut own: Vec<Vec<usize>> = vec![Vec::new(); cells.bounds().len()];
    for (index, &mean) in gaussians.means.iter().enumerate() {
        if let Some(cell) = cells.at(Vec3::from_array(mean)) {
            own[cell].push(index);
        }
    }
    let side = |own: &Vec<usize>| {
        let bounds = gaussians.select(own).statistics().central_bounds;
        bounds.map_or(0.0, |bounds| bounds.size().max_element())
    };
    let mut sides: Vec<f32> = own.iter().map(side).collect();
    sides.sort_unstable_by(f32::total_cmp);
    sides[sides.len() / 2]
}
