//! Exchangeable parts of training: a strategy and loss terms that the library does not have.

use ashsplat::densify::Densify;
use ashsplat::loss::{LossTerm, PixelLayout, Targets, TermInputs};
use ashsplat::scene::StoredPhoto;
use ashsplat::trainer::strategy::{Changes, Hooks, Statistic, StepInputs, Work};
use ashsplat::trainer::{
    Actions, Checkpoint, Densified, Population, Regularizers, Strategy, TrainParts, Trainer,
};
use ashsplat::vk::{Buffer, Context, ContextOptions, MemoryKind, Recorder};
use ashsplat::{Gaussians, Result, TrainSettings, TrainView};
use ashsplat_files::{CheckpointFile, Photo};

use crate::checkpoints::{start, views};
use crate::common::engine::{camera, gaussians};
use crate::common::gpu::Gpu;
use crate::common::options;
use crate::common::scenes::{Random, small_scene, small_view};
use crate::reference::types::View;

const EXTENT: f32 = 5.0;
/// An action of this strategy only.
const PRUNE: Actions = Actions(1 << 7);

/// After every fourth iteration, removes each Gaussian with a probability of a tenth.
struct RandomPrune {
    kernels: Densify,
    pruned: u32,
}

impl RandomPrune {
    fn parts(context: &Context) -> TrainParts {
        let kernels = Densify::new(context).expect("kernels");
        TrainParts { strategy: Box::new(Self { kernels, pruned: 0 }), terms: Vec::new(), block: None }
    }
}

impl Strategy for RandomPrune {
    fn name(&self) -> &'static str {
        "random_prune"
    }

    fn work(&self, _: &TrainSettings, iteration: u32) -> Work {
        let actions = PRUNE.when(iteration.is_multiple_of(4));
        Work { accumulates: true, optimizes: true, sums_gradients: false, optimizes_opacity: true, actions }
    }

    fn statistics(&self) -> Vec<Statistic> {
        vec![Statistic { name: "iteration", floats: 3 }]
    }

    fn records(&self) -> Hooks {
        Hooks { statistics: true, update: true, ..Hooks::default() }
    }

    fn record_statistics(&self, r: &mut Recorder, step: &StepInputs) {
        r.fill(&step.statistics[1], (step.iteration as f32).to_bits());
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
    TrainSettings { iterations: 20, sh_degree: 2, sh_degree_interval: 5, seed: 4, ..TrainSettings::default() }
}

#[test]
fn a_strategy_of_a_host_prunes_and_resumes_to_the_bit() {
    let gpu = Gpu::new();
    let parts = || RandomPrune::parts(gpu.context);
    let mut trainer = Trainer::with_parts(gpu.context, views(3, 9), &start(), EXTENT, settings(), parts())
        .expect("a trainer");
    let folder = tempfile::tempdir().expect("a temporary folder");
    let file = folder.path().join("8.safetensors");
    let mut count = start().len() as u32;
    for iteration in 1..=20 {
        let report = trainer.step().expect("a step");
        assert_eq!(report.densified.is_some(), iteration > 4 && iteration % 4 == 1, "{iteration}");
        if let Some(densified) = report.densified {
            assert_eq!((densified.before, densified.kept), (count, report.gaussians));
            assert!(densified.kept < densified.before);
            count = densified.kept;
        }
        if iteration == 8 {
            let checkpoint = trainer.checkpoint().expect("a checkpoint");
            assert_eq!(checkpoint.due, PRUNE);
            checkpoint.write(&file).expect("written");
        }
    }
    let end = trainer.checkpoint().expect("a checkpoint");
    let own = &end.strategy.statistics[0];
    assert_eq!((own.name.as_str(), own.floats, own.values.len()), ("iteration", 3, 3 * count as usize));
    assert!(own.values.iter().all(|&value| value == 20.0));
    let read = Checkpoint::read(&file).expect("read back");
    assert!(read.strategy.values[0].1.parse::<u32>().expect("a number") > 0);
    let given = || (settings(), EXTENT);
    let mut resumed =
        Trainer::resume_with_parts(gpu.context, views(3, 9), given(), parts(), &read).expect("resumed");
    for _ in 8..20 {
        resumed.step().expect("a step");
    }
    let other = resumed.checkpoint().expect("a checkpoint");
    assert_eq!(other.strategy, end.strategy);
    assert_eq!(other.fingerprint(), end.fingerprint());
    // The library's own strategy has no such state.
    let refused =
        Trainer::resume(gpu.context, views(3, 9), EXTENT, settings(), &read).err().expect("refused");
    assert!(refused.to_string().contains("strategy 'random_prune'"), "{refused}");
    // A run with other loss terms is a different run.
    let terms: Vec<Box<dyn LossTerm>> =
        vec![Box::new(Regularizers::new(gpu.context, 1.0, 0.0).expect("kernels"))];
    let other = TrainParts { terms, ..parts() };
    let refused = Trainer::resume_with_parts(gpu.context, views(3, 9), given(), other, &read).err();
    let refused = refused.expect("refused").to_string();
    assert!(refused.contains("regularizers"), "{refused}");
}

