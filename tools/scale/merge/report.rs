//! Report of a merged scene's quality, inside blocks and along their seams.

use super::seams::{SceneErrors, Seams};
use super::{Arguments, results_beside};
use ashsplat::vk::Context;
use ashsplat::{Error, RenderSettings, Renderer, Result};
use ashsplat_files::{Gallery, splats};
use ashsplat_program::blocks::BlocksFile;
use ashsplat_program::config::{DataSettings, Settings, Split};
use ashsplat_program::html::{self, Cell, escape, section};
use ashsplat_program::look::render_settings_of;
use ashsplat_program::model::Model;
use ashsplat_program::progress::{counting, significant, thousands};
use ashsplat_program::{output, session};
use serde::Serialize;
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Factor by which pixels away from the seam are darkened on the page.
const ASIDE: u8 = 3;

/// Everything that the measurement needs except the scene.
pub struct ReportSetup {
    page: PathBuf,
    gallery: Gallery,
    context: Context,
    settings: Settings,
    stop: Arc<AtomicBool>,
}

struct MeasuredScene {
    renderer: Renderer,
    look: RenderSettings,
    gaussians: u64,
}

/// Quality in numbers, dB.
#[derive(Serialize)]
struct Quality {
    gaussians: u64,
    /// Mean over the views, as in `eval`.
    mean_psnr: f64,
    /// Over all pixels of all views together.
    psnr: Option<f64>,
    inside_psnr: Option<f64>,
    seam_psnr: Option<f64>,
}

#[derive(Serialize)]
struct SeamQuality {
    blocks: [usize; 2],
    axis: &'static str,
    pixels: u64,
    psnr: Option<f64>,
    against_psnr: Option<f64>,
}

#[derive(Serialize)]
struct Results {
    views: usize,
    /// Largest distance from a seam that counts as along it, source units.
    band: f32,
    /// Share of the pixels in the band.
    band_share: f64,
    merged: Quality,
    against: Option<Quality>,
    /// Seams, the worst first.
    seams: Vec<SeamQuality>,
    /// The view in which the worst seam has the largest error.
    worst_view: Option<String>,
}

impl ReportSetup {
    pub fn new(page: &Path, arguments: &Arguments, file: &BlocksFile) -> Result<ReportSetup> {
        let (division, host) = (&file.division, &arguments.device.host);
        if !division.dataset.eval {
            let problem = "needs held-out photos, and the blocks have none: partition with --eval";
            return Err(Error::argument("--report", problem));
        }
        let settings = match division.blocks.first() {
            Some(block) => Settings::of_model(&file.at(&block.folder))?,
            None => Settings::reference(),
        };
        if let Some(path) = &arguments.against {
            Model::locate(path, None)?;
        }
        let dataset = &division.dataset;
        let data = DataSettings {
            source_path: file.at(&dataset.path),
            images: dataset.images.clone(),
            resolution: dataset.resolution,
            orientation: dataset.orientation.clone(),
            undistort: dataset.undistort,
            alpha: dataset.alpha.clone(),
            level: dataset.level.clone(),
            eval: true,
            eval_split: Split::Reference,
            ..DataSettings::default()
        };
        let stop = session::stop_on_ctrl_c()?;
        let mut options = session::options(&data, settings.train.white_background, host)?;
        options.frame = Some(division.frame());
        let gallery = session::open(&data, &options, &stop)?;
        file.check_cameras(&data.source_path, &gallery)?;
        Ok(Self { page: page.to_owned(), gallery, context: arguments.device.context()?, settings, stop })
    }

    fn scene(&self, path: &Path, settings: &Settings, arguments: &Arguments) -> Result<MeasuredScene> {
        let mut scene = splats::read(path, &arguments.device.host.reading(arguments.drop_invalid))?;
        scene.express_in(self.gallery.frame());
        let mut renderer = Renderer::new(&self.context)?;
        renderer.upload(&scene.gaussians)?;
        let look = RenderSettings { inverse_depth: true, ..render_settings_of(settings, &scene.header) };
        Ok(MeasuredScene { renderer, look, gaussians: scene.gaussians.len() as u64 })
    }

