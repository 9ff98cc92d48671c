//! `ashsplat eval`, and the measurement of held-out views that training and the demo share.

mod protocol;

use crate::args::DeviceArguments;
use crate::config::DataSettings;
use crate::model::Model;
use crate::progress::counting;
use crate::{output, render, session};
use ashsplat::{Camera, Error, Frame, RenderSettings, Renderer, Result};
use ashsplat_files::exposure_json::{self, EXPOSURE_FILE};
use ashsplat_files::metrics;
use ashsplat_files::{Gallery, Photo, View};
use clap::Args;
pub use protocol::Protocol;
use serde_json::{Map, Value, json};
use std::borrow::Borrow;
use std::path::{Path, PathBuf};

/// PSNR and SSIM of a trained scene on a data set. What masks hide does not count.
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

/// Means over the held-out views, by iteration.
pub const RESULTS_FILE: &str = "results.json";
/// The same for each view.
pub const PER_VIEW_FILE: &str = "per_view.json";

/// Quality of one view.
#[derive(Clone)]
pub struct ViewResult {
    pub name: String,
    pub psnr: f64,
    pub ssim: f64,
}

/// Quality of all views of a test.
#[derive(Clone)]
pub struct Evaluation {
    pub views: Vec<ViewResult>,
}

impl Evaluation {
    /// Mean over the views, dB; no number where none was measured.
    pub fn psnr(&self) -> f64 {
        self.mean(|view| view.psnr)
    }

    /// Mean over the views; no number where none was measured.
    pub fn ssim(&self) -> f64 {
        self.mean(|view| view.ssim)
    }

    fn mean(&self, value: impl Fn(&ViewResult) -> f64) -> f64 {
        self.views.iter().map(value).sum::<f64>() / self.views.len() as f64
    }

    /// Both means in words.
    pub fn describe(&self) -> String {
        match self.views.is_empty() {
            true => "PSNR and SSIM not measured".into(),
            false => format!("PSNR {:.2} dB, SSIM {:.4}", self.psnr(), self.ssim()),
        }
    }

    /// The reference's entry in results.json.
    pub fn summary(&self) -> Value {
        json!({ "SSIM": self.ssim(), "PSNR": self.psnr() })
    }

    /// The reference's entry in per_view.json, whose views are named after their saved renders.
    pub fn per_view(&self) -> Value {
        let by_view = |value: fn(&ViewResult) -> f64| -> Map<String, Value> {
            let named = |(index, view): (usize, &ViewResult)| (format!("{index:05}.png"), json!(value(view)));
            self.views.iter().enumerate().map(named).collect()
        };
        json!({ "SSIM": by_view(|view| view.ssim), "PSNR": by_view(|view| view.psnr) })
    }
}

/// Where the pictures of a test are saved, as `renders/00000.png` and `gt/00000.png`. One that cannot be written ends the
/// saving, and not the test.
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

    /// Whether all were written.
    pub fn saved(self) -> Result<()> {
        self.saved
    }
}

/// Renders the views, measures them and, if asked, saves them. One view is held at a time.
pub fn evaluate<V: Borrow<View>>(
    views: impl Iterator<Item = Result<V>>,
    protocol: &Protocol,
    mut pictures: Option<&mut Pictures>,
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
        let (view, frame) = protocol.prepared(view, draw(&view.camera)?)?;
        results.push(measure(&view, &frame)?);
        if let Some(pictures) = &mut pictures {
            pictures.save("renders", index, &output::to_photo(&frame)?);
            let photo = view.photo.photo()?;
            pictures.save("gt", index, &photo);
        }
    }
    Ok(Evaluation { views: results })
}

/// Whether a view's mask hides all of it.
pub fn is_hidden(view: &View) -> Result<bool> {
    Ok(view.photo.mask()?.is_some_and(|mask| mask.iter().all(|&counts| counts == 0)))
}

/// PSNR of a frame, clamped to [0, 1], against what of the view's photo counts, dB.
pub fn psnr(view: &View, frame: &Frame) -> Result<f64> {
    let photo = view.photo.photo()?.to_f32();
    match view.photo.mask()? {
        None => metrics::psnr(&frame.color, &photo),
        Some(mask) => metrics::masked_psnr(&frame.color, &photo, &mask),
    }
}

/// As [`psnr`], and SSIM.
fn measure(view: &View, frame: &Frame) -> Result<ViewResult> {
    let photo = view.photo.photo()?.to_f32();
    let ssim = match view.photo.mask()? {
        None => metrics::ssim(&frame.color, &photo, frame.width)?,
        Some(mask) => metrics::masked_ssim(&frame.color, &photo, &mask, frame.width)?,
    };
    Ok(ViewResult { name: view.name.clone(), psnr: psnr(view, frame)?, ssim })
}

