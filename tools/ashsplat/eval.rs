//! `ashsplat eval`.

use ashsplat::{Camera, Error, RenderSettings, Renderer, Result};
use ashsplat_files::cameras_json;
use ashsplat_files::exposure_json::{self, EXPOSURE_FILE};
use ashsplat_files::{Gallery, View};
use ashsplat_program::appearance::Appearances;
use ashsplat_program::args::DeviceArguments;
use ashsplat_program::config::{CAMERAS_FILE, DataSettings, Split};
use ashsplat_program::eval::{
    Evaluation, ExtraMeasures, LpipsNetworks, Protocol, SceneSize, ViewResult, alignment_of, at_its_place,
    by_name, check_sizes, evaluate, read_weights, write_results,
};
use ashsplat_program::look::{LookArguments, NOTHING_SHOWN};
use ashsplat_program::model::{Model, ModelArguments};
use ashsplat_program::progress::{counting, thousands};
use ashsplat_program::session;
use clap::Args;
use serde_json::{Map, Value, json};
use std::cell::RefCell;
use std::collections::HashMap;
use std::path::PathBuf;

/// PSNR and SSIM of a trained scene on a data set, colour-corrected PSNR (for photos of other exposures), LPIPS where weights
/// are given; its Gaussians, its bytes and the time of a frame. What masks hide does not count.
///
/// A photo with an exposure in the model folder's exposure.json is compared under it. Training photos have one; held-out
/// photos have one only after --train-test-exp, and then only their right half counts.
///
/// For a model folder the data set, the size of the photos and the split are those of its training; results go
/// to its results.json and per_view.json.
#[derive(Args)]
pub struct Arguments {
    #[command(flatten)]
    model: ModelArguments,
    #[command(flatten)]
    data: session::DataArguments,
    /// Which views of a data set are held out for a file of Gaussians: as trainings here (inner) or as the reference does; a
    /// model folder keeps those of its training [default: inner]
    #[arg(long, value_name = "NAME")]
    eval_split: Option<Split>,
    /// Measure all views, not only those held out
    #[arg(long)]
    all: bool,
    /// Measure LPIPS too, by the weights in this file (safetensors, from tools/lpips_weights.py; nothing is downloaded): of AlexNet,
    /// on values from -1 to 1, or of VGG16, on values from 0 to 1 as the reference does; given twice, both
    #[arg(long, value_name = "FILE")]
    lpips_weights: Vec<PathBuf>,
    #[command(flatten)]
    look: LookArguments,
    #[command(flatten)]
    device: DeviceArguments,
    /// Print the table as JSON
    #[arg(long)]
    json: bool,
    /// No progress
    #[arg(long)]
    quiet: bool,
}

/// Approximate PSNR of unrelated pictures, dB.
const UNLIKE_DB: f64 = 10.0;

