//! Exchangeable parts of training: strategies and loss terms that the library does not have, and what they can
//! request.

use crate::common::prelude::*;
use crate::photos::in_a_file;
use ashsplat::frame::LaunchSizes;
use ashsplat::passes::densify::{
    Candidates, Chances, Densify, DensifyForm, Importance, UniqueDraw, UniqueDrawBuffers, UniqueDrawInputs,
};
use ashsplat::passes::loss::{LossTerm, TermData, TermInputs};
use ashsplat::passes::pixels::LayoutConverter;
use ashsplat::scene::StoredPhoto;
use ashsplat::train::strategy::{Changes, StepInputs, StepWork};
use ashsplat::train::{Actions, Densified, Population, Regularizers, Strategy, TrainParts};
use ashsplat::vk::{Buffer, Recorder};
use std::sync::{Arc, Mutex};

/// An action of this strategy only.
const PRUNE: Actions = Actions(1 << 7);

/// After every fourth iteration, removes each Gaussian with a probability of a tenth.
struct RandomPrune {
    kernels: Densify,
    pruned: u32,
}

impl RandomPrune {
    fn parts(context: &Context) -> TrainParts {
        let kernels = Densify::new(context, DensifyForm::default()).expect("kernels");
        parts_of(Self { kernels, pruned: 0 })
    }
}

impl Strategy for RandomPrune {
    fn name(&self) -> &'static str {
        "random_prune"
    }

    fn work(&self, _: &TrainSettings, iteration: u32) -> StepWork {
        StepWork { accumulates: true, ..optimizing(PRUNE.when(iteration.is_multiple_of(4))) }
    }

    fn record_update(&self, _: &mut Recorder, step: &StepInputs) {
        assert!(step.step.rates.mean > 0.0 && step.frame.scene().count > 0);
    }

    fn between_steps(&mut self, population: &mut Population, action: Actions) -> Result<Changes> {
        assert_eq!(action, PRUNE);
        let mut random = Random::new(u64::from(population.iteration()));
        let before = population.count();
        let kept: Vec<u32> = (0..before).filter(|_| random.unit() >= 0.1).collect();
        population.keep(&kept, &self.kernels)?;
        self.pruned += before - population.count();
        let densified = Densified { before, kept: population.count(), ..Densified::default() };
        Ok(Changes { densified: Some(densified), ..Changes::default() })
    }

    fn state(&self) -> Vec<(String, String)> {
        vec![("pruned".into(), self.pruned.to_string())]
    }

    fn restore(&mut self, state: &[(String, String)]) -> Result<()> {
        self.pruned = state[0].1.parse().expect("a number");
        Ok(())
    }
}

fn settings() -> TrainSettings {
    TrainSettings {
        iterations: 20,
        sh_degree: 2,
        sh_degree_interval: 5,
        seed: 4,
        ..TrainSettings::reference()
    }
}

fn parts_of(strategy: impl Strategy + 'static) -> TrainParts {
    TrainParts { strategy: Box::new(strategy), terms: Vec::new(), block: None }
}

/// Work of a step that optimises everything, followed by these actions.
fn optimizing(actions: Actions) -> StepWork {
    StepWork { accumulates: false, optimizes: true, optimizes_opacity: true, actions }
}

#[test]
fn a_strategy_of_a_host_prunes_and_resumes_to_the_bit() {
    let parts = || RandomPrune::parts(context());
    let run = Run::shared(views(3, 9), settings()).with_parts(&parts);
    let mut trainer = run.begin();
    let mut count = start().len() as u32;
    let mut middle = None;
    for iteration in 1..=20 {
        let report = trainer.step().expect("a step");
        assert_eq!(report.densified.is_some(), iteration > 4 && iteration % 4 == 1, "{iteration}");
        if let Some(densified) = report.densified {
            assert_eq!((densified.before, densified.kept), (count, report.gaussians));
            assert!(densified.kept < densified.before);
            count = densified.kept;
        }
        if iteration == 8 {
            middle = Some(through_a_file(&trainer.state()));
        }
    }
    let end = trainer.state();
    assert_eq!(end.gaussians.len(), count as usize);
    let middle = middle.expect("a checkpoint");
    assert_eq!(middle.due, PRUNE);
    assert!(middle.strategy.values[0].1.parse::<u32>().expect("a number") > 0);
    let mut resumed = run.resume(&middle);
    resumed.finish();
    let other = resumed.state();
    assert!(other.strategy == end.strategy && other.fingerprint() == end.fingerprint());
    // The library's own strategy has no such state.
    assert_says(refusal(Run { parts: None, ..run }.try_resume(&middle)), &["strategy 'random_prune'"]);
    // A run with other loss terms is a different run.
    let regularized = || {
        let regularizers = Regularizers::new(context(), 1.0, 0.0).expect("kernels");
        TrainParts { terms: vec![Box::new(regularizers)], ..parts() }
    };
    let run = Run::shared(views(3, 9), settings()).with_parts(&regularized);
    assert_says(refusal(run.try_resume(&middle)), &["regularizers"]);
}

