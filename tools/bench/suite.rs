//! `bench suite`: recipes of training on scenes, and what each scene gains or loses.

use super::machine;
use ashsplat::scene::PointCloud;
use ashsplat::{Error, Result};
use ashsplat_files::colmap::{self, ColmapImage, Model};
use ashsplat_files::{atomic, quoted, regular_file};
use ashsplat_program::child::run_logged;
use ashsplat_program::config::Split;
use ashsplat_program::eval::RESULTS_FILE;
use ashsplat_program::lock::{FolderLock, LockKind};
use ashsplat_program::train_log::{LOG_FILE, Rows};
use ashsplat_program::{output, session};
use clap::Args;
use glam::DVec3;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

const MEASURING: LockKind = LockKind { file: ".suite.lock", what: "suite", option: "-o" };

/// Train scenes by several recipes and seeds: a table of held-out PSNR with mean, worst loss and largest fall along a run.
///
/// FILE lists scenes and recipes (tools/bench.md); tools/datasets has those of the field's data sets. Each run is an `ashsplat
/// train --eval`, whose model folder stays in the folder. After Ctrl-C the same command continues the run that was stopped. A run
/// is made anew if its options, its scene or this program have changed.
#[derive(Args)]
pub struct Arguments {
    /// Scenes and recipes
    #[arg(value_name = "FILE")]
    suite: PathBuf,
    /// Folder for data sets of chosen photographs, runs and suite.md
    #[arg(short, long, value_name = "FOLDER")]
    out: PathBuf,
    /// Folder of the data sets [default: that of FILE]
    #[arg(long, value_name = "FOLDER")]
    data: Option<PathBuf>,
}

/// A file of scenes and recipes.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Suite {
    /// Iterations of each run.
    iterations: u32,
    /// Iterations after which held-out photographs are also measured.
    #[serde(default)]
    tests: Vec<u32>,
    #[serde(default = "one_seed")]
    seeds: Vec<u32>,
    /// Held-out views of all recipes: `train --eval-split`.
    #[serde(default = "inner")]
    eval_split: Split,
    /// Options of `train` for all runs.
    #[serde(default)]
    options: Vec<String>,
    /// Source of the scenes' published rows: all have one, or none.
    published: Option<String>,
    #[serde(rename = "scene")]
    scenes: Vec<Scene>,
    #[serde(rename = "recipe")]
    recipes: Vec<Recipe>,
}

fn one_seed() -> Vec<u32> {
    vec![0]
}

fn inner() -> Split {
    Split::Inner
}

/// A data set, or some photographs of it.
#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
struct Scene {
    name: String,
    dataset: PathBuf,
    /// Value of `train -r`.
    #[serde(default = "stored_size")]
    resolution: i32,
    /// Further options of `train`.
    #[serde(default)]
    options: Vec<String>,
    /// Number of photographs; all if it is missing. A point is kept if at least two of them show it.
    photographs: Option<usize>,
    /// Takes photographs at equal distances by name, from this place on.
    #[serde(default)]
    first: usize,
    /// Name of a photograph: those with the nearest cameras are taken instead.
    near: Option<String>,
    /// The time until training first reaches this PSNR is measured, dB.
    until: Option<f64>,
    /// Others' results by the same protocol.
    published: Option<Published>,
}

#[derive(Clone, Copy, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
struct Published {
    /// dB.
    psnr: f64,
    ssim: f64,
    /// By VGG16.
    lpips: f64,
}

fn stored_size() -> i32 {
    -1
}

/// Options of `train` that are compared.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Recipe {
    name: String,
    #[serde(default)]
    options: Vec<String>,
}

/// A finished run.
#[derive(Serialize, Deserialize)]
struct Run {
    /// Properties on which the numbers of the run depend.
    setup: String,
    /// Wall time of the whole command.
    seconds: f64,
    /// Tests by iteration.
    tests: BTreeMap<u32, Test>,
    /// Results of the last iteration.
    last: Quality,
}

/// A test of held-out photographs.
#[derive(Clone, Copy, Serialize, Deserialize)]
struct Test {
    /// dB.
    psnr: f64,
    /// Wall time of the iterations until then, without tests.
    seconds: f64,
}

