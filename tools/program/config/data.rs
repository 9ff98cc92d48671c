//! Settings of a run's data.

use ashsplat::train::SceneBlock;
use ashsplat_files::EvalSplit;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Settings of a run's data: source, results, and when to save and test.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DataSettings {
    /// The data set; empty if not given.
    pub source_path: PathBuf,
    /// Folder of the results; empty if not given.
    pub model_path: PathBuf,
    /// Folder of the photos within the data set.
    pub images: String,
    /// Folder of inverse-depth maps within the data set; empty for none.
    pub depths: PathBuf,
    /// The reference's `-r`.
    pub resolution: i32,
    /// Rotation of photos by their metadata: auto, stored or upright.
    pub orientation: String,
    /// Hold out every 8th view.
    pub eval: bool,
    /// Selects the held-out views.
    pub eval_split: Split,
    /// Train on the left half of the held-out views, and test on the right one.
    pub train_test_exp: bool,
    /// Use of the settings for few photos.
    pub few_photos: When,
    /// Start from random points if the data set has none.
    pub random_points: bool,
    /// Search for points in the photos if the data set has none.
    pub photo_points: When,
    /// The block that is trained, such as blocks.json:3; empty for none.
    pub job: String,
    /// File of initial Gaussians in place of points; empty for none.
    pub init: PathBuf,
    /// Corners of the trained block, source coordinates; empty for the whole scene.
    pub block: Vec<f64>,
    /// Margin around the block in which Gaussians are trained too, source units.
    pub margin: f64,
    /// Treatment of the scene beyond the margin.
    pub outside: Outside,
    /// Use of only those parts of photos that show the block.
    pub photo_parts: When,
    /// Extent of the scene, source units; 0 for that of the training cameras.
    pub scene_extent: f64,
    /// Iterations after which to test, besides the last.
    pub test_iterations: Vec<u32>,
    /// Files of LPIPS weights for the last test.
    pub lpips_weights: Vec<PathBuf>,
    /// Iterations after which to save, besides the last.
    pub save_iterations: Vec<u32>,
    /// Iterations after which to write a checkpoint.
    pub checkpoint_iterations: Vec<u32>,
    /// Interval of checkpoints of which only the newest is kept; 0 for none.
    pub checkpoint_every: u32,
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
            eval: false,
            eval_split: Split::Inner,
            train_test_exp: false,
            few_photos: When::Auto,
            random_points: false,
            photo_points: When::Auto,
            job: String::new(),
            init: PathBuf::new(),
            block: Vec::new(),
            margin: 0.0,
            outside: Outside::Drawn,
            photo_parts: When::Auto,
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
    /// The reference's from 24 views on; of fewer, as many, at equal distances from each other and the ends
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

/// What becomes of a scene outside of the block that is trained.
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
    /// True if the scene around a block is drawn. A masked one is drawn after an exchange: the block's neighbours were
    /// trained together with Gaussians of this block in front of them or behind.
    pub fn is_drawn(self, exchanged: bool) -> bool {
        exchanged || self == Outside::Drawn
    }

    /// The block without its frozen Gaussians if they are not drawn.
    pub fn leave(self, block: SceneBlock, exchanged: bool) -> SceneBlock {
        match self.is_drawn(exchanged) {
            true => block,
            false => SceneBlock { frozen: block.frozen.select(&[]), ..block },
        }
    }
}

/// Whether something is done; auto where it is known to help.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum When {
    #[default]
    Auto,
    #[value(alias = "true")]
    On,
    #[value(alias = "false")]
    Off,
}