    /// Measures the scene, and writes the page and the JSON.
    pub fn measure(self, arguments: &Arguments, file: &BlocksFile) -> Result<()> {
        let cells = file.division.cells()?;
        let seams = Seams::of(&cells, file.division.margin_in_world());
        let mut scenes = vec![self.scene(&arguments.out, &self.settings, arguments)?];
        if let Some(path) = &arguments.against {
            let model = Model::locate(path, None)?;
            scenes.push(self.scene(&model.ply, &model.settings, arguments)?);
        }
        let (measured, shown) = self.errors(&mut scenes, &seams, arguments.quiet)?;
        let merged = &measured[0];
        let order = merged.worst_seams();
        let worst = order.first().and_then(|&seam| Some((seam, shown[seam]?)));
        let quality = |index: usize| Some(Quality::of(measured.get(index)?, scenes[index].gaussians));
        let of_seam = |&seam: &usize| SeamQuality {
            blocks: seams.all[seam].cells.map(|cell| cell + 1),
            axis: ["x", "y", "z"][seams.all[seam].axis],
            pixels: merged.seams[seam].pixels,
            psnr: merged.seams[seam].psnr(),
            against_psnr: measured.get(1).and_then(|against| against.seams[seam].psnr()),
        };
        let results = Results {
            views: merged.views.len(),
            band: file.division.margin,
            band_share: merged.band.pixels as f64 / merged.whole().pixels.max(1) as f64,
            merged: Quality::of(merged, scenes[0].gaussians),
            against: quality(1),
            seams: order.iter().map(of_seam).collect(),
            worst_view: worst.map(|(_, view)| self.gallery.cameras()[view].name.clone()),
        };
        let mut page = results.page(&arguments.out);
        if let Some(worst) = worst {
            self.pictures(&mut page, worst, &seams, &mut scenes)?;
        }
        output::write_json(&results_beside(&self.page), &results)?;
        output::write_text(&self.page, &page)?;
        if !arguments.quiet {
            results.say();
            outln!("report in {}", self.page.display());
        }
        arguments.device.report_validation(&self.context);
        Ok(())
    }

    /// Errors of the scenes on all held-out views, in regions by the depths of the first scene; and for each seam the
    /// view with its largest error.
    fn errors(
        &self,
        scenes: &mut [MeasuredScene],
        seams: &Seams<'_>,
        quiet: bool,
    ) -> Result<(Vec<SceneErrors>, Vec<Option<usize>>)> {
        let mut measured: Vec<SceneErrors> = scenes.iter().map(|_| seams.nothing()).collect();
        let mut shown = vec![(0.0, None); seams.all.len()];
        let held_out = self.gallery.held_out();
        let chosen: Vec<usize> = (0..held_out.len()).filter(|&index| held_out[index]).collect();
        let bar = counting("held-out views", chosen.len() as u64, quiet);
        for index in chosen {
            session::check(&self.stop)?;
            let Some(view) = self.gallery.view(index).transpose()? else { continue };
            let (photo, mask) = (view.photo.photo()?.to_f32(), view.photo.mask()?);
            let counts = |pixel: usize| mask.as_ref().is_none_or(|mask| mask[pixel] != 0);
            let before: Vec<f64> = measured[0].seams.iter().map(|errors| errors.squared).collect();
            let mut regions = Vec::new();
            for (MeasuredScene { renderer, look, .. }, measured) in scenes.iter_mut().zip(&mut measured) {
                let frame = renderer.render(&view.camera, look)?;
                if regions.is_empty() {
                    regions = seams.regions(&view.camera, &frame);
                }
                measured.add(&frame, &photo, &regions, counts);
            }
            for ((worst, now), before) in shown.iter_mut().zip(&measured[0].seams).zip(before) {
                let own = now.squared - before;
                if own > worst.0 {
                    *worst = (own, Some(index));
                }
            }
            bar.inc(1);
        }
        bar.finish_and_clear();
        Ok((measured, shown.into_iter().map(|(_, view)| view).collect()))
    }

