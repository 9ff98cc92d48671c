//! Arguments of the sub-commands of `bench`.

use super::forms::FormArguments;
use super::measure::Iterations;
use super::schema::Report;
use super::sizes::{FrameSize, parse_size};
use super::workload::{SceneArguments, SyntheticArguments};
use ashsplat::Result;
use ashsplat::vk::Context;
use ashsplat_program::args::DeviceArguments;
use ashsplat_program::output;
use clap::Args;
use std::path::PathBuf;

/// Most values or pairs of a primitive.
const MAX_ELEMENTS: i64 = 1 << 28;

/// How often a workload is run.
#[derive(Args, Clone, Copy)]
pub struct IterationArguments {
    /// Measured iterations of each workload
    #[arg(long, value_name = "N", default_value_t = 15, value_parser = clap::value_parser!(u32).range(1..))]
    iterations: u32,
    /// Iterations before them that do not count
    #[arg(long, value_name = "N", default_value_t = 3)]
    warmup: u32,
}

impl IterationArguments {
    /// Times every second iteration command by command.
    pub fn get(self) -> Iterations {
        Iterations { measured: self.iterations, warmup: self.warmup, timed: true }
    }
}

/// The measured device, its clock, and the files for the result.
#[derive(Args)]
pub struct OutputArguments {
    /// Write the result here (JSON)
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Time by the host's clock only, as on a device without timestamps: no time per kernel
    #[arg(long)]
    host_clock: bool,
    #[command(flatten)]
    pub device: DeviceArguments,
    /// Print no table
    #[arg(long)]
    pub quiet: bool,
}

impl OutputArguments {
    pub fn context(&self) -> Result<Context> {
        self.device.context_with(|options| options.timestamps = !self.host_clock)
    }

    /// Refuses a file that cannot be written, before anything is measured.
    pub fn check(&self) -> Result<()> {
        output::check(&[("--json", self.json.as_deref())])
    }

    pub fn write(&self, report: &Report) -> Result<()> {
        self.json.as_ref().map_or(Ok(()), |path| output::write_json(path, report))
    }
}

/// `scan` and `sort`.
#[derive(Args)]
pub struct PrimitiveArguments {
    /// Values of the scan, pairs of the sort [default: 16777216 values, 4194304 pairs]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=MAX_ELEMENTS))]
    pub elements: Option<u32>,
    /// Seed of the values and keys
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub seed: u64,
    #[command(flatten)]
    pub iterations: IterationArguments,
    #[command(flatten)]
    pub output: OutputArguments,
}

/// Choice of where frames end: on the device, or read back.
#[derive(Args, Clone, Copy)]
pub struct ReadBackArguments {
    /// Leave pictures on the device, as in an engine that draws into its own images. Copying and composing a large picture
    /// on the host takes longer than drawing it, and a GPU slows down meanwhile
    #[arg(long)]
    pub no_read_back: bool,
}

/// `render`, `blending` and `train-step`.
#[derive(Args)]
pub struct FrameArguments {
    #[command(flatten)]
    pub scene: SceneArguments,
    #[command(flatten)]
    pub form: FormArguments,
    #[command(flatten)]
    pub read_back: ReadBackArguments,
    #[command(flatten)]
    pub iterations: IterationArguments,
    #[command(flatten)]
    pub output: OutputArguments,
}

/// Arguments of `train`. Its windows determine how many iterations are measured.
#[derive(Args)]
pub struct TrainArguments {
    /// The data set
    #[arg(long, value_name = "DATASET")]
    pub dataset: PathBuf,
    /// Iterations at which measurements end; each covers the hundred iterations before, and the trainer runs all earlier
    /// ones
    #[arg(long, value_name = "N,N,...", value_delimiter = ',', default_values_t = [100])]
    pub windows: Vec<u32>,
    /// SH degree that training ends with
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u32).range(0..=3))]
    pub sh_degree: u32,
    /// Seed of the training
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub seed: u64,
    #[command(flatten)]
    pub output: OutputArguments,
}

/// `all`.
#[derive(Args)]
pub struct AllArguments {
    /// Pairs of the larger sort; the smaller takes a quarter, the scan four times as many values
    #[arg(long, value_name = "N", default_value_t = 1 << 22, value_parser = clap::value_parser!(u32).range(1..=MAX_ELEMENTS))]
    pub elements: u32,
    #[command(flatten)]
    pub synthetic: SyntheticArguments,
    /// More synthetic frames: Gaussians and size of each
    #[arg(long, value_name = "N@WxH,...", value_delimiter = ',', default_values_t = [FrameSize::LARGE])]
    pub frames: Vec<FrameSize>,
    /// Also measure a frame of this trained scene
    #[arg(long, value_name = "FILE")]
    pub scene: Option<PathBuf>,
    /// Its camera: entry N (from 0) of a cameras.json [default: N = 0; without it, one that sees the whole scene]
    #[arg(long, value_name = "FILE[:N]", requires = "scene")]
    pub camera: Option<String>,
    /// Size of its picture [default: --width and --height, where given, else the camera's own]
    #[arg(long, value_name = "WxH", value_parser = parse_size, requires = "scene")]
    pub scene_size: Option<(u32, u32)>,
    /// Also measure training of this data set; a second data set is trained to the end of the first window
    #[arg(long, value_name = "DATASET")]
    pub dataset: Vec<PathBuf>,
    /// Iterations at which measurements end; each covers the hundred iterations before
    #[arg(long, value_name = "N,N,...", value_delimiter = ',', default_values_t = [100], requires = "dataset")]
    pub windows: Vec<u32>,
    #[command(flatten)]
    pub read_back: ReadBackArguments,
    #[command(flatten)]
    pub iterations: IterationArguments,
    #[command(flatten)]
    pub output: OutputArguments,
}