/// A run's entry in results.json.
#[derive(Clone, Copy, Serialize, Deserialize)]
struct Quality {
    #[serde(rename = "PSNR")]
    psnr: f64,
    #[serde(rename = "SSIM")]
    ssim: f64,
    /// LPIPS by VGG16; `None` without weights.
    #[serde(rename = "LPIPS")]
    lpips: Option<f64>,
    #[serde(rename = "CC_PSNR")]
    cc_psnr: f64,
    gaussians: u64,
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> Result<()> {
    let suite = Suite::read(&arguments.suite)?;
    let stop = session::stop_on_ctrl_c()?;
    let base = arguments.data.as_deref().or(arguments.suite.parent()).unwrap_or(Path::new(""));
    let program = std::env::current_exe().map_err(|e| Error::io("ashsplat", "find", e))?;
    atomic::create_folder(&arguments.out)?;
    let _lock = FolderLock::take(&arguments.out, &MEASURING, None)?;
    let mut runs = BTreeMap::new();
    let all = suite.scenes.len() * suite.recipes.len() * suite.seeds.len();
    for &seed in &suite.seeds {
        for (at, scene) in suite.scenes.iter().enumerate() {
            let data =
                scene.data(&base.join(&scene.dataset), &arguments.out.join("data").join(&scene.name))?;
            for (by, recipe) in suite.recipes.iter().enumerate() {
                let folder = arguments.out.join(&scene.name).join(format!("{}-{seed}", recipe.name));
                let command = suite.command(scene, recipe, seed, &data);
                let run = finish(&program, command, &folder, suite.iterations, &stop)?;
                let (name, psnr) = (folder.display(), run.last.psnr);
                errln!("{}/{all}  {name}  {psnr:.2} dB  {:.0} s", runs.len() + 1, run.seconds);
                runs.insert((at, by, seed), run);
            }
        }
    }
    let table = suite.table(&runs);
    output::write_text(&arguments.out.join("suite.md"), &table)?;
    outln!("{}", table.trim_end());
    Ok(())
}

impl Suite {
    fn read(path: &Path) -> Result<Suite> {
        const MAX_BYTES: u64 = 1 << 20;
        let remedy = "tools/bench.md describes such files";
        let bytes = regular_file::read_at_most(path, MAX_BYTES)?
            .ok_or_else(|| Error::input(path, format!("is longer than {MAX_BYTES} bytes"), remedy))?;
        let text = ashsplat_files::text::from_bytes(path, bytes)?;
        let suite: Suite = toml::from_str(&text).map_err(|e| Error::input(path, e.to_string(), remedy))?;
        let empty = suite.scenes.is_empty() || suite.recipes.is_empty() || suite.seeds.is_empty();
        let mut folders = BTreeSet::new();
        let scenes = suite.scenes.iter().map(|scene| ("scene", &scene.name));
        let names = scenes.chain(suite.recipes.iter().map(|recipe| ("recipe", &recipe.name)));
        let bad = names.clone().find(|name| {
            let unusable = name.1.is_empty() || name.1.contains(['/', '\\', '.']) || name.1 == "data";
            unusable || !folders.insert(*name)
        });
        let is_published = |scene: &Scene| scene.published.is_some() == suite.published.is_some();
        let numbers = suite.scenes.iter().filter_map(|scene| scene.published);
        let mut numbers = numbers.flat_map(|Published { psnr, ssim, lpips }| [psnr, ssim, lpips]);
        match bad {
            _ if empty => Err(Error::input(path, "has no scenes, no recipes or no seeds", remedy)),
            _ if !suite.scenes.iter().all(is_published) || numbers.any(|n| !(0.0..=100.0).contains(&n)) => {
                let problem =
                    "has published rows of some scenes only, without their source, or not from 0 to 100";
                Err(Error::input(path, problem, remedy))
            }
            Some((kind, name)) => {
                let problem = format!("the {kind} '{name}' is named twice, or by no name of a folder");
                Err(Error::input(path, problem, "give names of letters and digits, each once"))
            }
            None => Ok(suite),
        }
    }

