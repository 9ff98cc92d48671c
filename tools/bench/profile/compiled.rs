//! `--static`: statistics of the driver's compiler about the pipelines of frames and training steps. Nothing runs, so
//! it works for drivers without hardware too.

use super::{Arguments, IterationKind, spec, watch};
use crate::compiled::{Compiled, Pipeline};
use crate::{compiled, machine, synthetic};
use ashsplat::train::{MomentsType, OptimizerType, StrategyType};
use ashsplat::vk::{CompileOnly, Context, PipelineStatistics, is_kernel_of};
use ashsplat::{
    Blending, Error, RenderSettings, Renderer, Reservation, Result, SurfaceDepth, TrainSettings, TrainView,
    Trainer,
};
use ashsplat_files::{Photo, StoredPhoto, atomic};
use ashsplat_program::output;
use clap::Args;
use std::path::{Path, PathBuf};

/// Options of --static.
#[derive(Args, Default)]
pub struct StaticArguments {
    /// Run nothing and ask the driver's compiler instead: registers, spills, shared memory, subgroups per SIMD, estimated cycles
    /// and code size of the pipelines of a frame and of training steps, without those that measure LPIPS
    /// (VK_KHR_pipeline_executable_properties)
    #[arg(long = "static", conflicts_with_all = NOT_WITH_STATIC)]
    pub is_static: bool,
    /// Write all figures here (schema ashsplat-static/1)
    #[arg(long, value_name = "FILE", requires = "is_static")]
    json: Option<PathBuf>,
    /// Write the compiler's texts here, machine code among them: DIR/KERNEL.NUMBER.NAME.txt; where a driver compiles several programs
    /// of a pipeline, DIR/KERNEL.NUMBER.PROGRAM.NAME.txt
    #[arg(long, value_name = "DIR", requires = "is_static")]
    asm: Option<PathBuf>,
    /// Show columns of these files, written with --json, beside the device's own; --kernel holds for them, too; may be repeated
    #[arg(long, value_name = "FILE", requires = "is_static")]
    beside: Vec<PathBuf>,
}

/// Options that run something, or select what a compiler does not see.
const NOT_WITH_STATIC: [&str; 18] = [
    "trace",
    "ab",
    "watch",
    "printf",
    "capture",
    "frames",
    "warmup",
    "gaussians",
    "width",
    "height",
    "seed",
    "scene",
    "camera",
    "dataset",
    "view",
    "validation",
    "max_memory",
    "max_host_memory",
];

/// Size of the pictures; compiled code does not depend on it.
const SIZE: [u32; 2] = [160, 96];
const GAUSSIANS: usize = 512;

pub fn run(arguments: &Arguments) -> Result<()> {
    let requested = &arguments.compiled;
    output::check(&[("--json", requested.json.as_deref())])?;
    if let Some(folder) = &requested.asm {
        output::check_folder(folder)?;
    }
    let what = arguments.what.map_or("all", IterationKind::name);
    let others = others(arguments, what)?;
    let overrides = arguments.overrides()?;
    let context = arguments.device.context_with(|options| {
        options.compile_only = Some(CompileOnly { texts: requested.asm.is_some() });
        spec::apply(options, &overrides);
    })?;
    if let Some(glsl) = &arguments.glsl {
        watch::take_over(&context, glsl)?;
    }
    let sh_degree = arguments.scene.synthetic.sh_degree();
    let forms = arguments.form.get().map_or(Blending::ALL.to_vec(), |form| vec![form]);
    if arguments.what != Some(IterationKind::TrainStep) {
        forms.iter().try_for_each(|&form| frames(&context, sh_degree, form))?;
    }
    if arguments.what != Some(IterationKind::Render) {
        forms.iter().try_for_each(|&form| trainings(&context, sh_degree, form))?;
    }
    let mut statistics = context.pipeline_statistics()?;
    only(arguments, &mut statistics)?;
    if let Some(folder) = &requested.asm {
        write_texts(folder, &statistics)?;
    }
    let compiled = Compiled {
        schema: compiled::SCHEMA.to_owned(),
        program: machine::program(),
        device: machine::device(&context),
        what: what.to_owned(),
        pipelines: statistics.iter().map(Pipeline::of).collect(),
    };
    if let Some(path) = &requested.json {
        output::write_json(path, &compiled)?;
    }
    if others.is_empty() {
        let device = &compiled.device;
        outln!(
            "{}, {}: {} pipelines, none of which has run",
            device.name,
            device.driver,
            compiled.pipelines.len()
        );
        outln!("{}", compiled::table(&compiled, arguments.kernel.is_some()));
    } else {
        let mut all = vec![compiled];
        all.extend(others);
        outln!("{}", compiled::beside(&all));
    }
    Ok(())
}

