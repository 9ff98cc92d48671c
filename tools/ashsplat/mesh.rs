//! `ashsplat mesh`.

use crate::render::views::{self, Views};
use ashsplat::scene::{Camera, PhotoLens, WorldFrame};
use ashsplat::surface::{DistanceField, FieldBlocks, FieldSettings, PinholeView, Pinholes};
use ashsplat::{Error, RenderSettings, Renderer, Result, Surface, SurfaceDepth};
use ashsplat_files::Gallery;
use ashsplat_files::cameras_json::NamedCamera;
use ashsplat_files::mesh::MeshFormat;
use ashsplat_program::args::DeviceArguments;
use ashsplat_program::look::{LookArguments, NOTHING_SHOWN};
use ashsplat_program::model::{Model, ModelArguments};
use ashsplat_program::progress::{counting, significant, thousands};
use ashsplat_program::{output, session};
use clap::Args;
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

/// Make a mesh of a trained scene, with coloured vertices, by fusing the depths of the training's views into a distance
/// field.
///
/// Coordinates are the data set's. The mesh is at most as fine as the views' pixels. Surfaces are missing that fewer than a
/// fifth of the views show (three of few views, six of thirty and more).
///
/// If the model has a cameras.json, -s DATASET supplies only the photographs' masks, and the views stay the model's.
#[derive(Args)]
pub struct Arguments {
    #[command(flatten)]
    model: ModelArguments,
    /// The mesh: FILE.ply, FILE.obj or FILE.glb
    #[arg(short, long, value_name = "FILE")]
    out: PathBuf,
    /// Distance between the field's voxels, in the data set's units [default: two pixels at the median depth]
    #[arg(long, value_name = "SIZE", value_parser = positive)]
    voxel: Option<f32>,
    /// Depth beyond which nothing is meshed, in the data set's units [default: twice the median depth]
    #[arg(long, value_name = "DEPTH", value_parser = positive)]
    max_depth: Option<f32>,
    /// Collapse edges, those first that change the surface least, until at most N triangles are left
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    triangles: Option<u32>,
    #[command(flatten)]
    views: views::Arguments,
    #[command(flatten)]
    look: LookArguments,
    #[command(flatten)]
    device: DeviceArguments,
    /// Print only errors
    #[arg(long)]
    quiet: bool,
}

/// Least number of views that must show a voxel, from few and from many: surfaces that fewer views show are mostly floaters.
const MIN_VIEWS: [u32; 2] = [3, 6];
/// A connected part is left out if its triangles are fewer than those of the mesh divided by this.
const SMALLEST_PART: usize = 1000;

fn positive(text: &str) -> Result<f32, String> {
    let number = text.parse().ok().filter(|number: &f32| *number > 0.0 && number.is_finite());
    number.ok_or_else(|| "expected a positive number".into())
}

