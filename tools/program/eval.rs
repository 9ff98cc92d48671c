//! Measures how a scene's pictures agree with photographs.

use crate::appearance::Appearances;
use crate::args::HostArguments;
use crate::measure::median;
use crate::output;
use ashsplat::passes::lpips::{Lpips, Network, Weights};
use ashsplat::scene::StoredPhoto;
use ashsplat::vk::Context;
use ashsplat::{Alignment, Camera, Error, Frame, Result, TrainSettings};
use ashsplat_files::cameras_json::NamedCamera;
use ashsplat_files::{Gallery, Photo, View, lpips_weights, metrics, regular_file};
use serde_json::{Map, Value, json};
use std::borrow::{Borrow, Cow};
use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// File of the means over the held-out views, by iteration.
pub const RESULTS_FILE: &str = "results.json";
/// File of each view's results, by iteration.
pub const PER_VIEW_FILE: &str = "per_view.json";

#[derive(Clone, Default)]
pub struct ViewResult {
    pub name: String,
    pub psnr: f64,
    pub ssim: f64,
    /// [`metrics::cc_psnr`].
    pub cc_psnr: f64,
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

#[derive(Clone, Default)]
pub struct Evaluation {
    pub views: Vec<ViewResult>,
    pub measures: Vec<&'static str>,
    pub scene: Option<SceneSize>,
    /// The same views with cameras aligned to the scene, if training optimised the poses.
    pub aligned: Option<Box<Evaluation>>,
}

/// Further measurements of views besides PSNR and SSIM.
#[derive(Default)]
pub struct ExtraMeasures<'a> {
    pub pictures: Option<&'a mut Pictures>,
    pub lpips: Option<&'a mut LpipsNetworks>,
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

    /// Mean over the views of the colour-corrected PSNR, dB; NaN if none was measured.
    pub fn cc_psnr(&self) -> f64 {
        self.mean(|view| view.cc_psnr)
    }

    /// Name and mean over the views of each measured LPIPS.
    pub fn lpips(&self) -> impl Iterator<Item = (&'static str, f64)> {
        self.measures.iter().enumerate().map(|(index, name)| (*name, self.mean(|view| view.lpips[index])))
    }

    /// Median frame time over the views, milliseconds, if it was measured.
    pub fn frame_ms(&self) -> Option<f64> {
        median(self.views.iter().filter_map(|view| view.frame_ms).collect())
    }

    fn mean(&self, value: impl Fn(&ViewResult) -> f64) -> f64 {
        self.views.iter().map(value).sum::<f64>() / self.views.len() as f64
    }

    /// The means, for a message. `corrected` adds the CC-PSNR.
    pub fn describe(&self, corrected: bool) -> String {
        if self.views.is_empty() {
            return "PSNR and SSIM not measured".into();
        }
        let lpips: String = self.lpips().map(|(name, value)| format!(", {name} {value:.4}")).collect();
        let aligned = self.aligned.as_ref().filter(|aligned| !aligned.views.is_empty());
        let aligned = aligned.map(|aligned| format!(" (cameras aligned: {})", aligned.describe(corrected)));
        let fit =
            if corrected { format!(" (colour-corrected {:.2})", self.cc_psnr()) } else { String::new() };
        format!(
            "PSNR {:.2} dB{fit}, SSIM {:.4}{lpips}{}",
            self.psnr(),
            self.ssim(),
            aligned.unwrap_or_default()
        )
    }