/// A strategy that optimises everything, and does something between the steps.
struct Between<F>(F);

impl<F: FnMut(&mut Population) -> Result<()> + Send> Strategy for Between<F> {
    fn name(&self) -> &'static str {
        "between"
    }

    fn work(&self, _: &TrainSettings, _: u32) -> StepWork {
        optimizing(Actions::DENSIFY)
    }

    fn between_steps(&mut self, population: &mut Population, _: Actions) -> Result<Changes> {
        (self.0)(population)?;
        Ok(Changes::default())
    }
}

fn between(act: impl FnMut(&mut Population) -> Result<()> + Send + 'static) -> TrainParts {
    parts_of(Between(act))
}

/// A strategy that keeps a missing Gaussian, or no Gaussian at all, is refused, and the set stays.
#[test]
fn a_strategy_cannot_keep_what_does_not_exist() {
    let parts = || {
        let kernels = Densify::new(context(), DensifyForm::default()).expect("kernels");
        between(move |population| {
            let beyond = population.count();
            let wrong = [(vec![0, beyond], "there are"), (vec![], "must be 1 to"), (vec![2, 2], "twice")];
            for (kept, problem) in wrong {
                assert_says(refusal(population.keep(&kept, &kernels)), &[problem]);
            }
            assert_eq!(population.count(), beyond);
            Ok(())
        })
    };
    let end = Run::shared(views(2, 9), settings()).with_parts(&parts).until(2, &[]);
    assert_eq!(end.gaussians.len(), start().len());
}

fn means(gaussians: &Gaussians) -> [f64; 2] {
    let opacity = |&logit: &f32| 1.0 / (1.0 + f64::from(-logit).exp());
    let scale = |scale: &f32| f64::from(*scale).exp();
    let n = gaussians.len() as f64;
    let scales = gaussians.log_scales.as_flattened().iter().map(scale).sum::<f64>();
    [gaussians.opacity_logits.iter().map(opacity).sum::<f64>() / n, scales / (3.0 * n)]
}

/// The report has the regularisers' value. They lower opacities and scales of all Gaussians, also outside the view.
#[test]
fn regularizers_lower_opacities_and_scales() {
    let mut initial = start();
    // Behind the only camera.
    initial.means[3] = [0.0, 0.0, -500.0];
    let train = |settings: TrainSettings| {
        let mut trainer = Run::shared(views(1, 9), settings).starting_at(&initial).begin();
        (trainer.steps(1).remove(0), trainer.trained())
    };
    let weighted = TrainSettings { opacity_reg: 3.0, scale_reg: 2.0, ..settings() };
    let (report, after) = train(weighted.clone());
    let [opacity, scale] = means(&initial);
    let names: Vec<_> = report.terms.iter().map(|(name, _)| *name).collect();
    assert_eq!(names, ["photometric", "regularizers"]);
    let expected = 3.0 * opacity + 2.0 * scale;
    let value = f64::from(report.terms[1].1);
    assert!((value / expected - 1.0).abs() < 1e-5, "{value}, expected {expected}");
    assert_eq!(report.loss, report.terms[0].1 + report.terms[1].1);
    let lower = |gaussians: &Gaussians, i: usize| {
        let (after, before) = (gaussians.log_scales[i], initial.log_scales[i]);
        gaussians.opacity_logits[i] < initial.opacity_logits[i] && (0..3).all(|k| after[k] < before[k])
    };
    assert!(lower(&after, 3), "outside the view");
    let all = (0..initial.len()).filter(|&i| lower(&after, i)).count();
    assert!(all * 10 > initial.len() * 9, "{all} of {}", initial.len());
    let (report, without) = train(settings());
    assert_eq!(report.terms.len(), 1);
    assert!(!lower(&without, 3));
    let sparse = ashsplat::train::OptimizerType::SparseAdam;
    let (_, sparse) = train(TrainSettings { optimizer_type: sparse, ..weighted });
    assert!(!lower(&sparse, 3), "sparse Adam does not move what is not seen");
}