pub fn run(arguments: &Arguments) -> Result<()> {
    let format = MeshFormat::of(&arguments.out)?;
    output::check(&[("--out", Some(&arguments.out))])?;
    arguments.views.check()?;
    let model = arguments.model.locate()?;
    output::check_apart(&[("--out", Some(&arguments.out))], std::slice::from_ref(&model.ply))?;
    let scene = arguments.look.load(&model.ply, &arguments.device.host)?;
    let stop = session::stop_on_ctrl_c()?;
    let gallery = dataset(arguments, &model, &scene.frame, &stop)?;
    let views = arguments.views.choose(&model, &scene, gallery.as_ref(), None)?;
    let mut photographed = Photographed::new(&views, gallery.as_ref())?;
    let count = photographed.views.len();
    if count == 0 {
        let remedy = "give other views: --path FILE or --orbit N";
        return Err(Error::input(&model.ply, "has only views with parallel rays", remedy));
    }
    if count < views.cameras.len() {
        errln!("warning: {} views with parallel rays are left out", views.cameras.len() - count);
    }
    if let Some(name) = photographed.unknown.first() {
        let unknown = photographed.unknown.len();
        errln!(
            "warning: the data set with masks has no photograph for {unknown} of {count} views, such as '{name}', which no mask hides \
             then; name that of the training with -s"
        );
    }
    let [few, many] = MIN_VIEWS;
    let least_views = (count as u32 / 5).clamp(few, many);
    if count < few as usize {
        let problem = format!("{count} views are too few, a mesh takes {few}");
        return Err(Error::input(&model.ply, problem, "give more: --path FILE or --orbit N"));
    }
    if !arguments.quiet {
        views.note.into_iter().chain(photographed.notes()).for_each(|note| outln!("{note}"));
    }
    let look = arguments.look.settings(&model.settings, &scene.header)?;
    let settings = RenderSettings { surface: Some(SurfaceDepth::Front), ..look };
    let context = arguments.device.context()?;
    let mut renderer = Renderer::new(&context)?;
    renderer.upload_stored(&scene.gaussians, arguments.look.stored(&scene.gaussians))?;
    let bar = counting("views", 3 * count as u64, arguments.quiet);
    type Work<'a> = dyn FnMut(&mut Renderer, &PinholeView, &RenderSettings) -> Result<()> + 'a;
    let mut each = |masked: bool, work: &mut Work| {
        (0..count).try_for_each(|index| {
            session::check(&stop)?;
            bar.inc(1);
            // Fisheyes and panoramas have trained the scene in this order.
            let by_distance = photographed.views[index].camera.projection.orders_by_distance();
            let distance_order = settings.distance_order || by_distance;
            let settings = RenderSettings { distance_order, ..settings };
            let views = photographed.pinholes(index, masked)?;
            views.iter().try_for_each(|view| work(&mut renderer, view, &settings))
        })
    };
    let mut seen = Vec::new();
    each(false, &mut |renderer, PinholeView { camera, counts }, settings| {
        // The medians of all views need no sharp pictures.
        let small = camera.scaled_to(camera.width.div_ceil(4), camera.height.div_ceil(4));
        let depths = surface_of(renderer, &small, settings)?.depth;
        let is_used = |pixel: usize| {
            let [width, small_width] = [camera.width, small.width].map(|width| width as usize);
            let (x, y) = (pixel % small_width, pixel / small_width);
            let (x, y) = (x * width / small_width, y * camera.height as usize / small.height as usize);
            counts.as_ref().is_none_or(|counts| counts[y * width + x])
        };
        let depths = depths.into_iter().enumerate().filter(|&(pixel, depth)| depth > 0.0 && is_used(pixel));
        seen.extend(depths.map(|(_, depth)| [depth, depth / camera.fx]));
        Ok(())
    })?;
    if seen.is_empty() {
        return Err(Error::input(&model.ply, "shows no surface in any view", NOTHING_SHOWN));
    }
    let unit = scene.frame.unit as f32;
    let [depth, pixel] = [0, 1].map(|value| {
        let middle = seen.len() / 2;
        seen.select_nth_unstable_by(middle, |a, b| a[value].total_cmp(&b[value])).1[value]
    });
    let voxel = arguments.voxel.map_or(2.0 * pixel, |voxel| voxel / unit);
    let max_depth = arguments.max_depth.map_or(2.0 * depth, |depth| depth / unit);
    let named = |error| match error {
        Error::TooLarge { limit, limit_name, unit: "bytes", .. } => {
            let [voxel, larger] = [voxel, 2.0 * voxel].map(|voxel| significant(voxel * unit));
            let problem = format!("{voxel} makes more than {limit} bytes ({limit_name})");
            Error::argument("--voxel", format!("{problem}; try {larger}"))
        }
        Error::Argument { what, problem } if what == "voxel" => Error::argument("--voxel", problem),
        other => other,
    };
    let field = FieldSettings { least_views, ..FieldSettings::new(voxel, max_depth) };
    let mut blocks = FieldBlocks::new(&context, field)?;
    each(true, &mut |renderer, view, settings| {
        blocks.add(view, &surface_of(renderer, &view.camera, settings)?)
    })
    .map_err(named)?;
    if blocks.is_empty() {
        return Err(Error::argument("--max-depth", "every surface lies beyond it, or masks hide it"));
    }
    let field = DistanceField::new(&context, &blocks).map_err(named)?;
    each(true, &mut |renderer, view, settings| field.integrate(renderer, view, settings))?;
    let mut mesh = field.mesh().map_err(named)?;
    bar.finish_and_clear();
    let removed = mesh.keep_parts(mesh.triangles.len() / SMALLEST_PART);
    if mesh.triangles.is_empty() {
        let problem = format!("{least_views} views see no surface together that is larger than a voxel");
        return Err(Error::input(&model.ply, problem, "give other views, or a smaller --voxel"));
    }
    session::check(&stop)?;
    if let Some(count) = arguments.triangles {
        mesh.simplify(count as usize, &mut || session::check(&stop))?;
        let left = mesh.triangles.len();
        if left > count as usize {
            errln!(
                "warning: --triangles: {} triangles remain; no further edge can be collapsed without folding the surface or \
                 changing its topology",
                thousands(left as u64)
            );
        }
    }
    output::in_folder(&arguments.out, |path| format.write(path, &mesh, &scene.frame))?;
    if !arguments.quiet {
        let [vertices, triangles] =
            [mesh.positions.len(), mesh.triangles.len()].map(|count| thousands(count as u64));
        let (out, size) = (arguments.out.display(), significant(voxel * unit));
        outln!(
            "{out}: {triangles} triangles, {vertices} vertices, voxels of {size}, {removed} small parts removed"
        );
    }
    arguments.device.report_validation(&context);
    Ok(())
}

fn surface_of(renderer: &mut Renderer, camera: &Camera, settings: &RenderSettings) -> Result<Surface> {
    Ok(renderer.render(camera, settings)?.surface.unwrap_or_default())
}

