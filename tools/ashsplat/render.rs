//! `ashsplat render`, and the options that choose how pictures are drawn.

use ashsplat::scene::LensEffects;
use ashsplat::{Error, Frame, Renderer, Result, SurfaceDepth};
use ashsplat_files::exposure_json::{self, EXPOSURE_FILE};
use ashsplat_files::lens_json::{LENS_FILE, LensFile};
use ashsplat_files::splats::Target;
use ashsplat_files::tiles::Tree;
use ashsplat_program::appearance::Appearance;
use ashsplat_program::args::DeviceArguments;
use ashsplat_program::film_file::{self, Container, Frames};
use ashsplat_program::look::{
    BudgetedTree, LookArguments, NOTHING_SHOWN, gaussians_of, parse_target, reported, tree_of,
};
use ashsplat_program::model::{Model, ModelArguments, folder_of_tiles};
use ashsplat_program::output::{self, Depth};
use ashsplat_program::progress::counting;
use clap::{Args, ValueEnum};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::time::Instant;

pub mod views;

/// Render a trained scene: by default the views of its training, else a data set's, an orbit or a camera path; as pictures
/// or as a film.
///
/// An orbit stays in what the cameras of the training saw: a circle where they surround the scene, an arc where they look
/// at it from one side, else a path along them (--motion).
///
/// EXR files hold linear light (R G B: the sRGB curve of the photographs undone, on the background), A = 1 - transmittance,
/// and Z = depth along the view axis in the scene's units, infinite where nothing was blended (--depth). For compositing,
/// use --transparent: R G B are then premultiplied by A.
///
/// A camera path is a JSON list in the format of a model folder's cameras.json: [{"id", "img_name", "width",
/// "height", "position": [x, y, z], "rotation": 3 rows of the rotation from camera (x right, y down, z forward) to
/// world, "fx", "fy", and optionally "cx", "cy"}, ...], lengths in pixels, the first pixel's centre at 0.5.
#[derive(Args)]
#[command(mut_arg("model", |argument| argument.help(MODEL)))]
pub struct Arguments {
    #[command(flatten)]
    model: ModelArguments,
    /// Most Gaussians in a picture of a folder of tiles; the tiles whose error is largest in pixels are refined first
    /// [default: all]
    #[arg(long, value_name = "N|N%", value_parser = parse_target)]
    budget: Option<Target>,
    #[command(flatten)]
    views: views::Arguments,
    /// Folder for the pictures; or the file of one: FILE.png or FILE.exr; or a film: FILE.mp4, FILE.webm (both by ffmpeg) or
    /// FILE.gif
    #[arg(short, long, value_name = "DIR|FILE", default_value = "out/render")]
    out: PathBuf,
    /// Frames per second of a film [default: 30]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=120))]
    fps: Option<u32>,
    /// Render under the exposure that the model folder's exposure.json has for this photo
    #[arg(long, value_name = "PHOTO")]
    exposure_of: Option<String>,
    /// Render with the vignetting and response that the model folder's lens.json has for the camera of this photo
    #[arg(long, value_name = "PHOTO")]
    lens_of: Option<String>,
    /// Which files to write; by default what --out names, and PNG into a folder
    #[arg(long, value_enum)]
    format: Option<Format>,
    /// Z of an EXR [default: mean]
    #[arg(long, value_enum)]
    depth: Option<Depth>,
    /// Also write normals, in the scene's axes: channels N.X, N.Y and N.Z of an EXR; without one, the PNG shows (1 + n) / 2 in place
    /// of colours
    #[arg(long, conflicts_with_all = ["transparent", "exposure_of", "lens_of"])]
    normals: bool,
    /// Draw no background: an EXR's colours are premultiplied by its alpha, and a PNG has opacity
    #[arg(long, conflicts_with_all = ["background", "exposure_of", "lens_of"])]
    transparent: bool,
    #[command(flatten)]
    look: LookArguments,
    #[command(flatten)]
    device: DeviceArguments,
    /// Print only errors
    #[arg(long)]
    quiet: bool,
}

const MODEL: &str = "A model folder, a file of Gaussians (PLY, compressed PLY, .splat, SPZ, glTF, SOG), or a folder of `ashsplat tiles`";

/// File formats of pictures.
#[derive(Clone, Copy, PartialEq, ValueEnum)]
enum Format {
    /// 8 bits per channel
    Png,
    /// 32-bit float: linear colour, alpha and depth
    Exr,
    /// PNG and EXR
    Both,
}

const FILM_RATE: u32 = 30;

