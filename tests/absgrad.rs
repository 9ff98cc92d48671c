//! Absolute statistics, and the importance of Gaussians between two steps, as strategies request them.

use ashsplat::densify::{
    Candidates, Chances, Densify, Importance, Selection, SelectionBuffers, SelectionDraw,
};
use ashsplat::trainer::strategy::{ABSOLUTE_STATISTIC, Changes, Statistic, Work};
use ashsplat::trainer::{Actions, Checkpoint, Densified, Population, Strategy, TrainParts, Trainer};
use ashsplat::vk::{Context, MemoryKind};
use ashsplat::{Result, TrainSettings, TrainView};
use std::sync::{Arc, Mutex};

use crate::checkpoints::{start, views};
use crate::common::bounded;
use crate::common::gpu::Gpu;
use crate::photos::in_a_file;

const EXTENT: f32 = 5.0;
const ITERATIONS: u32 = 20;
/// Number of Gaussians removed at a time.
const REMOVED: u32 = 9;

/// Requests absolute statistics if `absolute`. After every `every` iterations it removes Gaussians, drawn in
/// proportion to their importance.
struct Watching {
    absolute: bool,
    every: u32,
    kernels: (Densify, Importance, Selection),
    /// Largest importance so far.
    largest: f32,
}

impl Watching {
    fn parts(context: &Context, absolute: bool, every: u32) -> TrainParts {
        let kernels = (
            Densify::new(context).expect("kernels"),
            Importance::new(context, &settings().render_settings()).expect("kernels"),
            Selection::new(context).expect("kernels"),
        );
        TrainParts {
            strategy: Box::new(Self { absolute, every, kernels, largest: 0.0 }),
            terms: Vec::new(),
            block: None,
        }
    }
}

impl Strategy for Watching {
    fn name(&self) -> &'static str {
        "watching"
    }

    fn work(&self, _: &TrainSettings, iteration: u32) -> Work {
        let actions = Actions::DENSIFY.when(iteration.is_multiple_of(self.every));
        Work {
            accumulates: iteration % 7 != 3,
            optimizes: true,
            optimizes_opacity: true,
            sums_gradients: false,
            actions,
        }
    }

    fn statistics(&self) -> Vec<Statistic> {
        let other = Statistic { name: "other", floats: 2 };
        if self.absolute { vec![other, ABSOLUTE_STATISTIC] } else { vec![] }
    }

    fn between_steps(&mut self, population: &mut Population, _: Actions) -> Result<Changes> {
        let (densify, importance, selection) = &self.kernels;
        let before = population.count();
        let views: Vec<usize> = (0..population.cameras().len()).rev().collect();
        let Some(values) = population.importance(importance, &views)? else {
            let densified = Densified { before, kept: before, limited: true, ..Densified::default() };
            return Ok(Changes { densified: Some(densified), ..Changes::default() });
        };
        let context = population.context().clone();
        let bytes = context.download(&values.range(0, u64::from(before) * 4))?;
        let each: Vec<f32> = bytemuck::pod_collect_to_vec(&bytes);
        assert!(each.iter().all(|value| (0.0..=1.00001).contains(value)), "{each:?}");
        self.largest = each.iter().copied().fold(self.largest, f32::max);
        let buffers = context.allocate("densify", &selection.requests(before), MemoryKind::Device)?;
        let buffers = SelectionBuffers::from_allocated(buffers);
        let statistics = population.statistics();
        let draw = SelectionDraw {
            count: before,
            wanted: REMOVED,
            candidates: Candidates {
                statistics: &statistics[0],
                absolute: self.absolute.then(|| &statistics[2]),
                threshold: 0.0,
            },
            chances: Chances::Importance(&values),
            seed: population.settings().seed,
            iteration: population.iteration(),
            explicit: None,
        };
        context.run("select", |r| {
            selection.record(r, &draw, &buffers);
            Ok(())
        })?;
        let bytes = context.download(&buffers.selected.range(0, u64::from(before) * 4))?;
        let selected: Vec<u32> = bytemuck::pod_collect_to_vec(&bytes);
        let kept: Vec<u32> = (0..before).filter(|&i| selected[i as usize] == 0).collect();
        population.keep(&kept, densify)?;
        let densified = Densified { before, kept: population.count(), ..Densified::default() };
        Ok(Changes { densified: Some(densified), ..Changes::default() })
    }

    fn state(&self) -> Vec<(String, String)> {
        vec![("largest".into(), self.largest.to_string())]
    }

    fn restore(&mut self, state: &[(String, String)]) -> Result<()> {
        self.largest = state[0].1.parse().expect("a number");
        Ok(())
    }
}

fn settings() -> TrainSettings {
    TrainSettings {
        iterations: ITERATIONS,
        sh_degree: 2,
        sh_degree_interval: 5,
        seed: 4,
        ..TrainSettings::default()
    }
}

/// A run that is resumed from a checkpoint after each of `stops`.
fn run(
    context: &Context,
    views: impl Fn() -> Vec<TrainView>,
    (absolute, every): (bool, u32),
    stops: &[u32],
) -> Checkpoint {
    let parts = || Watching::parts(context, absolute, every);
    let mut trainer = Trainer::with_parts(context, views(), &start(), EXTENT, settings(), parts());
    for iteration in 1..=ITERATIONS {
        let own = trainer.as_mut().expect("a trainer");
        own.step().expect("a step");
        if stops.contains(&iteration) {
            let from = own.checkpoint().expect("a checkpoint");
            trainer = Trainer::resume_with_parts(context, views(), (settings(), EXTENT), parts(), &from);
        }
    }
    trainer.expect("a trainer").checkpoint().expect("the end")
}

