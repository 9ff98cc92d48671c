//! Settings of a run's data.

use ashsplat::train::SceneBlock;
use ashsplat_files::EvalSplit;
use clap::ArgAction::Set;
use clap::Args;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Settings of a run's data: source, results, and when to save and test. Each is an option of `train`, under the
/// reference's name where it has one; what is not given comes from `--config`, or else is the default.
#[derive(Args, Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DataSettings {
    /// Data set: a folder with images/ and sparse/0/ as COLMAP writes them, or with transforms.json or the cameras of Metashape (XML)
    /// or RealityScan (CSV, XMP), or a ZIP of one
    #[arg(short, long, value_name = "DATASET")]
    pub source_path: PathBuf,
    /// Folder for everything that the run writes
    #[arg(short, long, value_name = "OUT")]
    pub model_path: PathBuf,
    /// Folder of the photos within the data set [default: images]
    #[arg(short, long, value_name = "NAME")]
    pub images: String,
    /// Folder of inverse-depth maps within the data set: a 16-bit PNG per photo, of its name; scale and offset are in
    /// sparse/0/depth_params.json, or else are fitted to the sparse points
    #[arg(short, long, value_name = "FOLDER")]
    pub depths: PathBuf,
    /// 1, 2, 4 or 8 divides the photos' size; another number is their width; -1 reduces wider photos to 1600 [default: -1]
    #[arg(short, long, value_name = "N", allow_negative_numbers = true)]
    pub resolution: i32,
    /// Photos as they are stored, or turned as their metadata (Exif) say; auto takes them as stored unless the sizes of
    /// their cameras are those of the turned ones [default: auto]
    #[arg(long, value_parser = ["auto", "stored", "upright"], value_name = "NAME")]
    pub orientation: String,
    /// Replace photos of fisheyes and other lenses by those of pinholes, as COLMAP's image_undistorter does; impossible for
    /// panoramas and lenses of 180 degrees or more. Otherwise training renders each photo with its own lens
    #[arg(long, action = Set, num_args = 0..=1, require_equals = true, default_missing_value = "true", value_name = "BOOL")]
    pub undistort: bool,
    /// Transparent pixels of the photos show the background (target), do not count (mask), or have their stored colours
    /// (ignore) [default: target]
    #[arg(long, value_parser = ["target", "mask", "ignore"], value_name = "USE")]
    pub alpha: String,
    /// Turn the scene upright about the middle of the cameras: the direction perpendicular to their horizontal axes becomes
    /// -y in all output. settings.toml has up direction and fixed point in place of `on` [default: off]
    #[arg(long, num_args = 0..=1, require_equals = true, default_missing_value = "on", value_name = "off|on|X,Y,Z,X,Y,Z")]
    pub level: String,
    /// Hold out every 8th view (by name) for tests
    #[arg(long, action = Set, num_args = 0..=1, require_equals = true, default_missing_value = "true", value_name = "BOOL")]
    pub eval: bool,
    /// Which views are held out, where the data set does not say so [default: inner; with the preset or strategy reference and with
    /// --train-test-exp: reference]
    #[arg(long, value_name = "NAME")]
    pub eval_split: Split,
    /// Train on the left half of the held-out views as well, and test on the right one under the exposure that was learned;
    /// sets --exposure (the reference's protocol)
    #[arg(long, action = Set, num_args = 0..=1, require_equals = true, default_missing_value = "true", value_name = "BOOL")]
    pub train_test_exp: bool,
    /// Settings for few photos: steps leave some Gaussians out, opacities are penalised, and learning rates fall over a
    /// longer share. auto applies them fully to at most 12 photos, partly up to 32, and never with the reference's strategy;
    /// on applies them fully. Options that set these values take precedence [default: auto]
    #[arg(long, value_name = "WHEN")]
    pub few_photos: AutoSwitch,
    /// Start from 100,000 random points where the data set has none, instead of refusing it; with --photo-points only
    /// if the photos show too few
    #[arg(long, action = Set, num_args = 0..=1, require_equals = true, default_missing_value = "true", value_name = "BOOL")]
    pub random_points: bool,
    /// Where the data set has no points, look for up to 20,000 at which the photos agree: on, off, or on with --strategy
    /// budget and mcmc (auto) [default: auto]
    #[arg(long, num_args = 0..=1, require_equals = true, default_missing_value = "on", value_name = "WHEN")]
    pub photo_points: AutoSwitch,
    /// Train this block of a file that `ashsplat partition` wrote. The file determines data set, photos, start, block,
    /// margin, scene extent, iterations and model folder; -s and --init give the paths of data set and coarse model if they
    /// differ on this machine
    #[arg(long, value_name = "BLOCKS.json:N", help_heading = "Blocks", conflicts_with_all = [
        "model_path", "images", "resolution", "orientation", "undistort", "alpha", "level", "eval", "eval_split", "train_test_exp", "block",
        "margin", "scene_extent",
    ])]
    pub job: String,
    /// Begin with the Gaussians of this file, of any format that convert reads, in place of points
    #[arg(long, value_name = "FILE")]
    pub init: PathBuf,
    /// Train only the initial Gaussians with centres in this box (least and greatest corner, in the data set's coordinates);
    /// the others are drawn but frozen. Sides may be inf or -inf
    #[arg(
        long,
        value_name = "X,Y,Z,X,Y,Z",
        help_heading = "Blocks",
        value_delimiter = ',',
        allow_hyphen_values = true
    )]
    pub block: Vec<f64>,
    /// Also train the Gaussians within this distance of the block, in the data set's units; none are added there [default:
    /// 0]
    #[arg(long, value_name = "X", help_heading = "Blocks", allow_hyphen_values = true)]
    pub margin: f64,
    /// Treatment of the scene outside the block: drawn and frozen, or masked (pixels that show it do not count; takes less memory; drawn
    /// after an exchange) [default: drawn]
    #[arg(long, help_heading = "Blocks")]
    pub outside: Outside,
    /// Use only the part of each photo that shows the block and its margin: the rest is not drawn and not kept in memory. With --job,
    /// auto and on take the parts from its file. Without it, auto uses whole photos, and on finds parts by the depths of the scene that
    /// training begins with (--init); continue such a training on the same device, for another one may see other parts [default: auto]
    #[arg(long, help_heading = "Blocks")]
    pub photo_parts: AutoSwitch,
    /// Scene extent, which scales the means' learning rate and the thresholds of densification, in the data set's units: for
    /// a block, that of the whole scene; 0 takes that of the training cameras [default: 0]
    #[arg(long, value_name = "X", help_heading = "Blocks", allow_hyphen_values = true)]
    pub scene_extent: f64,
    /// Test after these iterations, and after the last; -1 for the last only [default: 7000 30000]
    #[arg(long, num_args = 1.., value_name = "N", allow_negative_numbers = true, value_parser = iteration)]
    pub test_iterations: Vec<u32>,
    /// Measure LPIPS too, in the last test, as `ashsplat eval` does: by the weights in this file; given twice, by both
    #[arg(long, value_name = "FILE")]
    pub lpips_weights: Vec<PathBuf>,
    /// Save a PLY after these iterations, and after the last; -1 for the last only [default: 7000 30000]
    #[arg(long, num_args = 1.., value_name = "N", allow_negative_numbers = true, value_parser = iteration)]
    pub save_iterations: Vec<u32>,
    /// Write a checkpoint, from which training can continue, after these iterations
    #[arg(long, num_args = 1.., value_name = "N", allow_negative_numbers = true, value_parser = iteration)]
    pub checkpoint_iterations: Vec<u32>,
    /// Write a checkpoint every N iterations and after the last; only the newest of these stays; 0 writes none [default: 0]
    #[arg(long, value_name = "N")]
    pub checkpoint_every: u32,
}