pub fn run(arguments: &Arguments) -> Result<()> {
    let path = folder_of_tiles(&arguments.model.model);
    arguments.views.check()?;
    let film = arguments.film()?;
    let picture = arguments.picture()?;
    let format = picture.or(arguments.format).unwrap_or(Format::Png);
    let tree = tree_of(path, arguments.budget.is_some())?;
    let model = Model::locate(&scene_of(path, tree.as_ref()), arguments.model.iteration)?;
    let appearance = arguments.appearance(&model)?;
    let host = &arguments.device.host;
    let scene = match &tree {
        Some(tree) => {
            let coarsest = tree.read(0, &host.reading(arguments.look.drop_invalid))?;
            reported(&model.ply, coarsest)
        }
        None => arguments.look.load(&model.ply, host)?,
    };
    let views = arguments.views.choose(&model, &scene, None, film)?;
    if tree.is_some() && views.cameras.iter().any(|named| named.camera.has_lens()) {
        let remedy = "render the scene that the tiles were made of, or through a pinhole";
        return Err(Error::input(path, "is a folder of tiles, which lenses do not choose from", remedy));
    }
    if let (Some(_), several @ 2..) = (picture, views.cameras.len()) {
        let problem = format!("is one picture, and there are {several} views");
        return Err(Error::input(&arguments.out, problem, "name a folder, or a film (.mp4, .webm, .gif)"));
    }
    let mut settings = arguments.look.settings(&model.settings, &scene.header)?;
    settings.surface = arguments.normals.then_some(SurfaceDepth::Median);
    if format != Format::Png {
        settings = arguments.depth().requested(settings);
    } else if arguments.depth.is_some() {
        return Err(Error::argument("--depth", "is for EXR files: add --format exr"));
    }
    if arguments.transparent {
        settings.background = [0.0; 3];
    }
    let context = arguments.device.context()?;
    let mut renderer = Renderer::new(&context)?;
    renderer.upload_stored(&scene.gaussians, arguments.look.stored(&scene.gaussians))?;
    if let (Some(note), false) = (&views.note, arguments.quiet) {
        outln!("{note}");
    }
    let count = views.cameras.len();
    // A bar suffices for a film, whose frames are not separate results.
    let bar = counting("frames", if film.is_some() { count as u64 } else { 0 }, arguments.quiet);
    let (mut total, mut shows_any) = (0.0, false);
    let mut tiles = tree.map(|tree| arguments.drawn(tree));
    let mut render = |index: usize| {
        let start = Instant::now();
        let named = &views.cameras[index];
        if let Some(tiles) =
            tiles.as_mut().map(|tiles| tiles.changed_gaussians(&named.camera)).transpose()?.flatten()
        {
            renderer.upload_stored(&tiles, arguments.look.stored(&tiles))?;
        }
        let mut frame = renderer.render(&named.camera, &settings)?;
        appearance.apply(&named.camera, &mut frame);
        if format == Format::Png && arguments.normals {
            output::show_normals(&mut frame);
        }
        arguments.depth().scale(&mut frame, scene.frame.unit as f32);
        let milliseconds = start.elapsed().as_secs_f64() * 1e3;
        total += milliseconds;
        shows_any |= frame.stats.visible > 0;
        bar.inc(1);
        if !arguments.quiet && film.is_none() {
            outln!("{}", describe(index, &named.name, milliseconds, &frame));
        }
        Ok(frame)
    };
    match film {
        None => {
            match picture {
                Some(_) => output::remove_leftovers_of(&arguments.out),
                None => output::remove_leftovers(&arguments.out, 0),
            }
            (0..count).try_for_each(|index| {
                let place = |extension: &str| match picture {
                    Some(_) => arguments.out.clone(),
                    None => output::numbered(&arguments.out, index, extension),
                };
                arguments.save(&place, format, &render(index)?)
            })?;
        }
        Some(container) => {
            output::remove_leftovers_of(&arguments.out);
            let mut frame = |index| output::to_photo(&render(index)?);
            let never = AtomicBool::new(false);
            let frames = Frames {
                count,
                per_second: arguments.fps.unwrap_or(FILM_RATE),
                frame: &mut frame,
                abandoned: &never,
            };
            film_file::write(&arguments.out, container, frames)?;
        }
    }
    bar.finish_and_clear();
    if !shows_any {
        errln!("warning: {NOTHING_SHOWN}");
    }
    if !arguments.quiet {
        let mean = total / count as f64;
        let size = std::fs::metadata(&arguments.out).ok().filter(|_| film.is_some());
        let size = size
            .map_or_else(String::new, |file| format!(" ({:.1} MiB)", file.len() as f64 / f64::from(1 << 20)));
        let (out, device) = (arguments.out.display(), context.device_name());
        let frames = if count == 1 { "1 frame".to_owned() } else { format!("{count} frames") };
        outln!("{frames} in {out}{size}, {mean:.1} ms each on {device}");
    }
    arguments.device.report_validation(&context);
    Ok(())
}