/// A term with a constant gradient of the inverse depth.
struct Nearer {
    layout: Arc<LayoutConverter>,
    /// Gradient of each pixel, by rows: zero for the colour, a constant for the inverse depth.
    gradient: Buffer,
}

impl LossTerm for Nearer {
    fn name(&self) -> &'static str {
        "nearer"
    }

    fn data(&self) -> TermData {
        TermData { picture: true, inverse_depth: true, ..TermData::default() }
    }

    fn scratch_requests(&self, _: &[(u32, u32)]) -> Vec<(&'static str, u64)> {
        Vec::new()
    }

    fn record(&self, r: &mut Recorder, inputs: &TermInputs) {
        self.layout.record_gradient(r, inputs.frame, &self.gradient, inputs.image_gradient, true);
        r.fill(&inputs.losses.range(16 * u64::from(inputs.row), 16), 0);
    }
}

/// The parts of these settings, with `term` as their only loss term.
fn with_term(context: &Context, settings: &TrainSettings, term: impl LossTerm + 'static) -> TrainParts {
    TrainParts { terms: vec![Box::new(term)], ..TrainParts::of_settings(context, settings).expect("parts") }
}

/// The gradient of the inverse depth reaches the means, in both layouts of pictures.
#[test]
fn a_term_of_the_inverse_depth_moves_gaussians_along_the_view() {
    let wide = View { background: [0.0; 3], ..small_view([64, 48]) };
    let scene = gaussians(&small_scene(&mut Random::new(5), 40, 1));
    let contexts = [options(), ContextOptions { push_descriptors: false, ..options() }];
    for options in contexts {
        let context = Context::new(&options).expect("a device");
        let camera = camera(&wide);
        let layout = Arc::new(LayoutConverter::new(&context).expect("kernels"));
        let moved = |value: f32| {
            let pixels = (camera.width * camera.height) as usize;
            let requests = [("gradient", 16 * pixels as u64)];
            let gradient = context.allocate("test", &requests, MemoryKind::Device).expect("memory").remove(0);
            let texels = vec![[0.0, 0.0, 0.0, value]; pixels];
            context.upload(&gradient, bytemuck::cast_slice(&texels)).expect("uploaded");
            let settings = TrainSettings { sh_degree: 0, ..settings() };
            let nearer = || Nearer { layout: layout.clone(), gradient: gradient.clone() };
            let parts = || with_term(&context, &settings, nearer());
            // The same photometric gradient in both runs, and far smaller than the term's.
            let photo = Photo { width: camera.width, height: camera.height, rgb: vec![0; 3 * pixels] };
            let run = Run::new(&context, vec![TrainView::new(camera, photo)], settings.clone());
            let mut trainer = Run { start: scene.clone(), parts: Some(&parts), ..run }.begin();
            assert_eq!(trainer.steps(1)[0].terms[1], ("nearer", 0.0));
            let after = trainer.trained();
            let depth = |g: &Gaussians, i: usize| {
                (camera.camera_from_world * Vec3::from(g.means[i]) + camera.translation).z
            };
            (0..scene.len()).map(|i| depth(&after, i) - depth(&scene, i)).collect::<Vec<f32>>()
        };
        // The loss decreases as the inverse depth grows, so visible Gaussians come nearer; and vice versa.
        // Occlusions make their opacities matter as well.
        let (nearer, farther) = (moved(-100.0), moved(100.0));
        let seen = nearer.iter().zip(&farther).filter(|(near, far)| **near != 0.0 && **far != 0.0);
        let right = seen.clone().filter(|(near, far)| **near < 0.0 && **far > 0.0).count();
        let all = seen.count();
        assert!(all > 20 && right * 4 >= all * 3, "{right} of {all}");
    }
}

#[derive(Clone)]
struct Probe {
    layout: Arc<LayoutConverter>,
    picture: Buffer,
    photo: Buffer,
}

impl LossTerm for Probe {
    fn name(&self) -> &'static str {
        "probe"
    }

    fn data(&self) -> TermData {
        TermData { picture: true, ..TermData::default() }
    }

    fn scratch_requests(&self, sizes: &[(u32, u32)]) -> Vec<(&'static str, u64)> {
        assert!(!sizes.is_empty());
        vec![("probe", 64)]
    }

    fn record(&self, r: &mut Recorder, inputs: &TermInputs) {
        assert_eq!((inputs.scratch.len(), inputs.row), (1, 1));
        self.layout.record_picture(r, inputs.frame, &self.picture);
        let size = (inputs.frame.camera.width, inputs.frame.camera.height);
        self.layout.record_photo(r, size, inputs.photo_is_masked, inputs.photo, &self.photo);
        r.fill(&inputs.losses.range(16, 16), 0);
    }
}

