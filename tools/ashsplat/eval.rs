//! `ashsplat eval`, and the measurement of held-out views that training and the demo share.

mod perceptual;
mod protocol;
mod table;

pub use perceptual::{Perceptual, check_sizes, read_weights};
pub use protocol::Protocol;

use crate::args::DeviceArguments;
use crate::config::{CAMERAS_FILE, DataSettings};
use crate::light::Lights;
use crate::model::Model;
use crate::progress::counting;
use crate::{output, render, session};
use ashsplat::lpips::Network;
use ashsplat::{Alignment, Camera, Error, Frame, RenderSettings, Renderer, Result, TrainSettings};
use ashsplat_files::cameras_json::{self, NamedCamera};
use ashsplat_files::exposure_json::{self, EXPOSURE_FILE};
use ashsplat_files::metrics;
use ashsplat_files::regular_file;
use ashsplat_files::{Gallery, Photo, View};
use clap::Args;
use serde_json::{Map, Value, json};
use std::borrow::Borrow;
use std::cell::RefCell;
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// PSNR and SSIM of a trained scene on a data set, LPIPS where weights are given; its Gaussians, its bytes and the time of a
/// frame. What masks hide does not count.
///
/// Photos with an exposure in the model folder's exposure.json are compared under it: those that were trained on. Held-out
/// ones have one after a training with --train-test-exp only, and then their right half counts.
///
/// For a model folder the data set, the size of the photos and the split are those of its training; results go
/// to its results.json and per_view.json.
#[derive(Args)]
pub struct Arguments {
    /// A model folder or a file of Gaussians
    #[arg(value_name = "MODEL", required_unless_present = "model_path")]
    model: Option<PathBuf>,
    /// The same, under the reference's name
    #[arg(short, long, value_name = "MODEL", conflicts_with = "model")]
    model_path: Option<PathBuf>,
    /// Iteration of the model folder's PLY [default: what was saved last]
    #[arg(long, value_name = "N")]
    iteration: Option<u32>,
    #[command(flatten)]
    data: session::DataArguments,
    /// Measure all views, not only those held out
    #[arg(long)]
    all: bool,
    /// Measure LPIPS too, by the weights in this file (safetensors, from tools/lpips_weights.py; nothing is downloaded): of AlexNet,
    /// on values from -1 to 1, or of VGG16, on values from 0 to 1 as the reference does; given twice, both
    #[arg(long, value_name = "FILE")]
    lpips_weights: Vec<PathBuf>,
    #[command(flatten)]
    look: render::LookArguments,
    #[command(flatten)]
    device: DeviceArguments,
    /// Print the table as JSON
    #[arg(long)]
    json: bool,
    /// No progress
    #[arg(long)]
    quiet: bool,
}

/// PSNR of unrelated pictures, about, dB.
const UNLIKE_DB: f64 = 10.0;

/// File of the means over the held-out views, by iteration.
pub const RESULTS_FILE: &str = "results.json";
/// File of each view's results, by iteration.
pub const PER_VIEW_FILE: &str = "per_view.json";

/// Quality of one view.
#[derive(Clone, Default)]
pub struct ViewResult {
    pub name: String,
    pub psnr: f64,
    pub ssim: f64,
    /// One for each of [`Evaluation::measures`].
    pub lpips: Vec<f64>,
    /// Time of a frame, if requested: device time if there are timestamps, else wall-clock time of the call.
    pub frame_ms: Option<f64>,
}

/// Size of a scene.
#[derive(Clone, Copy)]
pub struct SceneSize {
    pub gaussians: u64,
    /// Size of its file.
    pub bytes: Option<u64>,
}

/// Quality of all views of a test.
#[derive(Clone, Default)]
pub struct Evaluation {
    pub views: Vec<ViewResult>,
    /// Names of the LPIPS that were measured.
    pub measures: Vec<&'static str>,
    pub scene: Option<SceneSize>,
    /// The same views with cameras aligned to the scene, if training optimised the poses.
    pub aligned: Option<Box<Evaluation>>,
}