    /// Adds photograph and renders of a view, darkened except along a seam.
    fn pictures(
        &self,
        page: &mut String,
        (seam, index): (usize, usize),
        seams: &Seams<'_>,
        scenes: &mut [MeasuredScene],
    ) -> Result<()> {
        let Some(view) = self.gallery.view(index).transpose()? else { return Ok(()) };
        let [first, second] = seams.all[seam].cells.map(|cell| cell + 1);
        let title = format!("The worst seam: blocks {first} and {second}, {}", escape(&view.name));
        section(page, &title, "bright: along the seam");
        let mut pictures = vec![("photograph", Arc::unwrap_or_clone(view.photo.photo()?))];
        let mut regions = Vec::new();
        for (MeasuredScene { renderer, look, .. }, name) in scenes.iter_mut().zip(["merged", "against"]) {
            let frame = renderer.render(&view.camera, look)?;
            if regions.is_empty() {
                regions = seams.regions(&view.camera, &frame);
            }
            pictures.push((name, output::to_photo(&frame)?));
        }
        page.push_str("<div class=\"row\">");
        for (name, mut picture) in pictures {
            for (pixel, region) in picture.rgb.chunks_exact_mut(3).zip(&regions) {
                if *region != Some(seam) {
                    pixel.iter_mut().for_each(|byte| *byte /= ASIDE);
                }
            }
            let (address, width) = (html::jpeg(&picture)?, picture.width.clamp(240, 700));
            let _ = write!(
                page,
                "<figure><img width=\"{width}\" src=\"{address}\" alt=\"{name}\"><figcaption>{name}</figcaption></figure>"
            );
        }
        page.push_str("</div>\n");
        Ok(())
    }
}

impl Quality {
    fn of(measured: &SceneErrors, gaussians: u64) -> Quality {
        Quality {
            gaussians,
            mean_psnr: measured.mean_psnr(),
            psnr: measured.whole().psnr(),
            inside_psnr: measured.inside.psnr(),
            seam_psnr: measured.band.psnr(),
        }
    }
}

/// A number of decibels, or a dash.
fn decibels(psnr: Option<f64>) -> String {
    psnr.map_or_else(|| "–".into(), |psnr| format!("{psnr:.2}"))
}

impl Results {
    fn scenes(&self) -> impl Iterator<Item = (&'static str, &Quality)> {
        std::iter::once(("merged", &self.merged)).chain(self.against.iter().map(|other| ("against", other)))
    }

    fn say(&self) {
        for (name, quality) in self.scenes() {
            let [whole, inside, seam] = [quality.psnr, quality.inside_psnr, quality.seam_psnr].map(decibels);
            outln!(
                "{name}: PSNR {:.2} dB on {} held-out views; of all their pixels {whole}, inside of blocks {inside}, along seams \
                 {seam}",
                quality.mean_psnr,
                self.views
            );
        }
    }

    fn page(&self, scene: &Path) -> String {
        let name = escape(&scene.display().to_string());
        let style = html::STYLE;
        let mut page = format!(
            "<!DOCTYPE html><html lang=\"en\"><meta charset=\"utf-8\"><title>{name}</title><style>{style}</style><h1>{name}</h1>\n"
        );
        let note = format!(
            "PSNR in dB on {} held-out views: the mean over views, then over all their pixels together. Along seams: at most {} \
             from one, {:.1} % of the pixels.",
            self.views,
            significant(self.band),
            100.0 * self.band_share
        );
        section(&mut page, "Quality", &note);
        let quality = |(name, quality): (&str, &Quality)| {
            let own =
                [quality.psnr, quality.inside_psnr, quality.seam_psnr].map(|psnr| Cell::number(psnr, 2));
            let first = [
                Cell::Name(name.to_owned()),
                Cell::Number(thousands(quality.gaussians)),
                Cell::number(quality.mean_psnr, 2),
            ];
            first.into_iter().chain(own).collect()
        };
        let rows: Vec<Vec<Cell>> = self.scenes().map(quality).collect();
        page += &html::table(&["", "Gaussians", "mean", "all pixels", "inside", "along seams"], &rows, None);
        section(&mut page, "Seams", "the worst first");
        let seam = |seam: &SeamQuality| {
            let [first, second] = seam.blocks;
            vec![
                Cell::Name(format!("blocks {first} and {second}")),
                Cell::Number(seam.axis.to_owned()),
                Cell::Number(thousands(seam.pixels)),
                Cell::number(seam.psnr, 2),
                Cell::number(seam.against_psnr, 2),
            ]
        };
        let rows: Vec<Vec<Cell>> = self.seams.iter().map(seam).collect();
        page += &html::table(&["", "across", "pixels", "merged", "against"], &rows, None);
        page
    }
}