/// Parses an iteration. -1, which means "never" in scripts for the reference, becomes 0, which never comes.
fn iteration(text: &str) -> Result<u32, std::num::ParseIntError> {
    if text == "-1" { Ok(0) } else { text.parse() }
}

impl DataSettings {
    /// True if a checkpoint is written after this iteration (1-based) of `iterations`.
    pub fn checkpoints_at(&self, iteration: u32, iterations: u32) -> bool {
        let every = self.checkpoint_every;
        let passing = every > 0 && (iteration.is_multiple_of(every) || iteration == iterations);
        passing || self.checkpoint_iterations.contains(&iteration)
    }
}

impl Default for DataSettings {
    fn default() -> Self {
        Self {
            source_path: PathBuf::new(),
            model_path: PathBuf::new(),
            images: "images".into(),
            depths: PathBuf::new(),
            resolution: -1,
            orientation: "auto".into(),
            undistort: false,
            alpha: "target".into(),
            level: "off".into(),
            eval: false,
            eval_split: Split::Inner,
            train_test_exp: false,
            few_photos: AutoSwitch::Auto,
            random_points: false,
            photo_points: AutoSwitch::Auto,
            job: String::new(),
            init: PathBuf::new(),
            block: Vec::new(),
            margin: 0.0,
            outside: Outside::Drawn,
            photo_parts: AutoSwitch::Auto,
            scene_extent: 0.0,
            test_iterations: vec![7000, 30_000],
            lpips_weights: Vec::new(),
            save_iterations: vec![7000, 30_000],
            checkpoint_iterations: Vec::new(),
            checkpoint_every: 0,
        }
    }
}

/// Which views are held out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Split {
    /// Every 8th by name, beginning with the first
    Reference,
    /// As reference from 24 views on; with fewer, the same number, evenly spaced between the first and the last view
    Inner,
}

impl From<Split> for EvalSplit {
    fn from(split: Split) -> EvalSplit {
        match split {
            Split::Reference => EvalSplit::Reference,
            Split::Inner => EvalSplit::Inner,
        }
    }
}

/// Treatment of the scene outside the trained block.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Outside {
    /// It is drawn and stays as it is
    #[default]
    Drawn,
    /// It is left out until an exchange of blocks, and pixels that show it do not count
    Masked,
}

impl Outside {
    /// True if the scene around a block is drawn. A masked scene is drawn after an exchange, because the neighbours were
    /// trained with this block's Gaussians in front of them or behind.
    pub fn is_drawn(self, exchanged: bool) -> bool {
        exchanged || self == Outside::Drawn
    }

    /// The block; without its frozen Gaussians if they are not drawn.
    pub fn leave(self, block: SceneBlock, exchanged: bool) -> SceneBlock {
        match self.is_drawn(exchanged) {
            true => block,
            false => SceneBlock { frozen: block.frozen.select(&[]), ..block },
        }
    }
}

/// A switch; auto is on where it is known to help.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum AutoSwitch {
    #[default]
    Auto,
    #[value(alias = "true")]
    On,
    #[value(alias = "false")]
    Off,
}