    /// The arguments of a run, without its folder.
    fn command(&self, scene: &Scene, recipe: &Recipe, seed: u32, data: &Path) -> Vec<String> {
        let numbers = [self.iterations, seed].map(|number| number.to_string());
        let mut all: Vec<String> =
            ["train", "--eval", "--quiet", "--eval-share", "0", "--eval-split"].map(String::from).into();
        let split = match self.eval_split {
            Split::Inner => "inner",
            Split::Reference => "reference",
        };
        all.push(split.into());
        all.extend(["-s".into(), data.display().to_string(), "-r".into(), scene.resolution.to_string()]);
        all.extend(["--iterations".into(), numbers[0].clone(), "--seed".into(), numbers[1].clone()]);
        all.push("--test-iterations".into());
        all.extend(self.tests.iter().chain([&self.iterations]).map(u32::to_string));
        all.extend(["--save-iterations".into(), "-1".into()]);
        all.extend(self.options.iter().chain(&scene.options).chain(&recipe.options).cloned());
        all
    }

    /// Scenes by recipes. All recipes but the first have their difference from the first.
    fn table(&self, runs: &BTreeMap<(usize, usize, u32), Run>) -> String {
        let mean = |of: &dyn Fn(&Run) -> f64, at: usize, by: usize| {
            let values = self.seeds.iter().map(|&seed| of(&runs[&(at, by, seed)]));
            values.sum::<f64>() / self.seeds.len() as f64
        };
        let last = |run: &Run| run.last.psnr;
        let psnr = |at: usize, by: usize| mean(&last, at, by);
        let recipes = 0..self.recipes.len();
        let names = self.recipes.iter().map(|recipe| recipe.name.as_str());
        let mut text = row(std::iter::once("PSNR, dB").chain(names).map(String::from));
        text += &row((0..=recipes.len()).map(|_| "---".into()));
        let change = |value: f64, by: usize, first: f64| match by {
            0 => format!("{value:.2}"),
            _ => format!("{value:.2} ({:+.2})", value - first),
        };
        for (at, scene) in self.scenes.iter().enumerate() {
            let cells = recipes.clone().map(|by| change(psnr(at, by), by, psnr(at, 0)));
            text += &row(std::iter::once(scene.name.clone()).chain(cells));
        }
        let scenes = || 0..self.scenes.len();
        let over = |value: &dyn Fn(usize) -> f64| scenes().map(value).sum::<f64>() / self.scenes.len() as f64;
        let means: Vec<f64> = recipes.clone().map(|by| over(&|at| psnr(at, by))).collect();
        let mut add = |name: &str, cell: &dyn Fn(usize) -> String| {
            text += &row(std::iter::once(name.to_owned()).chain(recipes.clone().map(cell)));
        };
        add("**mean**", &|by| change(means[by], by, means[0]));
        let smallest = |value: &dyn Fn(usize) -> f64| scenes().map(value).fold(f64::INFINITY, f64::min);
        add("largest loss", &|by| format!("{:+.2}", smallest(&|at| psnr(at, by) - psnr(at, 0)).min(0.0)));
        let best = |run: &Run| run.tests.values().map(|test| test.psnr).fold(f64::NEG_INFINITY, f64::max);
        let rise = |run: &Run| last(run) - best(run);
        add("largest fall along a run", &|by| format!("{:+.2}", smallest(&|at| mean(&rise, at, by))));
        for (at, scene) in self.scenes.iter().enumerate() {
            let Some(until) = scene.until else { continue };
            add(&format!("{} to {until} dB", scene.name), &|by| {
                let costs = self.seeds.iter().filter_map(|&seed| runs[&(at, by, seed)].cost_of(until));
                let costs: Vec<[f64; 2]> = costs.collect();
                let count = costs.len();
                let [iterations, seconds] =
                    [0, 1].map(|of| costs.iter().map(|cost| cost[of]).sum::<f64>() / count as f64);
                let part = if count < self.seeds.len() { format!(", {count} seeds") } else { String::new() };
                match count {
                    0 => "not reached".to_owned(),
                    _ => format!("{iterations:.0} iterations, {seconds:.1} s{part}"),
                }
            });
        }
        // Columns of runs, by scene.
        let mut tables: Vec<(String, Vec<Vec<[f64; 6]>>)> = Vec::new();
        for (by, recipe) in self.recipes.iter().enumerate() {
            let runs_of = |at| self.seeds.iter().map(move |&seed| runs[&(at, by, seed)].columns()).collect();
            tables.push((format!("Recipe {}", recipe.name), scenes().map(runs_of).collect()));
        }
        if let Some(source) = &self.published {
            let columns = |Published { psnr, ssim, lpips }| [psnr, ssim, lpips, f64::NAN, f64::NAN, f64::NAN];
            let published = self.scenes.iter().filter_map(|scene| scene.published.map(columns));
            tables.push((format!("Published: {source}"), published.map(|row| vec![row]).collect()));
        }
        for (title, of_scenes) in tables {
            text += &format!("\n{title}\n\n");
            let heads = ["scene", "PSNR", "SSIM", "LPIPS (VGG)", "CC-PSNR", "Gaussians", "minutes"];
            text += &row(heads.into_iter().map(String::from));
            text += &row(heads.into_iter().map(|_| "---".to_owned()));
            for (scene, of_scene) in self.scenes.iter().zip(&of_scenes) {
                text += &quality_row(&scene.name, of_scene, true);
            }
            text += &quality_row("**mean**", &of_scenes.concat(), self.scenes.len() == 1);
        }
        text
    }
}

/// Means over runs. `ranged`: PSNR with its least and most, where they differ.
fn quality_row(name: &str, runs: &[[f64; 6]], ranged: bool) -> String {
    let cell = |(column, digits): (usize, usize)| {
        let values = || runs.iter().map(|columns| columns[column]);
        let mean = values().sum::<f64>() / runs.len() as f64;
        let [low, high] = [values().fold(mean, f64::min), values().fold(mean, f64::max)];
        match column == 0 && ranged && low < high {
            true => format!("{mean:.digits$} ({low:.digits$} to {high:.digits$})"),
            false if mean.is_nan() => "–".to_owned(),
            false => format!("{mean:.digits$}"),
        }
    };
    row(std::iter::once(name.to_owned()).chain([2, 4, 4, 2, 0, 1].into_iter().enumerate().map(cell)))
}

fn row(cells: impl Iterator<Item = String>) -> String {
    format!("| {} |\n", cells.collect::<Vec<_>>().join(" | "))
}

impl Scene {
    /// The folder to train on: the data set's, or a new one with the chosen photographs.
    fn data(&self, source: &Path, folder: &Path) -> Result<PathBuf> {
        let Some(count) = self.photographs else { return Ok(source.to_owned()) };
        if self.options.iter().any(|option| option.starts_with("-i") || option.starts_with("--images")) {
            let problem =
                "takes some of the photographs in the folder images, and has an option for another folder";
            return Err(Error::argument(format!("scene {}", self.name), problem));
        }
        let model = Model::of_dataset(source)?;
        let chosen = self.choose(&model, count)?;
        let cameras = chosen.iter().map(|image| model.camera_of(image)).collect::<Result<Vec<_>>>()?;
        let framed =
            |at: &DVec3| cameras.iter().filter(|camera| camera.sees(at.as_vec3())).take(2).count() == 2;
        let pairs = model.points.positions.iter().zip(&model.points.colors).filter(|(at, _)| framed(at));
        let (positions, colors) = pairs.map(|(at, color)| (at.as_vec3().to_array(), *color)).unzip();
        let used: BTreeSet<u32> = chosen.iter().map(|image| image.camera_id).collect();
        let lenses: Vec<_> = used.iter().filter_map(|id| model.cameras.get(id).cloned()).collect();
        for image in &chosen {
            let from = image.photo_path(&source.join("images"), &model.file("images"))?;
            let to = image.photo_path(&folder.join("images"), &model.file("images"))?;
            let bytes = regular_file::read(&from, 1)?;
            atomic::create_folder(to.parent().unwrap_or(folder))?;
            atomic::write(&to, |w| w.write_all(&bytes))?;
        }
        let points = PointCloud { positions, colors };
        colmap::write(folder.join("sparse").join("0"), &lenses, &chosen, &points)?;
        Ok(folder.to_owned())
    }

