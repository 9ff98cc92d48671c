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
    Sort(u32),
    Render(Rc<Scene>, Iterations),
    TrainStep(Rc<Scene>),
    Train(Box<Training>),
}

/// Picture of `all`'s large frame, pixels.
const LARGE_SIZE: (u32, u32) = (1280, 720);
/// Iterations of the large frame at most.
const LARGE_ITERATIONS: u32 = 5;

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
pub fn of_all(arguments: &RunArguments) -> Result<Vec<Task>> {
    let own = SceneArguments { scene: None, camera: None, dataset: None, ..arguments.scene.clone() };
    let synthetic = Rc::new(own.load(false)?);
    let (few, iterations) = (arguments.elements.div_ceil(4), arguments.iterations());
    let mut tasks = vec![
        Task::Scan(arguments.elements),
        Task::Sort(few),
        Task::Sort(arguments.elements),
        Task::Render(synthetic.clone(), iterations),
    ];
    if arguments.large > 0 {
        let (width, height) = (Some(LARGE_SIZE.0), Some(LARGE_SIZE.1));
        let large = SceneArguments { gaussians: arguments.large, width, height, ..own.clone() };
        let iterations = Iterations {
            measured: iterations.measured.min(LARGE_ITERATIONS),
            warmup: iterations.warmup.min(1),
        };
        tasks.push(Task::Render(Rc::new(large.load(false)?), iterations));
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
        let primitive = |elements| primitives::Job { context, iterations, copy, elements, seed };
        Ok(match self {
            Task::Scan(elements) => vec![primitives::scan(&primitive(*elements))?],
            Task::Sort(elements) => vec![primitives::sort(&primitive(*elements))?],
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
