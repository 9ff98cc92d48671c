//! `ashsplat inspect`.

use ashsplat::scene::{Camera, WorldFrame};
use ashsplat::{Error, PixelReport, Renderer, Result};
use ashsplat_files::cameras_json;
use ashsplat_files::text::numbers;
use ashsplat_program::args::DeviceArguments;
use ashsplat_program::look::LookArguments;
use ashsplat_program::model::Model;
use ashsplat_program::{output, session};
use clap::Args;
use serde_json::json;
use std::path::PathBuf;

/// The Gaussians blended at one pixel, front to back, and the colour that they give.
///
/// The camera is one of the training's (the default for a model folder), of a data set (-s), or of a camera path or
/// cameras.json (--path).
#[derive(Args)]
pub struct Arguments {
    /// A model folder or a PLY
    #[arg(value_name = "MODEL")]
    model: PathBuf,
    /// Column and row, counted from 0 at the top left
    #[arg(long, value_name = "X,Y", value_parser = parse_pixel)]
    pixel: [u32; 2],
    /// Take the camera from this data set
    #[arg(short, long, value_name = "DATASET", conflicts_with = "path")]
    source_path: Option<PathBuf>,
    /// Take the camera from a camera path or cameras.json
    #[arg(long, value_name = "FILE")]
    path: Option<PathBuf>,
    /// Which camera of the training, data set or path: its number from 0, or its name
    #[arg(long, alias = "frame", value_name = "N|NAME", default_value = "0")]
    camera: String,
    #[command(flatten)]
    look: LookArguments,
    #[command(flatten)]
    device: DeviceArguments,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

fn parse_pixel(text: &str) -> Result<[u32; 2], String> {
    numbers(text).ok_or_else(|| "expected two whole numbers with a comma between them".into())
}

pub fn run(arguments: &Arguments) -> Result<()> {
    let model = Model::locate(&arguments.model, None)?;
    let scene = arguments.look.load(&model.ply, &arguments.device.host)?;
    let camera = arguments.camera(&model, &scene.frame)?;
    let [x, y] = arguments.pixel;
    if x >= camera.width || y >= camera.height {
        let problem =
            format!("{x},{y} lies outside the picture of {}x{} pixels", camera.width, camera.height);
        return Err(Error::argument("--pixel", problem));
    }
    let settings = arguments.look.settings(&model.settings, &scene.header)?;
    let context = arguments.device.context()?;
    let mut renderer = Renderer::new(&context)?;
    renderer.upload_stored(&scene.gaussians, arguments.look.stored(&scene.gaussians))?;
    let mut report = renderer.inspect(&camera, &settings, arguments.pixel)?;
    // Converts depths to source units.
    report.samples.iter_mut().for_each(|sample| sample.depth *= scene.frame.unit as f32);
    if arguments.json {
        let samples = output::samples(&report);
        let all = json!({ "samples": samples, "color": report.color, "transmittance": report.transmittance });
        outln!("{all:#}");
    } else {
        print_table(&report)
    }
    arguments.device.report_validation(&context);
    Ok(())
}

impl Arguments {
    fn camera(&self, model: &Model, frame: &WorldFrame) -> Result<Camera> {
        let own = model.cameras_file();
        let cameras = match (&self.source_path, self.path.as_ref().or(own.as_ref())) {
            (Some(dataset), _) => session::cameras(dataset, &model.settings.data, frame)?,
            (None, Some(path)) => cameras_json::read(path, frame)?,
            (None, None) => {
                return Err(Error::argument("camera", "is not given: use -s DATASET or --path FILE"));
            }
        };
        let by_number = || cameras.get(self.camera.parse::<usize>().ok()?);
        let found = cameras.iter().find(|named| named.name == self.camera).or_else(by_number);
        found.map(|named| named.camera).ok_or_else(|| {
            let problem =
                format!("there is no '{}': numbers go from 0 to {}", self.camera, cameras.len().max(1) - 1);
            Error::argument("--camera", problem)
        })
    }
}

fn print_table(report: &PixelReport) {
    outln!("{:>4} {:>9} {:>10} {:>8} {:>8} {:>8}  colour", "rank", "id", "depth", "alpha", "weight", "left");
    for (rank, sample) in report.samples.iter().enumerate() {
        outln!(
            "{rank:>4} {:>9} {:>10.4} {:>8.5} {:>8.5} {:>8.5}  {}",
            sample.gaussian,
            sample.depth,
            sample.alpha,
            sample.weight,
            sample.transmittance_after,
            triple(sample.color),
        );
    }
    outln!("final colour {}, transmittance {:.5}", triple(report.color), report.transmittance);
}

fn triple(color: [f32; 3]) -> String {
    let [r, g, b] = color;
    format!("{r:.4} {g:.4} {b:.4}")
}