    /// The chosen images, by name.
    fn choose(&self, model: &Model, count: usize) -> Result<Vec<ColmapImage>> {
        let mut images = model.images.clone();
        images.sort_by(|a, b| a.name.cmp(&b.name));
        let refuse = |problem: String| {
            Err(Error::argument(format!("scene {}", self.name), problem + "; change the suite's file"))
        };
        if count == 0 || count > images.len() {
            return refuse(format!("wants {count} photographs, there are {}", images.len()));
        }
        let Some(near) = &self.near else {
            let at = |i: usize| (self.first + i * images.len() / count) % images.len();
            let places: BTreeSet<usize> = (0..count).map(at).collect();
            return Ok(places.into_iter().map(|place| images[place].clone()).collect());
        };
        let eye = |image: &ColmapImage| -(image.rotation().transpose() * DVec3::from(image.translation));
        let Some(center) = images.iter().find(|image| image.name == *near).map(eye) else {
            return refuse(format!("has no photograph '{near}'"));
        };
        images.sort_by(|a, b| eye(a).distance(center).total_cmp(&eye(b).distance(center)));
        images.truncate(count);
        images.sort_by(|a, b| a.name.cmp(&b.name));
        Ok(images)
    }
}

/// Makes a run, unless it is finished.
fn finish(
    program: &Path,
    command: Vec<String>,
    folder: &Path,
    iterations: u32,
    stop: &AtomicBool,
) -> Result<Run> {
    let note = folder.with_extension("json");
    let made = machine::program();
    let setup = format!("{} {} {}", made.version, made.commit.unwrap_or_default(), command.join(" "));
    let earlier =
        regular_file::read_json(&note).ok().and_then(|text| serde_json::from_slice::<Run>(&text).ok());
    if let Some(run) = earlier.filter(|run| run.setup == setup) {
        return Ok(run);
    }
    session::check(stop)?;
    std::fs::remove_dir_all(folder).ok();
    atomic::create_folder(folder)?;
    let start = Instant::now();
    let mut child = Command::new(program);
    child.args(&command).arg("-m").arg(folder);
    let ended = run_logged(child, &folder.with_extension("log"), stop, &|_| ())?;
    if !ended.status.success() {
        let problem = format!(
            "a run failed: ashsplat {}",
            command.iter().map(|a| quoted(a)).collect::<Vec<_>>().join(" ")
        );
        let last_line = ended.tail.last().cloned().unwrap_or_default();
        return Err(Error::input(folder, problem, last_line));
    }
    let run = Run::read(folder, setup, iterations, start.elapsed().as_secs_f64())?;
    output::write_json(&note, &run)?;
    Ok(run)
}

impl Run {
    /// Values of a scene's row: PSNR, SSIM, LPIPS, CC-PSNR, Gaussians, minutes. NaN for what was not measured.
    fn columns(&self) -> [f64; 6] {
        let Quality { psnr, ssim, lpips, cc_psnr, gaussians } = self.last;
        [psnr, ssim, lpips.unwrap_or(f64::NAN), cc_psnr, gaussians as f64, self.seconds / 60.0]
    }