/// A host's term gets pictures and photographs by rows from a converter, and such a term without a gradient changes nothing.
#[test]
fn a_term_by_rows_sees_the_picture_and_the_photograph() {
    let view = View { background: [0.0; 3], ..small_view([67, 41]) };
    let camera = camera(&view);
    let (scene, pixels) = (gaussians(&small_scene(&mut Random::new(9), 60, 9)), 67 * 41);
    let rgb: Vec<u8> = (0..3 * pixels).map(|k| (k * 37) as u8).collect();
    // A whole tile is hidden, which only frames without the term leave out.
    let hidden = |k: usize| k.is_multiple_of(5) || [k % 67, k / 67].iter().all(|at| (16..32).contains(at));
    let mask: Vec<u8> = (0..pixels).map(|k| if hidden(k) { 0 } else { 200 }).collect();
    for (push_descriptors, masked) in [(true, false), (true, true), (false, false), (false, true)] {
        let context = Context::new(&ContextOptions { push_descriptors, ..options() }).expect("a device");
        let photo = Photo { width: 67, height: 41, rgb: rgb.clone() };
        let stored = StoredPhoto::new(photo, masked.then(|| mask.clone()));
        let requests = [("picture", 16 * pixels as u64), ("photo", 4 * pixels as u64)];
        let buffers = context.allocate("test", &requests, MemoryKind::Device).expect("memory");
        let (picture, photo) = (&buffers[0], &buffers[1]);
        let settings = TrainSettings { white_background: true, ..settings() };
        let layout = Arc::new(LayoutConverter::new(&context).expect("kernels"));
        let probe = Probe { layout, picture: picture.clone(), photo: photo.clone() };
        let probed = || with_term(&context, &settings, probe.clone());
        let train = |parts: Option<&dyn Fn() -> TrainParts>| {
            let run = Run::new(&context, vec![TrainView::new(camera, stored.clone())], settings.clone());
            let mut trainer = Run { start: scene.clone(), parts, ..run }.begin();
            let white = trainer.render_settings();
            let before = trainer.render(&camera, &white).expect("a picture").color;
            trainer.steps(1);
            (before, trainer.state().fingerprint())
        };
        let (expected, fingerprint) = train(Some(&probed));
        let bytes = context.download(picture).expect("downloaded");
        for (actual, expected) in bytemuck::pod_collect_to_vec::<u8, [f32; 4]>(&bytes).iter().zip(&expected) {
            let off = (0..3).map(|k| (actual[k] - expected[k]).abs()).fold(0.0, f32::max);
            assert!(off < 1e-6, "{actual:?}, expected {expected:?}");
        }
        let texels = context.download(photo).expect("downloaded");
        for (pixel, actual) in texels.as_chunks::<4>().0.iter().enumerate() {
            let expected = [rgb[3 * pixel], rgb[3 * pixel + 1], rgb[3 * pixel + 2]];
            match masked {
                true if mask[pixel] == 0 => assert_eq!(actual[3], 0),
                true => assert_eq!(*actual, [expected[0], expected[1], expected[2], 255]),
                false => assert_eq!(actual[..3], expected),
            }
        }
        assert_eq!(fingerprint, train(None).1, "the term has no gradient");
    }
}

const REMOVED: u32 = 9;

/// Requests absolute statistics if `absolute`. After every `every` iterations it removes Gaussians, drawn in
/// proportion to their importance.
struct Watching {
    absolute: bool,
    every: u32,
    kernels: (Densify, Importance, UniqueDraw),
    /// Largest importance so far.
    largest: f32,
}

impl Watching {
    fn parts(context: &Context, absolute: bool, every: u32) -> TrainParts {
        let kernels = (
            Densify::new(context, DensifyForm::default()).expect("kernels"),
            Importance::new(context, &settings().render_settings()).expect("kernels"),
            UniqueDraw::new(context).expect("kernels"),
        );
        parts_of(Self { absolute, every, kernels, largest: 0.0 })
    }
}