    /// The reference's entry in results.json, with additional values. Its LPIPS is that of VGG16, unscaled.
    pub fn summary(&self) -> Value {
        let mut summary = Map::new();
        summary.insert("SSIM".into(), json!(self.ssim()));
        summary.insert("PSNR".into(), json!(self.psnr()));
        summary.insert("CC_PSNR".into(), json!(self.cc_psnr()));
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

    pub fn values(&self, view: &ViewResult) -> impl Iterator<Item = (&'static str, f64)> {
        let own = [("SSIM", view.ssim), ("PSNR", view.psnr), ("CC_PSNR", view.cc_psnr)];
        own.into_iter().chain(self.measures.iter().copied().zip(view.lpips.clone()))
    }

    /// The reference's entry in per_view.json, whose views are named after their saved renders.
    fn per_view(&self) -> Map<String, Value> {
        let mut all = Map::new();
        for (index, view) in self.views.iter().enumerate() {
            for (name, value) in self.values(view) {
                let of_name = all.entry(name).or_insert_with(|| json!({}));
                of_name[format!("{index:05}.png")] = json!(value);
            }
        }
        if let Some(aligned) = &self.aligned {
            let of_aligned = aligned.per_view().into_iter();
            all.extend(of_aligned.map(|(name, values)| (format!("{name}_aligned"), values)));
        }
        all
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

    pub fn saved(self) -> Result<()> {
        self.saved
    }
}

/// Renders and measures the views, and saves them if requested. One view is in memory at a time.
pub fn evaluate<V: Borrow<View>>(
    views: impl Iterator<Item = Result<V>>,
    protocol: &Protocol,
    ExtraMeasures { mut pictures, mut lpips, frame_times }: ExtraMeasures,
    mut draw: impl FnMut(&Camera) -> Result<Frame>,
) -> Result<Evaluation> {
    let mut results = Vec::new();
    for view in views {
        let view = view?;
        let view: &View = view.borrow();
        if is_hidden(view)? {
            errln!("warning: {}: its mask hides all of it: not measured", view.name);
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

pub fn is_hidden(view: &View) -> Result<bool> {
    Ok(view.photo.mask()?.is_some_and(|mask| mask.iter().all(|&counts| counts == 0)))
}

/// PSNR of a frame, clamped to [0, 1], against the visible pixels of the view's photo, dB.
pub fn psnr(view: &View, frame: &Frame) -> Result<f64> {
    let photo = view.photo.photo()?.to_f32();
    metrics::psnr(&frame.color, &photo, view.photo.mask()?.as_deref())
}

/// Same as [`psnr`], with SSIM and CC-PSNR.
fn measure(view: &View, frame: &Frame) -> Result<ViewResult> {
    let photo = view.photo.photo()?.to_f32();
    let mask = view.photo.mask()?;
    let ssim = metrics::ssim(&frame.color, &photo, mask.as_deref(), frame.width)?;
    let cc_psnr = metrics::cc_psnr(&frame.color, &photo, mask.as_deref())?;
    let name = view.name.clone();
    Ok(ViewResult { name, psnr: psnr(view, frame)?, ssim, cc_psnr, lpips: Vec::new(), frame_ms: None })
}

/// Adds an iteration's results to a model folder's results.json and per_view.json. Other iterations' results stay.
pub fn write_results(folder: &Path, iteration: u32, evaluation: &Evaluation) -> Result<()> {
    let key = format!("ours_{iteration}");
    for (file, entry) in [(RESULTS_FILE, evaluation.summary()), (PER_VIEW_FILE, evaluation.per_view().into())]
    {
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

/// Settings for aligning cameras to a scene: training's loss.
pub fn alignment_of(settings: &TrainSettings) -> Alignment {
    Alignment { lambda_dssim: settings.lambda_dssim as f32, ..Alignment::default() }
}

pub fn by_name(cameras: Vec<NamedCamera>) -> HashMap<String, Camera> {
    cameras.into_iter().map(|NamedCamera { name, camera }| (name, camera)).collect()
}

/// The view at the pose that `cameras` has for it, if any; with `lens_opt`, also with its optimised lens.
pub fn at_its_place(view: View, cameras: &HashMap<String, Camera>, lens_opt: bool) -> View {
    match cameras.get(&view.name) {
        None => view,
        Some(at) => {
            let Camera { width, height, .. } = view.original_camera;
            let camera = match lens_opt {
                true => with_changed_lens(&view.camera, &view.original_camera, &at.scaled_to(width, height)),
                false => view.camera,
            };
            let (camera_from_world, translation) = (at.camera_from_world, at.translation);
            View { camera: Camera { camera_from_world, translation, ..camera }, ..view }
        }
    }
}

/// Changes a camera's lens from `before` to `after`, which are the same camera at another size.
pub fn with_changed_lens(camera: &Camera, before: &Camera, after: &Camera) -> Camera {
    let lens = |camera: &Camera| {
        ([camera.fx, camera.fy, camera.cx, camera.cy], camera.coefficients, camera.projection)
    };
    if lens(before) == lens(after) {
        return *camera;
    }
    let [x, y] = [camera.fx / before.fx, camera.fy / before.fy];
    Camera {
        fx: x * after.fx,
        fy: y * after.fy,
        cx: camera.cx + x * (after.cx - before.cx),
        cy: camera.cy + y * (after.cy - before.cy),
        projection: after.projection,
        coefficients: after.coefficients,
        ..*camera
    }
}

/// How views are compared. By default, whole views without exposure and lens effects.
#[derive(Default)]
pub struct Protocol {
    /// Exposures of the training photos, and lens effects of all photos.
    pub appearances: Appearances,
    /// Names of the views whose left half was trained on: only the right half counts.
    pub halves: HashSet<String>,
}

impl Protocol {
    /// Prepares a view and its frame for comparison.
    pub fn prepared<'a>(&self, view: &'a View, mut frame: Frame) -> Result<(Cow<'a, View>, Frame)> {
        self.appearances.of(&view.name).apply(&view.camera, &mut frame);
        if !self.halves.contains(&view.name) {
            return Ok((Cow::Borrowed(view), frame));
        }
        let mut half = view.clone();
        let (width, height) = (view.photo.width, view.photo.height);
        let photo = view.photo.photo()?;
        let rgb = right(photo.rgb.as_chunks::<3>().0, width).as_flattened().to_vec();
        let mask = view.photo.mask()?.map(|mask| right(&mask, width));
        let kept = width - width / 2;
        half.photo = StoredPhoto::new(Photo { width: kept, height, rgb }, mask);
        half.camera.width = kept;
        half.camera.cx -= (width / 2) as f32;
        frame.color = right(&frame.color, width);
        frame.transmittance = right(&frame.transmittance, width);
        frame.inverse_depth = frame.inverse_depth.map(|depth| right(&depth, width));
        frame.width = kept;
        Ok((Cow::Owned(half), frame))
    }
}

/// The right half of rows of `width` values.
fn right<T: Copy>(values: &[T], width: u32) -> Vec<T> {
    let width = width.max(1) as usize;
    values.chunks(width).flat_map(|row| &row[width / 2..]).copied().collect()
}

/// Reads weight files, before any other work.
pub fn read_weights(files: &[PathBuf], host: &HostArguments) -> Result<Vec<Weights>> {
    let mut all: Vec<Weights> = Vec::new();
    for path in files {
        let weights = lpips_weights::read(path, &host.memory())?;
        if all.iter().any(|other| other.network == weights.network) {
            let problem = format!("has the weights of {} once more", weights.network.name());
            return Err(Error::input(path, problem, "give one file for each network"));
        }
        all.push(weights);
    }
    Ok(all)
}

/// Refuses photos that are too small for a network. With `halves`, only the right half of held-out photos counts.
pub fn check_sizes(weights: &[Weights], gallery: &Gallery, chosen: &[usize], halves: bool) -> Result<()> {
    for (network, &index) in weights.iter().flat_map(|of| chosen.iter().map(|index| (of.network, index))) {
        let Some((width, height)) = gallery.size(index) else { continue };
        let width = if halves && gallery.held_out()[index] { width - width / 2 } else { width };
        if let Err(Error::Argument { problem, .. }) = network.check_size(width, height) {
            let name = gallery.cameras().swap_remove(index).name;
            let half = if halves { " (of held-out photos the right half counts)" } else { "" };
            let is_part = gallery.share_used(index).is_some_and(|share| share < 1.0);
            let (part, whole) = match is_part {
                true => ("the part that shows the block of ", "--photo-parts off, "),
                false => ("", ""),
            };
            return Err(Error::argument(
                "--lpips-weights",
                format!("{part}photo {name} {problem}{half}; give {whole}larger photos (-r), or no LPIPS"),
            ));
        }
    }
    Ok(())
}

pub struct LpipsNetworks {
    networks: Vec<Lpips>,
}

impl LpipsNetworks {
    /// Returns `None` without weights.
    pub fn new(context: &Context, weights: &[Weights]) -> Result<Option<LpipsNetworks>> {
        let networks =
            weights.iter().map(|weights| Lpips::new(context, weights)).collect::<Result<Vec<_>>>()?;
        Ok((!networks.is_empty()).then_some(LpipsNetworks { networks }))
    }

    pub fn names(&self) -> Vec<&'static str> {
        self.networks.iter().map(|lpips| lpips.network().measure()).collect()
    }

    /// One value for each name. Masked pixels are black in both pictures.
    pub fn measure(&mut self, view: &View, frame: &Frame) -> Result<Vec<f64>> {
        let mut photo = view.photo.photo()?.to_f32();
        let mut color = std::borrow::Cow::Borrowed(&frame.color);
        if let Some(mask) = view.photo.mask()? {
            let hide = |picture: &mut Vec<[f32; 3]>| {
                picture
                    .iter_mut()
                    .zip(mask.iter())
                    .filter(|(_, counts)| **counts == 0)
                    .for_each(|(p, _)| *p = [0.0; 3]);
            };
            hide(&mut photo);
            hide(color.to_mut());
        }
        let size = (frame.width, frame.height);
        self.networks.iter_mut().map(|lpips| lpips.distance([&color, &photo], size)).collect()
    }
}