/// Further measurements of views besides PSNR and SSIM.
#[derive(Default)]
pub struct More<'a> {
    /// Saves the pictures.
    pub pictures: Option<&'a mut Pictures>,
    /// Measures LPIPS.
    pub lpips: Option<&'a mut Perceptual>,
    /// Draws each frame a second time and measures its time.
    pub frame_times: bool,
}

impl Evaluation {
    /// Mean over the views, dB; NaN if none was measured.
    pub fn psnr(&self) -> f64 {
        self.mean(|view| view.psnr)
    }

    /// Mean over the views; NaN if none was measured.
    pub fn ssim(&self) -> f64 {
        self.mean(|view| view.ssim)
    }

    /// Name and mean over the views of each measured LPIPS.
    pub fn lpips(&self) -> impl Iterator<Item = (&'static str, f64)> {
        self.measures.iter().enumerate().map(|(index, name)| (*name, self.mean(|view| view.lpips[index])))
    }

    /// Median frame time over the views, milliseconds, if it was measured.
    pub fn frame_ms(&self) -> Option<f64> {
        let mut times: Vec<f64> = self.views.iter().filter_map(|view| view.frame_ms).collect();
        times.sort_by(f64::total_cmp);
        let middle = times.len() / 2;
        let upper = times.get(middle)?;
        Some(if times.len().is_multiple_of(2) { (times[middle - 1] + upper) / 2.0 } else { *upper })
    }

    fn mean(&self, value: impl Fn(&ViewResult) -> f64) -> f64 {
        self.views.iter().map(value).sum::<f64>() / self.views.len() as f64
    }

    /// The means, for a message.
    pub fn describe(&self) -> String {
        if self.views.is_empty() {
            return "PSNR and SSIM not measured".into();
        }
        let lpips: String = self.lpips().map(|(name, value)| format!(", {name} {value:.4}")).collect();
        let aligned = self.aligned.as_ref().filter(|aligned| !aligned.views.is_empty());
        let aligned = aligned.map(|aligned| format!(" (cameras aligned: {})", aligned.describe()));
        format!("PSNR {:.2} dB, SSIM {:.4}{lpips}{}", self.psnr(), self.ssim(), aligned.unwrap_or_default())
    }

    /// The reference's entry in results.json, with additional values. Its LPIPS is that of VGG16, unscaled.
    pub fn summary(&self) -> Value {
        let mut summary = Map::new();
        summary.insert("SSIM".into(), json!(self.ssim()));
        summary.insert("PSNR".into(), json!(self.psnr()));
        if let Some(aligned) = &self.aligned {
            summary.insert("SSIM_aligned".into(), json!(aligned.ssim()));
            summary.insert("PSNR_aligned".into(), json!(aligned.psnr()));
        }
        for (name, value) in self.lpips() {
            if name == Network::Vgg16.measure() {
                summary.insert("LPIPS".into(), json!(value));
            }
            summary.insert(name.into(), json!(value));
        }
        if let Some(scene) = self.scene {
            summary.insert("gaussians".into(), json!(scene.gaussians));
            scene.bytes.map(|bytes| summary.insert("scene_bytes".into(), json!(bytes)));
        }
        self.frame_ms().map(|time| summary.insert("frame_ms".into(), json!(time)));
        Value::Object(summary)
    }

    /// The reference's entry in per_view.json, whose views are named after their saved renders.
    pub fn per_view(&self) -> Value {
        let by_view = |value: &dyn Fn(&ViewResult) -> f64| -> Value {
            let named = |(index, view): (usize, &ViewResult)| (format!("{index:05}.png"), json!(value(view)));
            Value::Object(self.views.iter().enumerate().map(named).collect())
        };
        let mut all = Map::new();
        all.insert("SSIM".into(), by_view(&|view| view.ssim));
        all.insert("PSNR".into(), by_view(&|view| view.psnr));
        for (index, name) in self.measures.iter().enumerate() {
            all.insert((*name).into(), by_view(&|view| view.lpips[index]));
        }
        if let Some(aligned) = &self.aligned
            && let Value::Object(of_aligned) = aligned.per_view()
        {
            all.extend(of_aligned.into_iter().map(|(name, values)| (format!("{name}_aligned"), values)));
        }
        Value::Object(all)
    }
}

