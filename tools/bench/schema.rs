//! Contents of a benchmark's result file: the schema `ashsplat-bench/1`, described in tools/bench.md.
//!
//! A field that was not measured is null. Times name their unit; a [`Spread`] is over the measured iterations.

use ashsplat_program::measure::median;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt;

/// The schema's name and version, first field of every file. The version rises when a reader of old files would
/// misunderstand new ones.
pub const SCHEMA: &str = "ashsplat-bench/1";

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Report {
    /// [`SCHEMA`].
    pub schema: String,
    pub program: Program,
    pub host: Host,
    pub device: Device,
    /// Variables that change a driver's behaviour, if set.
    pub environment: BTreeMap<String, String>,
    pub settings: Settings,
    pub copy_bandwidth: Option<CopyBandwidth>,
    pub arithmetic: Option<ArithmeticRate>,
    pub runs: Vec<Run>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Program {
    pub version: String,
    /// Commit of the checkout in which it was built, with "-dirty" appended if files differ. Null outside a checkout, and if the
    /// program is older than the commit.
    pub commit: Option<String>,
    /// "release" or "debug".
    pub build: String,
}

impl fmt::Display for Program {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let commit = self.commit.as_deref().unwrap_or("commit unknown");
        write!(f, "ashsplat {} ({commit}, {})", self.version, self.build)
    }
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Host {
    pub system: String,
    pub processor: Option<String>,
    pub threads: usize,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Device {
    pub name: String,
    pub kind: String,
    pub driver: String,
    pub api_version: String,
    pub subgroup_size: u32,
    /// Subgroup size of the heaviest kernels.
    pub heavy_subgroup_size: Option<u32>,
    /// Form of the kernels that ran, "gpu" or "processor".
    pub backend: Option<String>,
    pub limits: BTreeMap<String, f64>,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Settings {
    /// Requested number of measured iterations.
    pub iterations: u32,
    /// Uncounted iterations before them.
    pub warmup: u32,
    pub seed: u64,
    /// "timestamps": the device's clock; "host": kernels have no times, because the device has no clock or --host-clock was given.
    pub clock: String,
}

/// Copy bandwidth of the device, measured in the same run: the yardstick of every kernel.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CopyBandwidth {
    /// Size of the copied buffer, read once and written once.
    pub bytes: u64,
    /// Bytes read plus bytes written over the median time.
    pub gigabytes_per_second: f64,
    pub time_ms: Spread,
    /// "timestamps", or "host": from submission until the host knows, which is later.
    pub clock: String,
}

/// Arithmetic rate of the device, measured in the same run by multiply-adds on registers.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ArithmeticRate {
    /// Operations of the dispatch; a multiply-add counts as two.
    pub operations: u64,
    /// By the least time: the highest rate reached.
    pub gigaoperations_per_second: f64,
    pub time_ms: Spread,
    /// Same as in [`CopyBandwidth`].
    pub clock: String,
}

#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Run {
    /// "scan", "sort", "render", "draw" (a frame that is not read back), "train-step" or "train". "render-regions" and
    /// "render-shared" ("draw-…") if both forms of blending are measured.
    pub name: String,
    pub workload: Workload,
    /// Measured iterations.
    pub iterations: u32,
    /// Wall time of an iteration, with every command timed.
    pub wall_ms: Spread,
    /// Time of an iteration's submissions on the device.
    pub device_ms: Option<Spread>,
    /// Parts of the wall time of an iteration.
    pub split: Split,
    /// Host time between the end of a submission and the start of the next one on the device's queue.
    pub between_submissions_ms: Option<Spread>,
    /// Wall time of an iteration with nothing timed.
    pub untimed_ms: Option<Spread>,
    /// Processor time of the whole process per untimed iteration: the true cost on a software device.
    pub cpu_seconds: Option<Spread>,
    pub kernels: Vec<KernelResult>,
    pub memory: Vec<Arena>,
}

/// Parts of the mean wall time of an iteration; they add up to it.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Split {
    /// Mean wall time.
    pub wall_ms: f64,
    /// Sum of all commands on the device; null without timestamps.
    pub kernels_ms: Option<f64>,
    pub recording_ms: f64,
    /// Handing commands to the driver.
    pub submitting_ms: f64,
    /// Waiting for the device beyond its commands: until it starts, and until the host wakes.
    pub waiting_ms: f64,
    /// Other host work: reading back, composing pictures.
    pub host_ms: f64,
}

#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Workload {
    /// "synthetic", or the files.
    pub source: String,
    /// FNV-1a over all inputs: Gaussians, camera, keys. Results compare only if it agrees.
    pub hash: String,
    /// Values of a scan, pairs of a sort.
    pub elements: Option<u64>,
    pub gaussians: Option<u32>,
    pub sh_degree: Option<u32>,
    pub width: Option<u32>,
    pub height: Option<u32>,
    pub visible: Option<u32>,
    pub instances: Option<u32>,
    /// Entries of the fullest tile.
    pub longest_tile: Option<u32>,
    /// Form of blending, "regions" or "shared"; null if nothing is blended.
    pub blending: Option<String>,
}

/// A kernel within a stage, all of its dispatches together.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct KernelResult {
    pub scope: String,
    /// "sort/sort_upsweep", or "fill", "copy", "update".
    pub kernel: String,
    /// Dispatches per iteration.
    pub calls: u32,
    /// Workgroups per iteration, indirect dispatches included; null for transfers.
    pub workgroups: Option<u64>,
    /// Device time per iteration; null without timestamps.
    pub time_us: Option<Spread>,
    /// Bytes that it must read, each element once, by the memory plan and the workload's counts.
    pub bytes_read: u64,
    /// Bytes that it must write, each element once.
    pub bytes_written: u64,
    /// Bytes read and written over the median time.
    pub gigabytes_per_second: Option<f64>,
    /// Bandwidth over the device's own copy bandwidth.
    pub share_of_copy_bandwidth: Option<f64>,
    /// Gaussian-pixel pairs that a blending kernel computes per iteration; null for others.
    pub samples: Option<u64>,
    /// Additions, multiplications and divisions of a blending kernel per iteration; null for others.
    pub operations: Option<u64>,
    /// Operations over the median time.
    pub gigaoperations_per_second: Option<f64>,
    /// Arithmetic rate over the device's own.
    pub share_of_arithmetic: Option<f64>,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Arena {
    pub name: String,
    pub peak_bytes: u64,
}

/// Minimum, median (of an even number, the mean of the middle two), 90th percentile by nearest rank, and mean.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Spread {
    pub min: f64,
    pub median: f64,
    pub p90: f64,
    /// Basis of sums over many iterations.
    pub mean: f64,
}

impl Spread {
    /// None without values.
    pub fn of(mut values: Vec<f64>) -> Option<Self> {
        values.sort_unstable_by(f64::total_cmp);
        let n = values.len();
        let min = *values.first()?;
        let median = median(values.clone())?;
        let p90 = values[(9 * n).div_ceil(10) - 1];
        Some(Self { min, median, p90, mean: values.iter().sum::<f64>() / n as f64 })
    }

    pub fn times(self, factor: f64) -> Self {
        Self {
            min: self.min * factor,
            median: self.median * factor,
            p90: self.p90 * factor,
            mean: self.mean * factor,
        }
    }
}