/// Absolute statistics are never below the signed ones, and change no bit of the training.
#[test]
fn absolute_statistics_leave_the_training_as_it_is() {
    let gpu = Gpu::new();
    let of = |absolute| run(gpu.context, || views(3, 9), (absolute, u32::MAX), &[]);
    let (without, with) = (of(false), of(true));
    assert!(without.gaussians == with.gaussians && without.first_moments == with.first_moments);
    assert!(without.second_moments == with.second_moments && without.statistics == with.statistics);
    let [other, absolute] = &with.strategy.statistics[..] else { panic!("two statistics") };
    assert_eq!((absolute.name.as_str(), absolute.floats), ("absolute_statistics", 1));
    assert!(other.values.iter().all(|&value| value == 0.0));
    let pairs = || with.statistics.iter().zip(&absolute.values);
    assert!(pairs().all(|(&[signed, _], &absolute)| absolute >= signed * 0.9999));
    assert!(pairs().filter(|(statistic, absolute)| **absolute > 1.5 * statistic[0]).count() > 20);
    // Same number of views: three of the iterations do not count.
    let most = with.statistics.iter().fold(0.0_f32, |most, statistic| most.max(statistic[1]));
    assert_eq!(most, (ITERATIONS - 3) as f32);
}

#[test]
fn importance_draws_the_same_gaussians_in_a_resumed_run_and_from_photographs_in_a_file() {
    let gpu = Gpu::new();
    let whole = run(gpu.context, || views(3, 9), (true, 6), &[]);
    assert_eq!(whole.gaussians.len(), start().len() - 3 * REMOVED as usize);
    let largest: f32 = whole.strategy.values[0].1.parse().expect("a number");
    assert!((1.0 / 3.0..=1.00001).contains(&largest), "{largest}");
    for stops in [[5, 6], [12, 13]] {
        let resumed = run(gpu.context, || views(3, 9), (true, 6), &stops);
        assert!(resumed == whole, "interrupted after {stops:?}: other bits");
    }
    let streamed = run(gpu.context, || in_a_file(&views(3, 9), 5), (true, 6), &[]);
    assert!(streamed.fingerprint() == whole.fingerprint());
}

/// Requests the importance after each iteration, and notes whether there was memory for it.
struct Asking {
    kernels: Importance,
    views: Vec<usize>,
    answers: Arc<Mutex<Vec<bool>>>,
}

impl Asking {
    fn trainer(context: &Context, views_asked: &[usize]) -> (Trainer, Arc<Mutex<Vec<bool>>>) {
        let answers = Arc::default();
        let kernels = Importance::new(context, &settings().render_settings()).expect("kernels");
        let strategy = Asking { kernels, views: views_asked.to_vec(), answers: Arc::clone(&answers) };
        let parts = TrainParts { strategy: Box::new(strategy), terms: Vec::new(), block: None };
        let trainer = Trainer::with_parts(context, views(3, 9), &start(), EXTENT, settings(), parts);
        (trainer.expect("a trainer"), answers)
    }
}

impl Strategy for Asking {
    fn name(&self) -> &'static str {
        "asking"
    }

    fn work(&self, _: &TrainSettings, _: u32) -> Work {
        Work {
            accumulates: false,
            optimizes: true,
            optimizes_opacity: true,
            sums_gradients: false,
            actions: Actions::DENSIFY,
        }
    }

    fn between_steps(&mut self, population: &mut Population, _: Actions) -> Result<Changes> {
        let there = population.importance(&self.kernels, &self.views)?.is_some();
        self.answers.lock().expect("one thread").push(there);
        Ok(Changes::default())
    }
}

/// All of its memory is counted: without memory there is no importance, and the training continues.
#[test]
fn importance_keeps_within_a_bounded_memory() {
    let of = |max_memory: Option<u64>| {
        let context = bounded(max_memory);
        let (mut trainer, answers) = Asking::trainer(&context, &[0, 1, 2]);
        trainer.step().expect("a step");
        let staged = context.free_staging();
        let before = trainer.memory_bytes();
        trainer.step().expect("a step");
        let there = answers.lock().expect("one thread")[0];
        let peak = context.memory_total().peak_bytes;
        (before, peak, there, trainer.checkpoint().expect("a state").gaussians, staged)
    };
    let (before, peak, there, free, staged) = of(None);
    assert!(there && peak > before);
    for (bound, expected) in [(before + 64, false), (peak, true)] {
        if staged && !expected {
            eprintln!("skipped: no room for nothing but the training: transfers here need memory too");
            continue;
        }
        let (_, used, there, bounded, _) = of(Some(bound));
        assert!(there == expected && used <= bound && bounded == free, "{bound}: {there}, {used} bytes");
    }
}

#[test]
fn importance_of_views_that_do_not_exist_is_refused() {
    let gpu = Gpu::new();
    for (views_asked, word) in [(vec![0, 3], "[0, 3]"), (vec![], "[]")] {
        let (mut trainer, _) = Asking::trainer(gpu.context, &views_asked);
        trainer.step().expect("a step");
        let message = trainer.step().expect_err("refused").to_string();
        assert!(message.contains(word) && message.contains("views"), "{message}");
    }
}