/// The files of --beside, with the requested kernels.
fn others(arguments: &Arguments, what: &str) -> Result<Vec<Compiled>> {
    let mut all = Vec::new();
    for path in &arguments.compiled.beside {
        let mut other = compiled::read(path)?;
        if other.what != what {
            errln!(
                "warning: {}: has the pipelines of '{}', this run those of '{what}': kernels and their variants differ as well",
                path.display(),
                other.what
            );
        }
        let requested =
            |p: &Pipeline| arguments.kernel.as_deref().is_none_or(|name| is_kernel_of(&p.kernel, name));
        other.pipelines.retain(requested);
        all.push(other);
    }
    Ok(all)
}

/// Keeps the requested kernels. Refuses a kernel that is not built here.
fn only(arguments: &Arguments, statistics: &mut Vec<PipelineStatistics>) -> Result<()> {
    let Some(name) = &arguments.kernel else { return Ok(()) };
    let mut built: Vec<&str> = statistics.iter().map(|p| p.kernel).collect();
    built.dedup();
    statistics.retain(|p| is_kernel_of(p.kernel, name));
    if !statistics.is_empty() {
        return Ok(());
    }
    let built = built.join(", ");
    let problem = match arguments.what {
        Some(what) => {
            let what = what.name();
            format!(
                "'{what}' has no pipeline of it; try without '{what}', for frames and training steps, or give one of: {built}"
            )
        }
        None => format!("neither frames nor training steps have a pipeline of it here; give one of: {built}"),
    };
    Err(Error::argument(format!("--kernel {name}"), problem))
}

/// Builds frames with all features, gradients, and frames in a host's command buffer.
fn frames(context: &Context, sh_degree: u32, form: Blending) -> Result<()> {
    let gaussians = synthetic::scene(0, GAUSSIANS, sh_degree);
    let camera = synthetic::camera(SIZE[0], SIZE[1]);
    let mut renderer = Renderer::new(context)?;
    renderer.set_blending(form);
    renderer.upload(&gaussians)?;
    renderer.compute_filters(&[camera])?;
    let usual = RenderSettings::default();
    for settings in [
        usual,
        RenderSettings { inverse_depth: true, ..usual },
        RenderSettings { antialias: true, filter_3d: true, ..usual },
    ] {
        renderer.render(&camera, &settings)?;
    }
    let weights = vec![[1.0; 3]; (SIZE[0] * SIZE[1]) as usize];
    renderer.gradients(&camera, &usual, &weights, None)?;
    renderer.gradients_with_pose(&camera, &usual, &weights, None)?;
    renderer.reserve(&Reservation {
        // The largest number of scenes that may be drawn together.
        scenes: 8,
        inverse_depth: true,
        expected_depth: true,
        occlusion: true,
        filter_3d: true,
        tint: true,
        cut_outs: 1,
        selection: true,
        pick: true,
        motion: true,
        surface: Some(SurfaceDepth::Median),
        ..Reservation::new(GAUSSIANS as u32, sh_degree, SIZE[0], SIZE[1])
    })
}