/// Keeping a missing Gaussian, or none, is refused, and the set stays.
struct Wrong {
    kernels: Densify,
}

impl Strategy for Wrong {
    fn name(&self) -> &'static str {
        "wrong"
    }

    fn work(&self, _: &TrainSettings, _: u32) -> Work {
        Work {
            accumulates: false,
            optimizes: true,
            sums_gradients: false,
            optimizes_opacity: true,
            actions: PRUNE,
        }
    }

    fn between_steps(&mut self, population: &mut Population, _: Actions) -> Result<Changes> {
        let beyond = population.count();
        for (kept, problem) in
            [(vec![0, beyond], "there are"), (vec![], "must be 1 to"), (vec![2, 2], "twice")]
        {
            let refused = population.keep(&kept, &self.kernels).expect_err("refused");
            assert!(refused.to_string().contains(problem), "{refused}");
        }
        assert_eq!(population.count(), beyond);
        Ok(Changes::default())
    }
}

#[test]
fn a_strategy_cannot_keep_what_does_not_exist() {
    let gpu = Gpu::new();
    let strategy = Box::new(Wrong { kernels: Densify::new(gpu.context).expect("kernels") });
    let parts = TrainParts { strategy, terms: Vec::new(), block: None };
    let mut trainer = Trainer::with_parts(gpu.context, views(2, 9), &start(), EXTENT, settings(), parts)
        .expect("a trainer");
    for _ in 0..2 {
        trainer.step().expect("a step");
    }
    assert_eq!(trainer.gaussians().expect("Gaussians").len(), start().len());
}

/// The `fixed` strategy keeps the number of Gaussians at iterations when the reference's would densify.
#[test]
fn the_fixed_strategy_keeps_the_number_of_gaussians() {
    let gpu = Gpu::new();
    let early = TrainSettings {
        densify_from_iter: 1,
        densification_interval: 2,
        densify_grad_threshold: 1e-9,
        ..settings()
    };
    let count = |strategy| {
        let settings = TrainSettings { strategy, ..early.clone() };
        let mut trainer =
            Trainer::new(gpu.context, views(2, 9), &start(), EXTENT, settings).expect("a trainer");
        (0..6).for_each(|_| drop(trainer.step().expect("a step")));
        trainer.gaussians().expect("Gaussians").len()
    };
    use ashsplat::trainer::StrategyType::{Fixed, Reference};
    assert_eq!(count(Fixed), start().len());
    assert!(count(Reference) > start().len());
}

/// Mean opacity and mean scale.
fn means(gaussians: &Gaussians) -> [f64; 2] {
    let opacity = |&logit: &f32| 1.0 / (1.0 + f64::from(-logit).exp());
    let scale = |scale: &f32| f64::from(*scale).exp();
    let n = gaussians.len() as f64;
    let scales = gaussians.log_scales.iter().flat_map(|scale| scale.as_ref().iter());
    [
        gaussians.opacity_logits.iter().map(opacity).sum::<f64>() / n,
        scales.map(scale).sum::<f64>() / (3.0 * n),
    ]
}

/// The report has the regularisers' value. They lower opacities and scales of all Gaussians, also outside the view.
#[test]
fn regularizers_lower_opacities_and_scales() {
    let gpu = Gpu::new();
    let mut initial = start();
    // Behind the only camera.
    initial.means[3] = [0.0, 0.0, -500.0];
    let train = |settings: TrainSettings| {
        let mut trainer =
            Trainer::new(gpu.context, views(1, 9), &initial, EXTENT, settings).expect("a trainer");
        let report = trainer.step().expect("a step");
        (report, trainer.gaussians().expect("Gaussians"))
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
        let falls = gaussians.log_scales[i].as_ref().iter().zip(initial.log_scales[i].as_ref());
        gaussians.opacity_logits[i] < initial.opacity_logits[i]
            && falls.into_iter().all(|(after, before)| after < before)
    };
    assert!(lower(&after, 3), "outside the view");
    let all = (0..initial.len()).filter(|&i| lower(&after, i)).count();
    assert!(all * 10 > initial.len() * 9, "{all} of {}", initial.len());
    let (report, without) = train(settings());
    assert_eq!(report.terms.len(), 1);
    assert!(!lower(&without, 3));
    let sparse = ashsplat::trainer::OptimizerType::SparseAdam;
    let (_, sparse) = train(TrainSettings { optimizer_type: sparse, ..weighted });
    assert!(!lower(&sparse, 3), "sparse Adam does not move what is not seen");
}

/// A term with a constant gradient of the inverse depth.
struct Nearer {
    /// Gradient of each pixel: zero for the colour, a constant for the inverse depth.
    gradient: Buffer,
}