/// Opens the data set of the views' photographs, if there is one. That of the training may be gone.
fn dataset(
    arguments: &Arguments,
    model: &Model,
    frame: &WorldFrame,
    stop: &AtomicBool,
) -> Result<Option<Gallery>> {
    let (trained, views) = (&model.settings.data, &arguments.views);
    let open = |dataset: &Path| session::gallery(dataset, trained, frame, stop);
    if let Some(dataset) = &views.source_path {
        return open(dataset).map(Some);
    }
    if !views.are_of_training() || trained.source_path.as_os_str().is_empty() {
        return Ok(None);
    }
    match open(&trained.source_path) {
        Err(error) if !trained.source_path.exists() => {
            errln!("warning: {error}; no mask is applied: name the data set with -s");
            Ok(None)
        }
        opened => opened.map(Some),
    }
}

/// A photograph that may have a mask.
struct MaskedPhotograph {
    /// Index in the data set.
    index: usize,
    /// Lens of the view, at the photograph's size.
    lens: PhotoLens,
}

struct PhotographedView {
    camera: Camera,
    masked: Option<MaskedPhotograph>,
}

/// Views with their photographs' masks.
struct Photographed<'a> {
    gallery: Option<&'a Gallery>,
    views: Vec<PhotographedView>,
    /// Names of views that a data set with masks has no photograph of.
    unknown: Vec<String>,
    /// Pinholes of the view that was drawn last. The next one mostly has the same lens.
    last: Option<Pinholes>,
}

impl<'a> Photographed<'a> {
    /// Finds the photographs by name. Leaves views with parallel rays out.
    fn new(views: &Views, gallery: Option<&'a Gallery>) -> Result<Self> {
        let known = gallery.map_or(Vec::new(), Gallery::cameras);
        let known: HashMap<&str, usize> =
            known.iter().enumerate().map(|(index, named)| (named.name.as_str(), index)).collect();
        let given = gallery.map_or(Ok(Vec::new()), Gallery::used_cameras)?;
        let photographed = |(index, NamedCamera { name, camera }): (usize, &NamedCamera)| {
            let may_be_masked =
                |photograph: &usize| gallery.is_some_and(|all| all.may_be_masked(*photograph));
            let masked = known.get(name.as_str()).copied().filter(may_be_masked).map(|photograph| {
                let given = given[photograph].photo_lens();
                let own = views.lenses[index].scaled_to(given.width, given.height);
                // Pinholes may have been trained on undistorted copies of the photographs.
                let is_undistorted = given.projection.is_lens() && !own.projection.is_lens();
                MaskedPhotograph { index: photograph, lens: if is_undistorted { given } else { own } }
            });
            PhotographedView { camera: *camera, masked }
        };
        let cameras =
            || views.cameras.iter().enumerate().filter(|(_, named)| !named.camera.is_orthographic());
        let has_masks =
            gallery.is_some_and(|all| (0..known.len()).any(|photograph| all.may_be_masked(photograph)));
        let unknown = cameras().filter(|(_, named)| has_masks && !known.contains_key(named.name.as_str()));
        let unknown = unknown.map(|(_, named)| named.name.clone()).collect();
        Ok(Self { gallery, views: cameras().map(photographed).collect(), unknown, last: None })
    }

    fn notes(&self) -> Vec<String> {
        let count = |counts: &dyn Fn(&PhotographedView) -> bool| {
            self.views.iter().filter(|view| counts(view)).count()
        };
        let (masked, rolling) =
            (count(&|view| view.masked.is_some()), count(&|view| view.camera.shutter.is_some()));
        let masks = format!("masks of {masked} photographs are applied");
        let poses = format!("{rolling} views with a rolling shutter are drawn from their pose halfway");
        [(masked, masks), (rolling, poses)]
            .into_iter()
            .filter_map(|(count, note)| (count > 0).then_some(note))
            .collect()
    }

    /// The pinholes of a view, and the pixels that its mask lets count.
    fn pinholes(&mut self, index: usize, masked: bool) -> Result<Vec<PinholeView>> {
        let PhotographedView { camera, masked: photograph } = &self.views[index];
        let lenses = (camera.photo_lens(), photograph.as_ref().map(|photograph| photograph.lens));
        let known = self.last.take().filter(|pinholes| pinholes.are_of(&lenses.0, lenses.1.as_ref()));
        let pinholes = known.unwrap_or_else(|| Pinholes::new(&lenses.0, lenses.1.as_ref()));
        let pinholes = self.last.insert(pinholes);
        let photograph = self.gallery.zip(photograph.as_ref().filter(|_| masked));
        let photograph =
            photograph.and_then(|(gallery, photograph)| gallery.view(photograph.index)).transpose()?;
        let mask = photograph.map(|view| view.photo.mask()).transpose()?.flatten();
        Ok(pinholes.views(camera, mask.as_deref()))
    }
}