/// The learned value for the photo that an option names. `read` reads the values of all photos from a file of the model
/// folder.
fn learned_of<T: Copy>(
    model: &Model,
    (option, name): (&str, &str),
    (file, learn): (&str, &str),
    read: impl Fn(&Path) -> Result<BTreeMap<String, T>>,
) -> Result<T> {
    let Some((folder, _)) = &model.folder else {
        let problem = format!("needs a model folder with {file}; this is a file of Gaussians");
        return Err(Error::argument(option, problem));
    };
    let file = folder.join(file);
    if !file.is_file() {
        let remedy = format!("train with {learn}, or render without {option}");
        return Err(Error::input(&file, "does not exist: nothing of the kind was learned", &remedy));
    }
    let all = read(&file)?;
    all.get(name).copied().ok_or_else(|| {
        let known = all.keys().next().map_or_else(String::new, |first| format!(", {first} for example"));
        let remedy = format!("name one of its {} photos{known}", all.len());
        Error::input(&file, format!("has no photo '{name}'"), remedy)
    })
}

fn lenses_by_photo(file: &Path) -> Result<BTreeMap<String, LensEffects>> {
    let lenses = LensFile::read(file)?;
    Ok(lenses.photos.keys().filter_map(|name| Some((name.clone(), lenses.of(name)?))).collect())
}

fn describe(index: usize, name: &str, milliseconds: f64, frame: &Frame) -> String {
    let stats = &frame.stats;
    format!(
        "{index:05} {name} {}x{}: {milliseconds:.1} ms, {} of {} Gaussians visible, {} instances, longest tile {}",
        frame.width, frame.height, stats.visible, stats.gaussians, stats.instances, stats.longest_tile
    )
}

/// The file to read first: the scene, or the coarsest tile of a tree.
fn scene_of(path: &Path, tree: Option<&Tree>) -> PathBuf {
    tree.and_then(|tree| tree.tiles().first()).map_or_else(|| path.to_owned(), |tile| path.join(&tile.name))
}

impl Arguments {
    fn drawn(&self, tree: Tree) -> BudgetedTree {
        let budget = self.budget.map_or(usize::MAX, |budget| gaussians_of(budget, &tree));
        BudgetedTree::new(tree, budget, self.device.host.reading(self.look.drop_invalid))
    }

    fn appearance(&self, model: &Model) -> Result<Appearance> {
        let exposure = |name: &String| {
            let read = |file: &Path| exposure_json::read(file);
            learned_of(model, ("--exposure-of", name), (EXPOSURE_FILE, "--exposure"), read)
        };
        let lens = |name: &String| {
            learned_of(model, ("--lens-of", name), (LENS_FILE, "--lens-effects"), lenses_by_photo)
        };
        Ok(Appearance {
            exposure: self.exposure_of.as_ref().map(exposure).transpose()?,
            lens: self.lens_of.as_ref().map(lens).transpose()?,
        })
    }

    /// The container of the requested film, if any. Refuses a film that cannot be made.
    fn film(&self) -> Result<Option<Container>> {
        let Some(container) = Container::of(&self.out)? else {
            let unused = "is for films; end --out in .mp4, .webm or .gif";
            return self.fps.map_or(Ok(None), |_| Err(Error::argument("--fps", unused)));
        };
        if self.format.is_some_and(|format| format != Format::Png) {
            return Err(Error::argument(
                "--format",
                "films have 8 bits per channel; name a folder for EXR files",
            ));
        }
        if self.transparent {
            return Err(Error::argument(
                "--transparent",
                "films have no opacity; name a folder for pictures",
            ));
        }
        output::check(&[("--out", Some(&self.out))])?;
        container.check(&self.out)?;
        Ok(Some(container))
    }

    /// The format of the single picture that --out names, if it does not name a folder.
    fn picture(&self) -> Result<Option<Format>> {
        let ending = self.out.extension().and_then(|ending| ending.to_str()).unwrap_or_default();
        // A folder may have any name.
        let ending = if self.out.is_dir() { String::new() } else { ending.to_ascii_lowercase() };
        let format = match (ending.as_str(), self.format) {
            ("png", None | Some(Format::Png)) => Format::Png,
            ("exr", None | Some(Format::Exr)) => Format::Exr,
            ("png" | "exr", _) => {
                let problem = "asks for other files than --out names; name a folder";
                return Err(Error::argument("--format", problem));
            }
            ("jpg" | "jpeg" | "webp" | "tif" | "tiff" | "bmp", _) => {
                let problem = "is a kind of picture that is not written";
                return Err(Error::input(&self.out, problem, "end it in .png or .exr"));
            }
            _ => return Ok(None),
        };
        output::check(&[("--out", Some(&self.out))])?;
        Ok(Some(format))
    }

    fn depth(&self) -> Depth {
        self.depth.unwrap_or(Depth::Mean)
    }

    fn save(&self, path: &dyn Fn(&str) -> PathBuf, format: Format, frame: &Frame) -> Result<()> {
        match (format, self.transparent) {
            (Format::Exr, _) => {}
            (_, true) => output::write_rgba_png(&path("png"), &output::to_rgba(frame))?,
            (_, false) => output::write_png(&path("png"), &output::to_photo(frame)?)?,
        }
        if format != Format::Png {
            output::write_exr(&path("exr"), frame, self.transparent, self.depth(), self.normals)?;
        }
        Ok(())
    }
}