/// Adds an iteration's results to a model folder's results.json and per_view.json, keeping those of others.
pub fn write_results(folder: &Path, iteration: u32, evaluation: &Evaluation) -> Result<()> {
    let key = format!("ours_{iteration}");
    for (file, entry) in [(RESULTS_FILE, evaluation.summary()), (PER_VIEW_FILE, evaluation.per_view())] {
        let path = folder.join(file);
        let mut results = match std::fs::read_to_string(&path) {
            Ok(text) => serde_json::from_str::<Map<String, Value>>(&text)
                .map_err(|e| Error::input(&path, e.to_string(), "remove the file and run again"))?,
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => Map::new(),
            Err(e) => return Err(Error::io(&path, "read", e)),
        };
        results.insert(key.clone(), entry);
        output::write_json(&path, &results)?;
    }
    Ok(())
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> Result<()> {
    let path = arguments.model.as_ref().or(arguments.model_path.as_ref());
    let path = path.ok_or_else(|| Error::argument("MODEL", "is missing"))?;
    let model = Model::locate(path, arguments.iteration)?;
    let mut data = arguments.data.applied_to(&model.settings.data)?;
    // A bare PLY does not record its split: use the default one.
    data.eval |= model.folder.is_none();
    let scene = arguments.look.load(&model.ply, &arguments.device.host)?;
    let white = model.settings.train.white_background;
    let context = arguments.device.context()?;
    let stop = session::stop_on_ctrl_c()?;
    let options = session::options(&data, white, &arguments.device.host)?;
    let gallery = session::open(&data, &options, &stop)?;
    session::warn(gallery.warnings());
    let chosen = chosen_views(&gallery, arguments.all, &data)?;
    let protocol = protocol(&model, &gallery)?;
    let mut renderer = Renderer::new(&context)?;
    renderer.upload(&scene.gaussians)?;
    let look = arguments.look.settings(&model.settings, &scene.header)?;
    let settings = RenderSettings { inverse_depth: false, ..look };
    let bar = counting("views", chosen.len() as u64, arguments.quiet);
    let views = chosen.into_iter().filter_map(|index| match session::check(&stop) {
        Ok(()) => gallery.view(index),
        Err(interrupted) => Some(Err(interrupted)),
    });
    let evaluation = evaluate(views, &protocol, None, |camera| {
        bar.inc(1);
        renderer.render(camera, &settings)
    })?;
    bar.finish_and_clear();
    if let (Some((folder, iteration)), false) = (&model.folder, arguments.all) {
        write_results(folder, *iteration, &evaluation)?;
    }
    print_results(arguments.json, &evaluation, scene.gaussians.len())?;
    arguments.device.report_validation(&context);
    Ok(())
}

/// The exposures of a model folder, and the halves that its training left.
fn protocol(model: &Model, gallery: &Gallery) -> Result<Protocol> {
    let Some((folder, _)) = &model.folder else { return Ok(Protocol::default()) };
    let file = folder.join(EXPOSURE_FILE);
    let halves = model.settings.data.train_test_exp;
    if !halves && !file.is_file() {
        return Ok(Protocol::default());
    }
    let cameras = gallery.cameras().into_iter().zip(gallery.held_out());
    let held_out = cameras.filter(|(_, held_out)| halves && **held_out).map(|(named, _)| named.name);
    Ok(Protocol { exposures: exposure_json::read(&file)?, halves: held_out.collect() })
}

/// Which views are measured.
fn chosen_views(gallery: &Gallery, all: bool, data: &DataSettings) -> Result<Vec<usize>> {
    let held_out = gallery.held_out();
    let chosen: Vec<usize> = (0..held_out.len()).filter(|&index| all || held_out[index]).collect();
    if chosen.is_empty() {
        let problem =
            if data.eval { "has no views to hold out" } else { "was trained on all views of this data set" };
        return Err(Error::input(
            &data.source_path,
            problem,
            "measure on all views with --all, or hold out with --eval",
        ));
    }
    Ok(chosen)
}

fn print_results(json: bool, evaluation: &Evaluation, gaussians: usize) -> Result<()> {
    if json {
        let value = json!({
            "gaussians": gaussians,
            "mean": evaluation.summary(),
            "views": evaluation.views.iter().map(|v| json!({"name": v.name, "PSNR": v.psnr, "SSIM": v.ssim})).collect::<Vec<_>>(),
        });
        say!("{value:#}");
        return Ok(());
    }
    say!("{:<28} {:>8} {:>8}", "view", "PSNR", "SSIM");
    for view in &evaluation.views {
        say!("{:<28} {:>8.3} {:>8.4}", view.name, view.psnr, view.ssim);
    }
    if evaluation.views.is_empty() {
        say!("no view was measured");
        return Ok(());
    }
    let mean = format!("mean of {}", evaluation.views.len());
    say!("{mean:<28} {:>8.3} {:>8.4}", evaluation.psnr(), evaluation.ssim());
    Ok(())
}
