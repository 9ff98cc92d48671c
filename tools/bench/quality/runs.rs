//! A finished run as a file.

use crate::schema::Program;
use ashsplat::train::TrainSettings;
use ashsplat::vk::Context;
use ashsplat::{Error, Result};
use ashsplat_files::regular_file;
use ashsplat_program::config::DataSettings;
use ashsplat_program::output;
use ashsplat_program::progress::thousands;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};
use std::fmt::Write;
use std::path::{Path, PathBuf};

/// Changes when older files can no longer be read.
pub const SCHEMA: &str = "ashsplat-quality/1";

/// Results after an iteration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Point {
    pub iteration: u32,
    /// Training time since the first iteration.
    pub seconds: f64,
    /// Processor time of the whole process during training; none if the system does not report it.
    pub cpu_seconds: Option<f64>,
    /// Mean over all held-out views, dB.
    pub psnr: f64,
    /// Mean over all held-out views.
    pub ssim: f64,
    pub gaussians: u32,
}

/// Values that must agree for runs to be compared: data, settings, device, program.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Setup(Map<String, Value>);

impl Setup {
    pub fn new(
        (data, points): (&DataSettings, u32),
        settings: &TrainSettings,
        context: &Context,
        program: &Program,
    ) -> Result<Setup> {
        let path = std::fs::canonicalize(&data.source_path).unwrap_or_else(|_| data.source_path.clone());
        let mut setup = Map::new();
        let mut add = |name: &str, value: Value| drop(setup.insert(name.into(), value));
        add("data set", json!(path));
        add("images", json!(data.images));
        add("depths", json!(data.depths));
        add("resolution", json!(data.resolution));
        add("random_points", json!(data.random_points));
        add("photo_points", json!(data.photo_points));
        add("points", json!(points));
        add("device", json!(context.description().name));
        add("driver", json!(context.description().driver));
        add("max_memory", json!(context.max_memory()));
        add("version", json!(program.version));
        add("commit", json!(program.commit));
        let settings = serde_json::to_value(settings);
        match settings.map_err(|e| Error::argument("settings", e.to_string()))? {
            Value::Object(settings) => settings.into_iter().for_each(|(name, value)| add(&name, value)),
            other => add("settings", other),
        }
        Ok(Setup(setup))
    }

    /// Returns the first difference from another setup: name, own value, other value.
    fn difference(&self, other: &Setup) -> Option<(String, Value, Value)> {
        let value = |setup: &Setup, name: &String| setup.0.get(name).cloned().unwrap_or(Value::Null);
        let names = self.0.keys().chain(other.0.keys().filter(|name| !self.0.contains_key(*name)));
        let mut pairs = names.map(|name| (name.clone(), value(self, name), value(other, name)));
        pairs.find(|(_, own, other)| own != other)
    }
}

/// A training from its first iteration to its last.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Run {
    pub schema: String,
    pub strategy: String,
    pub seed: u32,
    pub setup: Setup,
    pub held_out_views: usize,
    /// By iteration; the last one is the end.
    pub points: Vec<Point>,
}

impl Run {
    /// Describes the result in words.
    pub fn describe(&self) -> String {
        let Some(end) = self.points.last() else { return String::new() };
        let cpu = end.cpu_seconds.map_or_else(String::new, |cpu| format!(", {cpu:.1} CPU-s"));
        format!(
            "{} seed {}: PSNR {:.2} dB, SSIM {:.4}, {} Gaussians{cpu}, {:.1} s",
            self.strategy,
            self.seed,
            end.psnr,
            end.ssim,
            thousands(end.gaussians.into()),
            end.seconds
        )
    }
}

/// File of a run.
pub fn file(folder: &Path, strategy: &str, seed: u32) -> PathBuf {
    folder.join("runs").join(format!("{strategy}-{seed}.json"))
}

/// Reads a run of an earlier call; none if there is none.
///
/// # Errors
/// If it is damaged, or was made with another setup: the two must not be mixed.
pub fn read(path: &Path, setup: &Setup) -> Result<Option<Run>> {
    let text = match regular_file::read_json(path) {
        Ok(text) => text,
        Err(Error::Io { source, .. }) if source.kind() == std::io::ErrorKind::NotFound => {
            output::remove_leftovers_of(path);
            return Ok(None);
        }
        Err(error) => return Err(error),
    };
    let remedy = "choose another folder with -o, or remove the file to measure it anew";
    let run: Run = serde_json::from_slice(&text)
        .map_err(|e| Error::input(path, format!("is no run of {SCHEMA}: {e}"), remedy))?;
    if run.schema != SCHEMA || run.points.is_empty() {
        return Err(Error::input(path, format!("is no run of {SCHEMA}"), remedy));
    }
    match run.setup.difference(setup) {
        None => Ok(Some(run)),
        Some((name, theirs, ours)) => {
            let problem = format!("was measured with another {name}: {theirs}, now {ours}");
            Err(Error::input(path, problem, remedy))
        }
    }
}

/// Iterations at equal shares, ascending, up to the last.
pub fn shares(iterations: u32, points: u32) -> Vec<u32> {
    let at = |k: u32| (u64::from(k) * u64::from(iterations) / u64::from(points)) as u32;
    let mut shares: Vec<u32> = (1..=points).map(at).filter(|&iteration| iteration > 0).collect();
    shares.dedup();
    shares
}

/// One line for each point of each run.
pub fn csv(runs: &[Run]) -> String {
    let mut out = String::from("strategy,seed,iteration,seconds,cpu_seconds,psnr,ssim,gaussians\n");
    for (run, p) in runs.iter().flat_map(|run| run.points.iter().map(move |point| (run, point))) {
        let cpu = p.cpu_seconds.map_or_else(String::new, |cpu| format!("{cpu:.3}"));
        let _ = writeln!(
            out,
            "{},{},{},{:.3},{cpu},{:.4},{:.6},{}",
            run.strategy, run.seed, p.iteration, p.seconds, p.psnr, p.ssim, p.gaussians
        );
    }
    out
}