/// Saves the pictures of a test as `renders/00000.png` and `gt/00000.png`. A picture that cannot be written ends the
/// saving, not the test.
pub struct Pictures {
    folder: PathBuf,
    saved: Result<()>,
}

impl Pictures {
    pub fn new(folder: PathBuf) -> Pictures {
        Pictures { folder, saved: Ok(()) }
    }

    fn save(&mut self, kind: &str, index: usize, picture: &Photo) {
        if self.saved.is_ok() {
            let path = output::numbered(&self.folder.join(kind), index, "png");
            self.saved = output::write_png(&path, picture);
        }
    }

    /// The first error of saving, if any.
    pub fn saved(self) -> Result<()> {
        self.saved
    }
}

/// Renders and measures the views, and saves them if requested. One view is in memory at a time.
pub fn evaluate<V: Borrow<View>>(
    views: impl Iterator<Item = Result<V>>,
    protocol: &Protocol,
    More { mut pictures, mut lpips, frame_times }: More,
    mut draw: impl FnMut(&Camera) -> Result<Frame>,
) -> Result<Evaluation> {
    let mut results = Vec::new();
    for view in views {
        let view = view?;
        let view: &View = view.borrow();
        if is_hidden(view)? {
            tell!("warning: {}: its mask hides all of it: not measured", view.name);
            continue;
        }
        let index = results.len();
        let (measured, frame) = protocol.prepared(view, draw(&view.camera)?)?;
        let mut result = measure(&measured, &frame)?;
        if let Some(lpips) = &mut lpips {
            result.lpips = lpips.measure(&measured, &frame)?;
        }
        if frame_times {
            result.frame_ms = Some(frame_ms(|| draw(&view.camera))?);
        }
        results.push(result);
        let view = measured;
        if let Some(pictures) = &mut pictures {
            pictures.save("renders", index, &output::to_photo(&frame)?);
            let photo = view.photo.photo()?;
            pictures.save("gt", index, &photo);
        }
    }
    let measures = lpips.map_or_else(Vec::new, |lpips| lpips.names());
    Ok(Evaluation { views: results, measures, scene: None, aligned: None })
}

/// Time of a warm frame, milliseconds.
fn frame_ms(draw: impl FnOnce() -> Result<Frame>) -> Result<f64> {
    let start = Instant::now();
    let frame = draw()?;
    let wall = start.elapsed().as_secs_f64() * 1e3;
    let stages = frame.stats.scopes.iter().filter(|scope| scope.depth == 0);
    let device = stages.map(|scope| scope.nanoseconds).sum::<f64>() * 1e-6;
    Ok(if device > 0.0 { device } else { wall })
}

/// True if a view's mask hides all of it.
pub fn is_hidden(view: &View) -> Result<bool> {
    Ok(view.photo.mask()?.is_some_and(|mask| mask.iter().all(|&counts| counts == 0)))
}

/// PSNR of a frame, clamped to [0, 1], against the visible pixels of the view's photo, dB.
pub fn psnr(view: &View, frame: &Frame) -> Result<f64> {
    let photo = view.photo.photo()?.to_f32();
    match view.photo.mask()? {
        None => metrics::psnr(&frame.color, &photo),
        Some(mask) => metrics::masked_psnr(&frame.color, &photo, &mask),
    }
}

