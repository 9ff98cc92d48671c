//! Tasks of a sub-command, measured one after another.

use super::arguments::{AllArguments, FrameArguments, TrainArguments};
use super::frames::{self, IterationKind, Plan};
use super::measure::Iterations;
use super::primitives::{self, Job};
use super::schema::{CopyBandwidth, Run};
use super::sizes::FrameSize;
use super::training::Training;
use super::workload::{Scene, SceneArguments, SyntheticArguments};
use ashsplat::vk::Context;
use ashsplat::{Error, Result};
use std::rc::Rc;

/// A task, which makes one or more runs of the result.
pub enum Task {
    /// Number of values.
    Scan(u32, Iterations),
    /// Number of pairs.
    Sort(u32, Iterations),
    Frames(Plan, Iterations),
    Train(Box<Training>),
}

pub const PAIRS: u32 = 1 << 22;
/// Values to scan for each pair to sort: the scan is so fast that fewer would vanish in the cost of timing.
pub const VALUES_PER_PAIR: u32 = 4;
/// Gaussians above which a frame is measured less often.
const MANY: u32 = 500_000;
/// Most iterations of such a frame on a processor.
const FEW_ITERATIONS: u32 = 5;

/// One scene: synthetic, or given by the arguments.
pub fn of_frames(arguments: &FrameArguments, what: IterationKind) -> Result<Vec<Task>> {
    let reads_back = !arguments.read_back.no_read_back;
    if what == IterationKind::TrainStep && !reads_back {
        let problem = "is about frames: a training step reads no picture back";
        return Err(Error::argument("--no-read-back", problem));
    }
    let scene = arguments.scene.load(what == IterationKind::TrainStep, &arguments.output.device.host)?;
    let (form, seed) = (arguments.form.get(), arguments.scene.synthetic.seed());
    let plan = Plan { what, scene: Rc::new(scene), form, reads_back, seed };
    Ok(vec![Task::Frames(plan, arguments.iterations.get())])
}

pub fn of_training(arguments: &TrainArguments) -> Result<Vec<Task>> {
    let TrainArguments { dataset, windows, sh_degree, output, .. } = arguments;
    Ok(vec![Task::Train(Box::new(Training::load(dataset, windows, *sh_degree, &output.device.host)?))])
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
    let iterations = arguments.iterations.get();
    // With so few pairs, timestamps would cost noticeable time on a driver that ends a batch of work at each.
    let smaller = Iterations { timed: !is_slow, ..iterations };
    let few = Iterations {
        measured: iterations.measured.min(FEW_ITERATIONS),
        warmup: iterations.warmup.min(1),
        ..iterations
    };
    let frame = |scene: &Rc<Scene>| Plan {
        what: IterationKind::Render,
        scene: scene.clone(),
        form: None,
        reads_back: !arguments.read_back.no_read_back,
        seed: own.seed(),
    };
    let synthetic = Rc::new(own.load()?);
    let mut tasks = vec![
        Task::Scan(arguments.elements.saturating_mul(VALUES_PER_PAIR).min(1 << 28), iterations),
        Task::Sort(arguments.elements.div_ceil(4), smaller),
        Task::Sort(arguments.elements, iterations),
        Task::Frames(frame(&synthetic), iterations),
    ];
    for size in &arguments.frames {
        let scene = Rc::new(of_size(size).load()?);
        let iterations = if is_slow && size.gaussians > MANY { few } else { iterations };
        tasks.push(Task::Frames(frame(&scene), iterations));
    }
    let host = &arguments.output.device.host;
    if let Some(file) = &arguments.scene {
        let size = arguments.scene_size.map_or((own.width, own.height), |(w, h)| (Some(w), Some(h)));
        let trained = SceneArguments::of_file(file, arguments.camera.as_deref(), size).load(false, host)?;
        tasks.push(Task::Frames(frame(&Rc::new(trained)), iterations));
    }
    tasks.push(Task::Frames(Plan { what: IterationKind::TrainStep, ..frame(&synthetic) }, iterations));
    let first_window = arguments.windows.iter().min().map_or(&[][..], std::slice::from_ref);
    for (number, dataset) in arguments.dataset.iter().enumerate() {
        let windows = if number == 0 { &arguments.windows } else { first_window };
        tasks.push(Task::Train(Box::new(Training::load(dataset, windows, own.sh_degree(), host)?)));
    }
    Ok(tasks)
}

impl Task {
    pub fn run(&self, context: &Context, seed: u64, copy: Option<&CopyBandwidth>) -> Result<Vec<Run>> {
        let primitive =
            |&elements: &u32, &iterations: &Iterations| Job { context, iterations, copy, elements, seed };
        match self {
            Task::Scan(elements, iterations) => Ok(vec![primitives::scan(&primitive(elements, iterations))?]),
            Task::Sort(elements, iterations) => Ok(vec![primitives::sort(&primitive(elements, iterations))?]),
            Task::Frames(plan, iterations) => Ok(vec![frames::measure(context, plan, *iterations, copy)?.0]),
            Task::Train(training) => training.measure(context, copy, seed),
        }
    }
}