/// Runs steps of each strategy up to the full SH degree and past a densification, then steps with everything else that
/// can be learnt.
fn trainings(context: &Context, sh_degree: u32, form: Blending) -> Result<()> {
    let of = |strategy| TrainSettings {
        iterations: 16,
        sh_degree,
        sh_degree_interval: 1,
        densify_from_iter: 1,
        densification_interval: 2,
        densify_until_iter: 10,
        opacity_reset_interval: 4,
        scale_schedule: false,
        ..TrainSettings::of_strategy(strategy)
    };
    let reference = of(StrategyType::Reference);
    let all = [
        reference.clone(),
        of(StrategyType::Budget),
        of(StrategyType::Mcmc),
        TrainSettings { optimizer_type: OptimizerType::SparseAdam, surface: true, ..reference.clone() },
        TrainSettings { warm_up: 4, ..reference.clone() },
        TrainSettings {
            antialiasing: true,
            filter_3d: true,
            exposure: true,
            lens_effects: true,
            pose_opt: true,
            depth_points: 0.1,
            dropout: 0.1,
            opacity_reg: 0.01,
            scale_reg: 0.01,
            random_background: true,
            moments: MomentsType::Packed,
            ..reference
        },
    ];
    all.iter().try_for_each(|settings| training(context, settings, form))
}

fn training(context: &Context, settings: &TrainSettings, form: Blending) -> Result<()> {
    let camera = synthetic::camera(SIZE[0], SIZE[1]);
    let pixels = (SIZE[0] * SIZE[1]) as usize;
    let photo = Photo { width: SIZE[0], height: SIZE[1], rgb: vec![0; 3 * pixels] };
    // Depth maps and points exclude each other.
    let sparse = settings.depth_points > 0.0;
    let view = |masked: bool| {
        let stored = StoredPhoto::new(photo.clone(), masked.then(|| vec![255; pixels]));
        let map = (masked && !sparse).then(|| vec![0.5; pixels].into());
        let depth_points = sparse.then(|| depth_points().into());
        TrainView { inverse_depth: map, depth_points, ..TrainView::new(camera, stored) }
    };
    let views = vec![view(false), view(settings.warm_up == 0)];
    let start = synthetic::scene(0, GAUSSIANS, settings.sh_degree);
    let mut trainer = Trainer::new(context, views, &start, 2.5, settings.clone())?;
    trainer.set_blending(form);
    (0..settings.iterations).try_for_each(|_| trainer.step().map(drop))
}

fn depth_points() -> Vec<ashsplat::passes::loss::DepthPoint> {
    vec![ashsplat::passes::loss::DepthPoint { position_px: [20.0, 20.0], inverse_z: 0.5 }]
}

/// Writes DIR/forward/blend.2.shader_disassembly.txt and so on. The number is the variant's index in the kernel's
/// table. If a driver compiles several programs of a pipeline, whose texts have the same names, the program's number
/// follows: DIR/forward/blend.2.1.shader_disassembly.txt.
fn write_texts(folder: &Path, all: &[PipelineStatistics]) -> Result<()> {
    let mut variant = 0;
    for (index, pipeline) in all.iter().enumerate() {
        variant = if index > 0 && all[index - 1].kernel == pipeline.kernel { variant + 1 } else { 0 };
        for (program, executable) in pipeline.executables.iter().enumerate() {
            let number = match pipeline.executables.len() {
                1 => variant.to_string(),
                _ => format!("{variant}.{program}"),
            };
            for (name, text) in &executable.texts {
                let plain: String =
                    name.to_lowercase().chars().map(|c| if c.is_alphanumeric() { c } else { '_' }).collect();
                let path = folder.join(format!("{}.{number}.{plain}.txt", pipeline.kernel));
                output::in_folder(&path, |path| atomic::write(path, |out| out.write_all(text.as_bytes())))?;
            }
        }
    }
    Ok(())
}