    fn read(folder: &Path, setup: String, iterations: u32, seconds: f64) -> Result<Run> {
        let path = folder.join(RESULTS_FILE);
        let wrong = |problem: String| Error::input(&path, problem, "remove the folder and run again");
        let entries: BTreeMap<String, Quality> =
            serde_json::from_slice(&regular_file::read_json(&path)?).map_err(|e| wrong(e.to_string()))?;
        let number = |name: &str| name.strip_prefix("ours_").and_then(|number| number.parse::<u32>().ok());
        let log = Rows::read(&folder.join(LOG_FILE))?;
        let seconds_until = |last: u32| {
            let own = log.iterations.iter().zip(&log.milliseconds);
            own.filter(|(iteration, _)| **iteration <= f64::from(last)).map(|(_, ms)| ms * 1e-3).sum::<f64>()
        };
        let test = |(name, entry): (&String, &Quality)| {
            let iteration = number(name)?;
            Some((iteration, Test { psnr: entry.psnr, seconds: seconds_until(iteration) }))
        };
        let tests: BTreeMap<u32, Test> = entries.iter().filter_map(test).collect();
        let last = entries.get(&format!("ours_{iterations}")).copied();
        let last = last.ok_or_else(|| wrong(format!("has no entry of iteration {iterations}")))?;
        Ok(Run { setup, seconds, tests, last })
    }

    /// Iterations and seconds of training until a PSNR is first reached, interpolated between tests.
    fn cost_of(&self, psnr: f64) -> Option<[f64; 2]> {
        let cost = |(&iteration, test): (&u32, &Test)| (test.psnr, [f64::from(iteration), test.seconds]);
        let costs: Vec<(f64, [f64; 2])> = self.tests.iter().map(cost).collect();
        let place = costs.iter().position(|(reached, _)| *reached >= psnr)?;
        let (reached, end) = costs[place];
        let Some((before, start)) = place.checked_sub(1).map(|before| costs[before]) else {
            return Some(end);
        };
        let share = (psnr - before) / (reached - before);
        Some([0, 1].map(|of| start[of] + share * (end[of] - start[of])))
    }
}
