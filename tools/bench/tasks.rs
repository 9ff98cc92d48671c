//! Tasks of a sub-command, measured one after another.

use super::arguments::{AllArguments, BlendingArguments, FrameArguments, PrimitiveArguments};
use super::frames::{self, Job};
use super::measure::Iterations;
use super::primitives;
use super::schema::{CopyBandwidth, Run};
use super::sizes::FrameSize;
use super::training::Training;
use super::workload::{Scene, SceneArguments, SyntheticArguments};
use ashsplat::vk::Context;
use ashsplat::{Blending, Error, Result};
use ashsplat_program::args::HostArguments;
use std::path::Path;
use std::rc::Rc;

/// A task, which makes one or more runs of the result.
pub enum Task {
    Scan(u32, Iterations),
    Sort(u32, Iterations),
    Render(Rc<Scene>, Iterations, Option<Blending>),
    /// A frame in both forms of blending.
    RenderBoth(Rc<Scene>, Iterations),
    TrainStep(Rc<Scene>, Iterations, Option<Blending>),
    Train(Box<Training>),
}

/// Default number of pairs to sort.
const PAIRS: u32 = 1 << 22;
/// Values to scan for each pair to sort: the scan is so fast that fewer would vanish in the cost of timing.
const VALUES_PER_PAIR: u32 = 4;
/// Gaussians above which a frame is measured less often.
const MANY: u32 = 500_000;
/// Most iterations of such a frame on a processor.
const FEW_ITERATIONS: u32 = 5;

pub fn of_scan(arguments: &PrimitiveArguments) -> Vec<Task> {
    vec![Task::Scan(arguments.elements.unwrap_or(VALUES_PER_PAIR * PAIRS), arguments.iterations.get())]
}

pub fn of_sort(arguments: &PrimitiveArguments) -> Vec<Task> {
    vec![Task::Sort(arguments.elements.unwrap_or(PAIRS), arguments.iterations.get())]
}

/// One scene: synthetic, or given by the arguments.
pub fn of_frames(arguments: &FrameArguments, train_step: bool) -> Result<Vec<Task>> {
    if train_step && arguments.read_back.no_read_back {
        return Err(Error::argument(
            "--no-read-back",
            "is about frames: a training step reads no picture back",
        ));
    }
    let scene = Rc::new(arguments.scene.load(train_step, &arguments.output.device.host)?);
    let (iterations, form) = (arguments.read_back.of(arguments.iterations.get()), arguments.form.get());
    let task = if train_step { Task::TrainStep } else { Task::Render };
    Ok(vec![task(scene, iterations, form)])
}

/// One scene in both forms of blending.
pub fn of_blending(arguments: &BlendingArguments) -> Result<Vec<Task>> {
    let scene = arguments.scene.load(false, &arguments.output.device.host)?;
    Ok(vec![Task::RenderBoth(Rc::new(scene), arguments.read_back.of(arguments.iterations.get()))])
}

pub fn of_training(
    dataset: &Path,
    windows: &[u32],
    sh_degree: u32,
    host: &HostArguments,
) -> Result<Vec<Task>> {
    Ok(vec![Task::Train(Box::new(Training::load(dataset, windows, sh_degree, host)?))])
}

/// The primitives at two sizes, synthetic frames and steps, and the given trained scene and data sets.
pub fn of_all(arguments: &AllArguments, is_slow: bool) -> Result<Vec<Task>> {
    let own = &arguments.synthetic;
    let of_size = |&FrameSize { gaussians, width, height }: &FrameSize| SyntheticArguments {
        gaussians: Some(gaussians),
        width: Some(width),
        height: Some(height),
        ..own.clone()
    };
    arguments.frames.iter().try_for_each(|size| of_size(size).check())?;
    let synthetic = Rc::new(own.load()?);
    let (few, iterations) =
        (arguments.elements.div_ceil(4), arguments.read_back.of(arguments.iterations.get()));
    // With so few pairs, timing each command would show on a driver whose timestamps end a batch of work.
    let smaller = Iterations { timed: !is_slow, ..iterations };
    let mut tasks = vec![
        Task::Scan(arguments.elements.saturating_mul(VALUES_PER_PAIR).min(1 << 28), iterations),
        Task::Sort(few, smaller),
        Task::Sort(arguments.elements, iterations),
        Task::Render(synthetic.clone(), iterations, None),
    ];
    let few = Iterations {
        measured: iterations.measured.min(FEW_ITERATIONS),
        warmup: iterations.warmup.min(1),
        ..iterations
    };
    // Few iterations suffice for their ratio.
    tasks.push(Task::RenderBoth(synthetic.clone(), few));
    for size in &arguments.frames {
        let scene = Rc::new(of_size(size).load()?);
        let iterations = if is_slow && size.gaussians > MANY { few } else { iterations };
        tasks.push(Task::Render(scene.clone(), iterations, None));
        // A processor takes seconds for them; the frame above suffices for its table of forms.
        if !is_slow {
            tasks.push(Task::RenderBoth(scene, few));
        }
    }
    if let Some(file) = &arguments.scene {
        let size = arguments.scene_size.map_or((own.width, own.height), |(w, h)| (Some(w), Some(h)));
        let trained = SceneArguments::of_file(file, arguments.camera.as_deref(), size);
        tasks.push(Task::Render(
            Rc::new(trained.load(false, &arguments.output.device.host)?),
            iterations,
            None,
        ));
    }
    tasks.push(Task::TrainStep(synthetic, iterations, None));
    let first_window = arguments.windows.iter().min().map_or(&[][..], std::slice::from_ref);
    for (number, dataset) in arguments.dataset.iter().enumerate() {
        let windows = if number == 0 { &arguments.windows } else { first_window };
        tasks.extend(of_training(dataset, windows, own.sh_degree(), &arguments.output.device.host)?);
    }
    Ok(tasks)
}

impl Task {
    pub fn run(&self, context: &Context, seed: u64, copy: Option<&CopyBandwidth>) -> Result<Vec<Run>> {
        let primitive =
            |&elements, &iterations| primitives::Job { context, iterations, copy, elements, seed };
        let frame = |scene, &iterations, &blending| Job { context, iterations, copy, scene, blending, seed };
        Ok(match self {
            Task::Scan(elements, iterations) => vec![primitives::scan(&primitive(elements, iterations))?],
            Task::Sort(elements, iterations) => vec![primitives::sort(&primitive(elements, iterations))?],
            Task::Render(scene, iterations, form) => {
                vec![frames::render(&frame(scene, iterations, form))?.0]
            }
            Task::RenderBoth(scene, iterations) => frames::render_both(&frame(scene, iterations, &None))?,
            Task::TrainStep(scene, iterations, form) => {
                vec![frames::train_step(&frame(scene, iterations, form))?.0]
            }
            Task::Train(training) => training.measure(context, copy, seed)?,
        })
    }
}