pub fn run(arguments: &Arguments) -> Result<()> {
    let model = arguments.model.locate()?;
    let mut data = arguments.data.applied_to(&model.settings.data)?;
    if model.folder.is_none() {
        // A bare PLY does not record its split.
        data.eval = true;
        data.eval_split = arguments.eval_split.unwrap_or(Split::Inner);
    } else if arguments.eval_split.is_some_and(|split| split != data.eval_split) {
        let problem =
            "differs from that of the model's training, so that photos would count which it was trained on";
        return Err(Error::argument("--eval-split", problem));
    }
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
    let guessed = model.folder.is_none() && arguments.eval_split.is_none() && !gallery.has_split();
    if guessed && !arguments.all && chosen.first() != Some(&0) {
        errln!(
            "warning: measured on inner views, as this program holds them out of few; were they trained on, give --eval-split reference"
        );
    }
    if data.eval && !arguments.all && model.folder.is_some() && !model.settings.data.eval {
        errln!("warning: the model was trained on all views, so also on those that are measured");
    }
    let protocol = protocol(&model, &gallery)?;
    check_sizes(&weights, &gallery, &chosen, !protocol.halves.is_empty())?;
    let mut renderer = Renderer::new(&context)?;
    renderer.upload_stored(&scene.gaussians, arguments.look.stored(&scene.gaussians))?;
    let look = arguments.look.settings(&model.settings, &scene.header)?;
    let settings = RenderSettings { inverse_depth: false, ..look };
    // With optimised poses, training views have their own; held-out views are aligned.
    let (pose_opt, lens_opt) = (model.settings.train.pose_opt, model.settings.train.lens_opt);
    if lens_opt && data.undistort {
        let problem = "does not go together with a model whose lenses were optimised";
        return Err(Error::argument("--undistort", problem));
    }
    let moved = match (&model.folder, pose_opt || lens_opt) {
        (Some((folder, _)), true) => by_name(cameras_json::read(folder.join(CAMERAS_FILE), &scene.frame)?),
        _ => HashMap::new(),
    };
    let bar = counting("views", chosen.len() as u64 * if pose_opt { 2 } else { 1 }, arguments.quiet);
    let view = |&index: &usize| match session::check(&stop) {
        Ok(()) => Some(gallery.view(index)?.map(|view| at_its_place(view, &moved, lens_opt))),
        Err(interrupted) => Some(Err(interrupted)),
    };
    let mut lpips = LpipsNetworks::new(&context, &weights)?;
    let views = chosen.iter().filter_map(view).inspect(|_| bar.inc(1));
    let more = ExtraMeasures { lpips: lpips.as_mut(), frame_times: true, ..Default::default() };
    let mut shows_any = false;
    let mut evaluation = evaluate(views, &protocol, more, |camera| {
        let frame = renderer.render(camera, &settings)?;
        shows_any |= frame.stats.visible > 0;
        Ok(frame)
    })?;
    if !shows_any && !evaluation.views.is_empty() {
        errln!("warning: {}", NOTHING_SHOWN);
    } else if evaluation.psnr() < UNLIKE_DB {
        errln!(
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
        evaluation.aligned = Some(Box::new(evaluate(aligned, &protocol, ExtraMeasures::default(), draw)?));
    }
    bar.finish_and_clear();
    evaluation.scene = Some(SceneSize { gaussians: scene.gaussians.len() as u64, bytes });
    if let (Some((folder, iteration)), false) = (&model.folder, arguments.all) {
        write_results(folder, *iteration, &evaluation)?;
    }
    print(arguments.json, &evaluation, context.device_name());
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
    let held_out = cameras.filter(|(_, held_out)| halves && *held_out).map(|(named, _)| named.name);
    Ok(Protocol { appearances: Appearances::read(folder)?, halves: held_out.collect() })
}

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

fn print(json: bool, evaluation: &Evaluation, device: &str) {
    let scene = evaluation.scene;
    if json {
        let value = json!({
            "gaussians": scene.map(|scene| scene.gaussians),
            "scene_bytes": scene.and_then(|scene| scene.bytes),
            "device": device,
            "mean": evaluation.summary(),
            "aligned_views": evaluation.aligned.as_deref().map(json_of),
            "views": json_of(evaluation),
        });
        outln!("{value:#}");
        return;
    }
    let columns = |values: &mut dyn Iterator<Item = (&str, String)>| -> String {
        values.map(|(name, value)| format!(" {value:>0$}", name.len().max(8))).collect()
    };
    let heads = columns(&mut evaluation.measures.iter().map(|name| (*name, (*name).to_owned())));
    outln!("{:<28} {:>8} {:>8} {:>8}{heads}", "view", "PSNR", "SSIM", "CC-PSNR");
    for view in &evaluation.views {
        let named = evaluation.measures.iter().zip(&view.lpips);
        let lpips = columns(&mut named.map(|(name, value)| (*name, format!("{value:.4}"))));
        outln!("{:<28} {:>8.3} {:>8.4} {:>8.3}{lpips}", view.name, view.psnr, view.ssim, view.cc_psnr);
    }
    if evaluation.views.is_empty() {
        outln!("no view was measured");
        return;
    }
    let mean = format!("mean of {}", evaluation.views.len());
    let lpips = columns(&mut evaluation.lpips().map(|(name, value)| (name, format!("{value:.4}"))));
    let row = |name: &str, of: &Evaluation| {
        format!("{name:<28} {:>8.3} {:>8.4} {:>8.3}", of.psnr(), of.ssim(), of.cc_psnr())
    };
    outln!("{}{lpips}", row(&mean, evaluation));
    if let Some(aligned) = &evaluation.aligned {
        outln!("{}", row("  with cameras aligned", aligned));
    }
    outln!("CC-PSNR: colour-corrected, by an affine map of each picture's colours to its photo");
    if let Some(SceneSize { gaussians, bytes }) = scene {
        let file = bytes.map_or_else(String::new, |bytes| format!(", {:.2} MB", bytes as f64 * 1e-6));
        let time = evaluation.frame_ms().unwrap_or(f64::NAN);
        outln!("{} Gaussians{file}, {time:.2} ms per frame on {device}", thousands(gaussians));
    }
    if evaluation.measures.is_empty() {
        outln!("LPIPS is not measured: it needs the weights of a network (--lpips-weights FILE)");
    }
}

fn json_of(evaluation: &Evaluation) -> Vec<Value> {
    let view = |view: &ViewResult| {
        let mut value: Map<String, Value> =
            evaluation.values(view).map(|(name, value)| (name.to_owned(), json!(value))).collect();
        value.insert("name".into(), json!(view.name));
        view.frame_ms.map(|time| value.insert("frame_ms".into(), json!(time)));
        Value::Object(value)
    };
    evaluation.views.iter().map(view).collect()
}