/// Same as [`psnr`], and SSIM.
fn measure(view: &View, frame: &Frame) -> Result<ViewResult> {
    let photo = view.photo.photo()?.to_f32();
    let ssim = match view.photo.mask()? {
        None => metrics::ssim(&frame.color, &photo, frame.width)?,
        Some(mask) => metrics::masked_ssim(&frame.color, &photo, &mask, frame.width)?,
    };
    let name = view.name.clone();
    Ok(ViewResult { name, psnr: psnr(view, frame)?, ssim, lpips: Vec::new(), frame_ms: None })
}

/// Adds an iteration's results to a model folder's results.json and per_view.json. Other iterations' results stay.
pub fn write_results(folder: &Path, iteration: u32, evaluation: &Evaluation) -> Result<()> {
    let key = format!("ours_{iteration}");
    for (file, entry) in [(RESULTS_FILE, evaluation.summary()), (PER_VIEW_FILE, evaluation.per_view())] {
        let path = folder.join(file);
        let mut results = match regular_file::read_json(&path) {
            Ok(text) => serde_json::from_slice::<Map<String, Value>>(&text)
                .map_err(|e| Error::input(&path, e.to_string(), "remove the file and run again"))?,
            Err(Error::Io { source, .. }) if source.kind() == std::io::ErrorKind::NotFound => Map::new(),
            Err(error) => return Err(error),
        };
        results.insert(key.clone(), entry);
        output::write_json(&path, &results)?;
    }
    Ok(())
}

pub fn run(arguments: &Arguments) -> Result<()> {
    let path = arguments.model.as_ref().or(arguments.model_path.as_ref());
    let path = path.ok_or_else(|| Error::argument("MODEL", "is missing"))?;
    let model = Model::locate(path, arguments.iteration)?;
    let mut data = arguments.data.applied_to(&model.settings.data)?;
    // A bare PLY does not record its split: use the default one.
    data.eval |= model.folder.is_none();
    let weights = read_weights(&arguments.lpips_weights, &arguments.device.host)?;
    let bytes = std::fs::metadata(&model.ply).ok().map(|file| file.len());
    let scene = arguments.look.load(&model.ply, &arguments.device.host)?;
    let white = model.settings.train.white_background;
    let context = arguments.device.context()?;
    let stop = session::stop_on_ctrl_c()?;
    let mut options = session::options(&data, white, &arguments.device.host)?;
    options.frame = Some(scene.frame);
    let gallery = session::open(&data, &options, &stop)?;
    session::warn(gallery.warnings());
    let chosen = chosen_views(&gallery, arguments.all, &data)?;
    if data.eval && !arguments.all && model.folder.is_some() && !model.settings.data.eval {
        tell!("warning: the model was trained on all views, so also on those that are measured");
    }
    let protocol = protocol(&model, &gallery)?;
    check_sizes(&weights, &gallery, &chosen, !protocol.halves.is_empty())?;
    let mut renderer = Renderer::new(&context)?;
    renderer.upload(&scene.gaussians)?;
    let look = arguments.look.settings(&model.settings, &scene.header)?;
    let settings = RenderSettings { inverse_depth: false, ..look };
    // With optimised poses, training views have their own; held-out views are aligned.
    let pose_opt = model.settings.train.pose_opt;
    let moved = match (&model.folder, pose_opt) {
        (Some((folder, _)), true) => by_name(cameras_json::read(folder.join(CAMERAS_FILE), &scene.frame)?),
        _ => HashMap::new(),
    };
    let bar = counting("views", chosen.len() as u64 * if pose_opt { 2 } else { 1 }, arguments.quiet);
    let view = |&index: &usize| match session::check(&stop) {
        Ok(()) => Some(gallery.view(index)?.map(|view| at_its_place(view, &moved))),
        Err(interrupted) => Some(Err(interrupted)),
    };
    let mut lpips = Perceptual::new(&context, &weights)?;
    let views = chosen.iter().filter_map(view).inspect(|_| bar.inc(1));
    let more = More { lpips: lpips.as_mut(), frame_times: true, ..Default::default() };
    let mut shows_any = false;
    let mut evaluation = evaluate(views, &protocol, more, |camera| {
        let frame = renderer.render(camera, &settings)?;
        shows_any |= frame.stats.visible > 0;
        Ok(frame)
    })?;
    if !shows_any && !evaluation.views.is_empty() {
        tell!("warning: {}", render::NOTHING_SHOWN);
    } else if evaluation.psnr() < UNLIKE_DB {
        tell!(
            "warning: the pictures have hardly anything in common with the photos: is the scene in the coordinates of this data set?"
        );
    }
    if pose_opt {
        let renderer = RefCell::new(renderer);
        let alignment = alignment_of(&model.settings.train);
        let held_out = gallery.held_out();
        let aligned = chosen.iter().filter_map(|index| {
            let view = view(index)?;
            if !held_out[*index] {
                return Some(view);
            }
            Some(view.and_then(|view| {
                let aligned = renderer.borrow_mut().align(&view.camera, &view.photo, &settings, &alignment);
                Ok(View { camera: aligned?, ..view })
            }))
        });
        let aligned = aligned.inspect(|_| bar.inc(1));
        let draw = |camera: &Camera| renderer.borrow_mut().render(camera, &settings);
        evaluation.aligned = Some(Box::new(evaluate(aligned, &protocol, More::default(), draw)?));
    }
    bar.finish_and_clear();
    evaluation.scene = Some(SceneSize { gaussians: scene.gaussians.len() as u64, bytes });
    if let (Some((folder, iteration)), false) = (&model.folder, arguments.all) {
        write_results(folder, *iteration, &evaluation)?;
    }
    table::print(arguments.json, &evaluation, context.device_name());
    arguments.device.report_validation(&context);
    Ok(())
}