impl Strategy for Watching {
    fn name(&self) -> &'static str {
        "watching"
    }

    fn work(&self, _: &TrainSettings, iteration: u32) -> StepWork {
        let actions = Actions::DENSIFY.when(iteration.is_multiple_of(self.every));
        StepWork { accumulates: iteration % 7 != 3, ..optimizing(actions) }
    }

    fn absolute_gradients(&self) -> bool {
        self.absolute
    }

    fn between_steps(&mut self, population: &mut Population, _: Actions) -> Result<Changes> {
        let (densify, importance, unique_draw) = &self.kernels;
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
        let buffers = context.allocate(
            "densify",
            &UniqueDrawBuffers::requests(&LaunchSizes::new(context.limits()), before),
            MemoryKind::Device,
        )?;
        let buffers = UniqueDrawBuffers::from_allocated(buffers);
        let statistics = population.statistics();
        let draw = UniqueDrawInputs {
            count: before,
            wanted: REMOVED,
            candidates: Candidates { statistics, threshold: 0.0 },
            chances: Chances::Importance(&values),
            seed: population.settings().seed,
            iteration: population.iteration(),
        };
        context.run("select", |r| unique_draw.record(r, &draw, &buffers))?;
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

fn run(
    context: &Context,
    views: Vec<TrainView>,
    (absolute, every): (bool, u32),
    stops: &[u32],
) -> Checkpoint {
    let parts = || Watching::parts(context, absolute, every);
    Run::new(context, views, settings()).with_parts(&parts).end(stops)
}

/// Sums of absolute gradients are never below those of signed ones, and change no bit of the training.
#[test]
fn absolute_gradients_leave_the_training_as_it_is() {
    let of = |absolute| run(context(), views(3, 9), (absolute, u32::MAX), &[]);
    let (without, with) = (of(false), of(true));
    assert!(without.gaussians == with.gaussians && without.moments == with.moments);
    let pairs = || without.statistics.iter().zip(&with.statistics);
    assert!(pairs().all(|([signed, views], [absolute, seen])| *absolute >= signed * 0.9999 && views == seen));
    assert!(pairs().filter(|([signed, _], [absolute, _])| *absolute > 1.5 * signed).count() > 20);
    // Same number of views: three of the iterations do not count.
    let max = with.statistics.iter().fold(0.0_f32, |max, statistic| max.max(statistic[1]));
    assert_eq!(max, (settings().iterations - 3) as f32);
}

#[test]
fn importance_draws_the_same_gaussians_in_a_resumed_run_and_from_photographs_in_a_file() {
    let whole = run(context(), views(3, 9), (true, 6), &[]);
    assert_eq!(whole.gaussians.len(), start().len() - 3 * REMOVED as usize);
    let largest: f32 = whole.strategy.values[0].1.parse().expect("a number");
    assert!((1.0 / 3.0..=1.00001).contains(&largest), "{largest}");
    for stops in [[5, 6], [12, 13]] {
        let resumed = run(context(), views(3, 9), (true, 6), &stops);
        assert!(resumed == whole, "interrupted after {stops:?}: other bits");
    }
    let streamed = run(context(), in_a_file(&views(3, 9), 5), (true, 6), &[]);
    assert!(streamed.fingerprint() == whole.fingerprint());
}

/// A training that requests the importance after each iteration, and whether there was memory for it.
fn asking(context: &Context, views_asked: &[usize]) -> (Trainer, Arc<Mutex<Vec<bool>>>) {
    let answers: Arc<Mutex<Vec<bool>>> = Arc::default();
    let kernels = Importance::new(context, &settings().render_settings()).expect("kernels");
    let (asked, noted) = (views_asked.to_vec(), Arc::clone(&answers));
    let parts = between(move |population| {
        let there = population.importance(&kernels, &asked)?.is_some();
        noted.lock().expect("one thread").push(there);
        Ok(())
    });
    let trainer = Trainer::with_parts(context, views(3, 9), &start(), EXTENT, settings(), parts);
    (trainer.expect("a trainer"), answers)
}

/// All of its memory is counted: without memory there is no importance, and the training continues.
#[test]
fn importance_keeps_within_a_bounded_memory() {
    let of = |max_memory: Option<u64>| {
        let context = bounded(max_memory);
        let (mut trainer, answers) = asking(&context, &[0, 1, 2]);
        trainer.steps(1);
        let staged = context.free_staging();
        let before = trainer.context().memory_total().bytes;
        trainer.steps(1);
        let there = answers.lock().expect("one thread")[0];
        (before, context.memory_total().peak_bytes, there, trainer.trained(), staged)
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
    for (views_asked, word) in [(vec![0, 3], "[0, 3]"), (vec![], "[]")] {
        let (mut trainer, _) = asking(context(), &views_asked);
        trainer.steps(1);
        assert_says(refusal(trainer.step()), &[word, "views"]);
    }
}
