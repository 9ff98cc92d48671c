//! What a sub-command measures, one task after another.

use super::frames::{self, Job};
use super::measure::Iterations;
use super::schema::{CopyBandwidth, Run};
use super::training::Training;
use super::workload::{Scene, SceneArguments};
use super::{RunArguments, primitives};
use ashsplat::vk::Context;
use ashsplat::{Error, Result};
use std::rc::Rc;

/// One entry of the result.
pub enum Task {
    Scan(u32),
    Sort(u32, Iterations),
    Render(Rc<Scene>, Iterations),
    TrainStep(Rc<Scene>),
    Train(Box<Training>),
}

/// Gaussians above which a frame is measured less often.
const MANY: u32 = 500_000;
/// Iterations of such a frame at most, on a processor.
const FEW_ITERATIONS: u32 = 5;

/// A synthetic frame on the command line: "1140000@1280x720".
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameSize {
    gaussians: u32,
    width: u32,
    height: u32,
}

impl FrameSize {
    /// More Gaussians than one binding of 128 MiB holds.
    pub const LARGE: Self = Self { gaussians: 1_140_000, width: 1280, height: 720 };
}

impl std::fmt::Display for FrameSize {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        write!(f, "{}@{}x{}", self.gaussians, self.width, self.height)
    }
}

impl std::str::FromStr for FrameSize {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parsed = text.split_once('@').and_then(|(gaussians, size)| {
            let (width, height) = size.split_once('x')?;
            Some((gaussians.parse().ok()?, width.parse().ok()?, height.parse().ok()?))
        });
        match parsed {
            Some((gaussians @ 1.., width @ 1.., height @ 1..)) => Ok(Self { gaussians, width, height }),
            _ => Err("give Gaussians and size, as in 1140000@1280x720".to_owned()),
        }
    }
}

/// One scene: synthetic, or what the arguments name.
pub fn of_frames(arguments: &RunArguments, train_step: bool) -> Result<Vec<Task>> {
    let scene = Rc::new(arguments.scene.load(train_step)?);
    Ok(vec![if train_step { Task::TrainStep(scene) } else { Task::Render(scene, arguments.iterations()) }])
}

/// Training of the data set.
pub fn of_training(arguments: &RunArguments) -> Result<Vec<Task>> {
    let Some(dataset) = &arguments.scene.dataset else {
        return Err(Error::argument("bench train", "needs a data set: give --dataset"));
    };
    Ok(vec![Task::Train(Box::new(Training::load(dataset, &arguments.windows, arguments.scene.sh_degree)?))])
}

/// The primitives at two sizes, synthetic frames and steps, and the trained scene and the data set where given.
pub fn of_all(arguments: &RunArguments, is_cpu: bool) -> Result<Vec<Task>> {
    let own = SceneArguments { scene: None, camera: None, dataset: None, ..arguments.scene.clone() };
    let synthetic = Rc::new(own.load(false)?);
    let (few, iterations) = (arguments.elements.div_ceil(4), arguments.iterations());
    // So few pairs that timing each command would show.
    let as_a_whole = Iterations { timed: false, ..iterations };
    let mut tasks = vec![
        Task::Scan(arguments.values()),
        Task::Sort(few, as_a_whole),
        Task::Sort(arguments.elements, iterations),
        Task::Render(synthetic.clone(), iterations),
    ];
    for &FrameSize { gaussians, width, height } in &arguments.frames {
        let frame = SceneArguments { gaussians, width: Some(width), height: Some(height), ..own.clone() };
        let few = Iterations {
            measured: iterations.measured.min(FEW_ITERATIONS),
            warmup: iterations.warmup.min(1),
            ..iterations
        };
        let iterations = if is_cpu && gaussians > MANY { few } else { iterations };
        tasks.push(Task::Render(Rc::new(frame.load(false)?), iterations));
    }
    if arguments.scene.scene.is_some() {
        let trained = SceneArguments { dataset: None, ..arguments.scene.clone() };
        tasks.push(Task::Render(Rc::new(trained.load(false)?), iterations));
    }
    tasks.push(Task::TrainStep(synthetic));
    if arguments.scene.dataset.is_some() {
        tasks.extend(of_training(arguments)?);
    }
    Ok(tasks)
}

impl Task {
    /// Measures it.
    pub fn run(
        &self,
        context: &Context,
        arguments: &RunArguments,
        copy: Option<&CopyBandwidth>,
    ) -> Result<Vec<Run>> {
        let (iterations, seed) = (arguments.iterations(), arguments.scene.seed);
        let primitive = |elements, iterations| primitives::Job { context, iterations, copy, elements, seed };
        Ok(match self {
            Task::Scan(elements) => vec![primitives::scan(&primitive(*elements, iterations))?],
            Task::Sort(elements, iterations) => vec![primitives::sort(&primitive(*elements, *iterations))?],
            Task::Render(scene, iterations) => {
                vec![frames::render(&Job { context, iterations: *iterations, copy, scene, seed })?.0]
            }
            Task::TrainStep(scene) => {
                vec![frames::train_step(&Job { context, iterations, copy, scene, seed })?.0]
            }
            Task::Train(training) => training.measure(context, copy, seed)?,
        })
    }
}