/// The learned exposures of a model folder, and the views whose left half was trained on.
fn protocol(model: &Model, gallery: &Gallery) -> Result<Protocol> {
    let Some((folder, _)) = &model.folder else { return Ok(Protocol::default()) };
    let halves = model.settings.data.train_test_exp;
    if halves {
        // Halves can only be compared with their exposures, so a missing file is an error.
        exposure_json::read(folder.join(EXPOSURE_FILE))?;
    }
    let cameras = gallery.cameras().into_iter().zip(gallery.held_out());
    let held_out = cameras.filter(|(_, held_out)| halves && **held_out).map(|(named, _)| named.name);
    Ok(Protocol { lights: Lights::read(folder)?, halves: held_out.collect() })
}

/// Settings for aligning cameras to a scene: training's loss.
pub fn alignment_of(settings: &TrainSettings) -> Alignment {
    Alignment { lambda_dssim: settings.lambda_dssim as f32, ..Alignment::default() }
}

/// Cameras by the names of their photos.
pub fn by_name(cameras: Vec<NamedCamera>) -> HashMap<String, Camera> {
    cameras.into_iter().map(|NamedCamera { name, camera }| (name, camera)).collect()
}

/// A view at its camera's pose in `cameras`, if it has one.
pub fn at_its_place(view: View, cameras: &HashMap<String, Camera>) -> View {
    match cameras.get(&view.name) {
        None => view,
        Some(at) => {
            let (camera_from_world, translation) = (at.camera_from_world, at.translation);
            let camera = Camera { camera_from_world, translation, ..view.camera };
            View { camera, ..view }
        }
    }
}

/// Indices of the measured views.
fn chosen_views(gallery: &Gallery, all: bool, data: &DataSettings) -> Result<Vec<usize>> {
    let held_out = gallery.held_out();
    let chosen: Vec<usize> = (0..held_out.len()).filter(|&index| all || held_out[index]).collect();
    if chosen.is_empty() {
        let problem =
            if data.eval { "has no views to hold out" } else { "was trained on all views of this data set" };
        return Err(Error::input(&data.source_path, problem, "measure on all views with --all"));
    }
    Ok(chosen)
}
