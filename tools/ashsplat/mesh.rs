//! `ashsplat mesh`.

use crate::render::views;
use ashsplat::scene::Camera;
use ashsplat::surface::{DistanceField, FieldBlocks, FieldSettings};
use ashsplat::{Error, RenderSettings, Renderer, Result, Surface, SurfaceDepth};
use ashsplat_files::mesh::MeshFormat;
use ashsplat_program::args::DeviceArguments;
use ashsplat_program::look::{LookArguments, NOTHING_SHOWN};
use ashsplat_program::model::ModelArguments;
use ashsplat_program::progress::{counting, significant, thousands};
use ashsplat_program::{output, session};
use clap::Args;
use std::path::PathBuf;

/// Make a mesh of a trained scene, with coloured vertices, by fusing the depths of the training's views into a distance
/// field.
///
/// Coordinates are the data set's. The mesh is at most as fine as the views' pixels. Surfaces are missing that fewer than a
/// fifth of the views show (three of few views, six of thirty and more).
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
    let views = arguments.views.choose(&model, &scene, None)?;
    let cameras = views.cameras.iter().map(|named| named.camera);
    let (cameras, others): (Vec<Camera>, Vec<Camera>) = cameras.partition(Camera::is_pinhole);
    if cameras.is_empty() {
        let remedy = "give pinholes: --path FILE or --orbit N";
        return Err(Error::input(&model.ply, "has no view through a pinhole", remedy));
    }
    if !others.is_empty() {
        errln!("warning: {} views through lenses or with parallel rays are left out", others.len());
    }
    let [few, many] = MIN_VIEWS;
    let least_views = (cameras.len() as u32 / 5).clamp(few, many);
    if cameras.len() < few as usize {
        let problem = format!("{} views are too few, a mesh takes {few}", cameras.len());
        return Err(Error::input(&model.ply, problem, "give more: --path FILE or --orbit N"));
    }
    if let (Some(note), false) = (&views.note, arguments.quiet) {
        outln!("{note}");
    }
    let look = arguments.look.settings(&model.settings, &scene.header)?;
    let settings = RenderSettings { surface: Some(SurfaceDepth::Front), ..look };
    let context = arguments.device.context()?;
    let mut renderer = Renderer::new(&context)?;
    renderer.upload_stored(&scene.gaussians, arguments.look.stored(&scene.gaussians))?;
    let stop = session::stop_on_ctrl_c()?;
    let bar = counting("views", 3 * cameras.len() as u64, arguments.quiet);
    let mut each = |work: &mut dyn FnMut(&mut Renderer, &Camera) -> Result<()>| {
        cameras.iter().try_for_each(|camera| {
            session::check(&stop)?;
            bar.inc(1);
            work(&mut renderer, camera)
        })
    };
    let mut seen = Vec::new();
    each(&mut |renderer, camera| {
        // The medians of all views need no sharp pictures.
        let small = camera.scaled_to(camera.width.div_ceil(4), camera.height.div_ceil(4));
        let depths = surface_of(renderer, &small, &settings)?.depth;
        seen.extend(depths.into_iter().filter(|&depth| depth > 0.0).map(|depth| [depth, depth / camera.fx]));
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
    each(&mut |renderer, camera| blocks.add(camera, &surface_of(renderer, camera, &settings)?))
        .map_err(named)?;
    if blocks.is_empty() {
        return Err(Error::argument("--max-depth", "every surface lies beyond it"));
    }
    let field = DistanceField::new(&context, &blocks).map_err(named)?;
    each(&mut |renderer, camera| field.integrate(renderer, camera, &settings))?;
    let mut mesh = field.mesh().map_err(named)?;
    bar.finish_and_clear();
    let removed = mesh.keep_parts(mesh.triangles.len() / SMALLEST_PART);
    if mesh.triangles.is_empty() {
        let problem = format!("{least_views} views see no surface together that is larger than a voxel");
        return Err(Error::input(&model.ply, problem, "give other views, or a smaller --voxel"));
    }
    session::check(&stop)?;
    if let Some(count) = arguments.triangles {
        mesh.simplify(count as usize);
        let left = mesh.triangles.len();
        if left > count as usize {
            errln!(
                "warning: --triangles: {} are left, since fewer would change the topology",
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