impl LossTerm for Nearer {
    fn name(&self) -> &'static str {
        "nearer"
    }

    fn targets(&self) -> Targets {
        Targets { picture: Some(PixelLayout::Rows), inverse_depth: true, ..Targets::default() }
    }

    fn scratch_requests(&self, _: &[(u32, u32)]) -> Vec<(&'static str, u64)> {
        Vec::new()
    }

    fn record(&self, r: &mut Recorder, inputs: &TermInputs) {
        r.copy(&self.gradient, &inputs.image_gradient.range(0, self.gradient.bytes()));
        r.fill(&inputs.losses.range(16 * u64::from(inputs.row), 16), 0);
    }
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
        let moved = |value: f32| {
            let pixels = (camera.width * camera.height) as usize;
            let texels = vec![[0.0, 0.0, 0.0, value]; pixels];
            let bytes = 16 * pixels as u64;
            let gradient = context.allocate("test", &[("gradient", bytes)], MemoryKind::Device);
            let gradient = gradient.expect("memory").remove(0);
            context.upload(&gradient, bytemuck::cast_slice(&texels)).expect("uploaded");
            let parts = TrainParts {
                terms: vec![Box::new(Nearer { gradient })],
                ..TrainParts::of_settings(&context, &settings()).expect("parts")
            };
            // The same photometric gradient in both runs, and far smaller than the term's.
            let rgb = vec![0; 3 * pixels];
            let photo = Photo { width: camera.width, height: camera.height, rgb };
            let settings = TrainSettings { sh_degree: 0, ..settings() };
            let view = TrainView::new(camera, photo);
            let mut trainer = Trainer::with_parts(&context, vec![view], &scene, EXTENT, settings, parts)
                .expect("a trainer");
            let report = trainer.step().expect("a step");
            assert_eq!(report.terms[1], ("nearer", 0.0));
            let after = trainer.gaussians().expect("Gaussians");
            let depth = |g: &Gaussians, i: usize| {
                (camera.camera_from_world * glam::Vec3::from(g.means[i]) + camera.translation).z
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

/// A term that keeps its inputs.
struct Probe {
    picture: Buffer,
    photo: Buffer,
}

impl LossTerm for Probe {
    fn name(&self) -> &'static str {
        "probe"
    }

    fn targets(&self) -> Targets {
        Targets { picture: Some(PixelLayout::Rows), ..Targets::default() }
    }

    fn scratch_requests(&self, sizes: &[(u32, u32)]) -> Vec<(&'static str, u64)> {
        assert!(!sizes.is_empty());
        vec![("probe", 64)]
    }

    fn record(&self, r: &mut Recorder, inputs: &TermInputs) {
        assert_eq!((inputs.scratch.len(), inputs.row), (1, 1));
        r.copy(&inputs.picture.range(0, self.picture.bytes()), &self.picture);
        r.copy(&inputs.photo.range(0, self.photo.bytes()), &self.photo);
        r.fill(&inputs.losses.range(16, 16), 0);
    }
}

/// Pictures and photographs have one layout for a host's terms, and such a term without a gradient changes nothing.
#[test]
fn a_term_by_rows_sees_the_picture_and_the_photograph() {
    let view = View { background: [0.0; 3], ..small_view([67, 41]) };
    let camera = camera(&view);
    let (scene, pixels) = (gaussians(&small_scene(&mut Random::new(9), 60, 9)), 67 * 41);
    let rgb: Vec<u8> = (0..3 * pixels).map(|k| (k * 37) as u8).collect();
    let mask: Vec<u8> = (0..pixels).map(|k| if k % 5 == 0 { 0 } else { 200 }).collect();
    for (push_descriptors, masked) in [(true, false), (true, true), (false, false), (false, true)] {
        let context = Context::new(&ContextOptions { push_descriptors, ..options() }).expect("a device");
        let photo = Photo { width: 67, height: 41, rgb: rgb.clone() };
        let stored = StoredPhoto::new(photo, masked.then(|| mask.clone()));
        let requests = [("picture", 16 * pixels as u64), ("photo", 4 * pixels as u64)];
        let buffers = context.allocate("test", &requests, MemoryKind::Device).expect("memory");
        let (picture, photo) = (&buffers[0], &buffers[1]);
        let settings = TrainSettings { white_background: true, ..settings() };
        let train = |terms: Vec<Box<dyn LossTerm>>| {
            let parts = TrainParts { terms, ..TrainParts::of_settings(&context, &settings).expect("parts") };
            let views = vec![TrainView::new(camera, stored.clone())];
            let mut trainer = Trainer::with_parts(&context, views, &scene, EXTENT, settings.clone(), parts)
                .expect("a trainer");
            let white = trainer.render_settings();
            let before = trainer.render(&camera, &white).expect("a picture").color;
            trainer.step().expect("a step");
            (before, trainer.checkpoint().expect("a checkpoint").fingerprint())
        };
        let probe = Probe { picture: picture.clone(), photo: photo.clone() };
        let (expected, fingerprint) = train(vec![Box::new(probe)]);
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
        assert_eq!(fingerprint, train(Vec::new()).1, "the term has no gradient");
    }
}
