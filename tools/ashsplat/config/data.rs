//! The data of a run.

use ashsplat::trainer::SceneBlock;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// The data of a run: where it comes from, where its results go, what is saved and tested when.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DataSettings {
    /// The data set; empty: not given.
    pub source_path: PathBuf,
    /// Where results go; empty: not given.
    pub model_path: PathBuf,
    /// Folder of the photos within the data set.
    pub images: String,
    /// Folder of inverse-depth maps within the data set; empty: none.
    pub depths: PathBuf,
    /// The reference's `-r`.
    pub resolution: i32,
    /// Whether photos are turned as their metadata say: auto, stored or upright.
    pub orientation: String,
    /// Hold out every 8th view.
    pub eval: bool,
    /// Train on the left half of the held-out views, and test on the right one.
    pub train_test_exp: bool,
    /// Whether the settings for few photos are taken.
    pub few_photos: When,
    /// Start from random points where there are none.
    pub random_points: bool,
    /// Whether points are looked for in the photos where there are none.
    pub photo_points: When,
    /// The block that is trained, as blocks.json:3; empty: none.
    pub job: String,
    /// Gaussians to begin with, in place of points; empty: none.
    pub init: PathBuf,
    /// The corners of the block that is trained, source coordinates; empty: the whole scene.
    pub block: Vec<f64>,
    /// How far around it Gaussians are trained too, source units.
    pub margin: f64,
    /// What becomes of what lies beyond that.
    pub outside: Outside,
    /// Whether of each photo only the part is used that shows the block.
    pub photo_parts: When,
    /// Source units; 0: that of the training cameras.
    pub scene_extent: f64,
    /// Iterations after which to test; the last is always one.
    pub test_iterations: Vec<u32>,
    /// Weights of LPIPS, which the last test measures then.
    pub lpips_weights: Vec<PathBuf>,
    /// Iterations after which to save; the last is always one.
    pub save_iterations: Vec<u32>,
    /// Iterations after which to write a checkpoint.
    pub checkpoint_iterations: Vec<u32>,
    /// Iterations between checkpoints of which only the newest stays; 0: none.
    pub checkpoint_every: u32,
}

impl DataSettings {
    /// Whether a checkpoint is written after an iteration (1-based) of so many.
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
    /// Whether what lies around a block is drawn. Masked, it is after an exchange: what the neighbours have trained beside a block's
    /// Gaussians is what these were seen with, in front of them or behind.
    pub fn is_drawn(self, exchanged: bool) -> bool {
        exchanged || self == Outside::Drawn
    }

    /// The block with what is drawn around it, of all that lies there.
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
