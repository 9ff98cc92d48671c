//! Training of a scene block: its frozen neighbours are drawn and do not change.

use crate::common::prelude::*;
use crate::common::training::{forecast, photo_size, settings, without_rates};
use ashsplat::scene::{Bounds, Intrinsics};
use ashsplat::train::{SceneBlock, TrainParts};
use std::collections::HashSet;

/// Half of the scene, minus a margin.
fn core() -> Bounds {
    Bounds { min: Vec3::new(f32::NEG_INFINITY, -1.2, f32::NEG_INFINITY), max: Vec3::new(0.2, 1.3, 9.0) }
}

const MARGIN: f32 = 0.3;

fn everything() -> Bounds {
    Bounds { min: Vec3::NEG_INFINITY, max: Vec3::INFINITY }
}

fn divided() -> (Gaussians, SceneBlock) {
    let (trained, block) = SceneBlock::divide(&start(), core(), MARGIN).expect("a block");
    assert!(trained.len() > 40 && block.frozen.len() > 40, "{} {}", trained.len(), block.frozen.len());
    (trained, block)
}

fn with_run<T>(
    context: &Context,
    initial: &Gaussians,
    block: Option<&SceneBlock>,
    settings: &TrainSettings,
    act: impl FnOnce(&Run) -> T,
) -> T {
    let parts = || {
        let of_settings = TrainParts::of_settings(context, settings).expect("parts");
        TrainParts { block: block.cloned(), ..of_settings }
    };
    let run = Run::new(context, views(3, 9), settings.clone());
    act(&Run { start: initial.clone(), parts: Some(&parts), ..run })
}

fn trainer(
    context: &Context,
    initial: &Gaussians,
    block: Option<&SceneBlock>,
    settings: &TrainSettings,
) -> Trainer {
    with_run(context, initial, block, settings, |run| run.begin())
}

fn end(trainer: &mut Trainer) -> Checkpoint {
    trainer.finish();
    trainer.state()
}

fn inside(core: Bounds, mean: [f32; 3]) -> bool {
    SceneBlock::contains(core, 0.0, mean)
}

/// Without borders, nothing but plain training runs. With far borders the mask runs, and masks nothing.
#[test]
fn a_block_that_is_the_whole_scene_is_plain_training() {
    for strategy in [StrategyType::Reference, StrategyType::Budget] {
        let settings =
            TrainSettings { strategy, absgrad: strategy == StrategyType::Budget, cap_max: 220, ..settings() };
        let run = |core: Option<Bounds>| {
            let divided = core.map(|core| SceneBlock::divide(&start(), core, 0.0).expect("a block"));
            let (initial, block) = divided.map_or((start(), None), |(initial, block)| (initial, Some(block)));
            with_run(context(), &initial, block.as_ref(), &settings, |run| run.end(&[]))
        };
        let plain = run(None);
        assert!(plain.gaussians.len() != start().len(), "nothing was added");
        assert!(run(Some(everything())) == plain, "{strategy:?}: other bits");
        let far = run(Some(Bounds { min: Vec3::splat(-1e9), max: Vec3::splat(1e9) }));
        assert!(far.block.is_some());
        assert!(Checkpoint { block: None, ..far } == plain, "{strategy:?}: other bits with far borders");
    }
}

/// The picture equals that of the whole scene, bit for bit, and so does the first step of the trained Gaussians.
#[test]
fn the_first_step_of_a_block_is_that_of_the_whole_scene() {
    let (initial, block) = divided();
    for filter_3d in [false, true] {
        let settings = TrainSettings { filter_3d, ..settings() };
        let mut whole = initial.clone();
        whole.append(&block.frozen);
        let mut of_block = trainer(context(), &initial, Some(&block), &settings);
        let mut of_whole = trainer(context(), &whole, None, &settings);
        let camera = views(3, 9)[1].camera;
        let render_settings = of_block.render_settings();
        let picture = |trainer: &mut Trainer| trainer.render(&camera, &render_settings).expect("a picture");
        let pictures = [picture(&mut of_block), picture(&mut of_whole)];
        assert!(pictures[0].color == pictures[1].color, "other pictures");
        assert_eq!(pictures[0].stats.gaussians, whole.len() as u32);
        if !filter_3d {
            let alone = loaded(context(), &initial).render(&camera, &render_settings).expect("a picture");
            assert!(alone.color != pictures[0].color, "nothing of the rest is to be seen");
        }
        let losses = [&mut of_block, &mut of_whole].map(|trainer| trainer.steps(1)[0].loss.to_bits());
        assert_eq!(losses[0], losses[1]);
        let [ours, theirs] = [of_block, of_whole].map(|trainer| trainer.state());
        let rows: Vec<usize> = (0..initial.len()).collect();
        assert!(ours.gaussians == theirs.gaussians.select(&rows), "other bits");
        let sh_degree = ours.gaussians.sh_degree;
        assert!(ours.moments == theirs.moments.select(&rows, sh_degree), "other bits of moments");
        assert!(ours.gaussians != initial, "nothing has moved");
        assert_eq!(ours.statistics[..], theirs.statistics[..initial.len()]);
    }
}

#[test]
fn what_lies_around_stays_as_it_is() {
    let (initial, block) = divided();
    let mut trainer = trainer(context(), &initial, Some(&block), &settings());
    let state = end(&mut trainer);
    assert!(state.gaussians.len() > initial.len(), "nothing was added");
    let around = trainer.surroundings().expect("Gaussians around").download().expect("downloaded");
    assert!(around == block.frozen.with_sh_degree(around.sh_degree));
    let memory = trainer.memory();
    let arena = |name: &str| memory.iter().filter(|arena| arena.name == name).map(|arena| arena.bytes).sum();
    let (parameters, moments): (u64, u64) = (arena("surroundings"), arena("moments"));
    assert!(parameters > 0 && moments == 2 * arena("scene"), "{parameters} {moments}");
}

/// Half of the frozen Gaussians are out of all views. Checkpoints with and without them can resume each other.
#[test]
fn what_no_view_sees_can_be_left_out() {
    let (initial, mut block) = divided();
    block.frozen.means.iter_mut().step_by(2).for_each(|mean| mean[1] += 900.0);
    let cameras: Vec<Camera> = views(3, 9).iter().map(|view| view.camera).collect();
    for (warm_up, kernel_size) in [(0, 0.3), (8, 3.0)] {
        let settings = TrainSettings { warm_up, kernel_size, ..settings() };
        let left = block.clone().without_invisible(&cameras, &settings);
        let [all, seen] = [&block, &left].map(|block| block.frozen.len());
        assert!(2 * seen <= all && seen > 20, "{seen} of {all}");
        assert_eq!(left.clone().without_invisible(&cameras, &settings), left);
        let [(_, whole), (middle, less)] = [&block, &left].map(|block| {
            let mut trainer = trainer(context(), &initial, Some(block), &settings);
            trainer.steps(15);
            (trainer.state(), end(&mut trainer))
        });
        assert!(whole.gaussians.len() > initial.len() && whole.block == less.block);
        let same =
            |a: &Checkpoint, b: &Checkpoint| Checkpoint { capacities: b.capacities, ..a.clone() } == *b;
        assert!(same(&less, &whole), "warm-up {warm_up}: other bits");
        let resume = |run: &Run| run.resume(&middle);
        let mut second = with_run(context(), &initial, Some(&block), &settings, resume);
        assert!(same(&end(&mut second), &whole), "warm-up {warm_up}: other bits");
    }
    let filtered = TrainSettings { filter_3d: true, ..settings() };
    assert!(block.clone().without_invisible(&cameras, &filtered) == block);
    let nobody = block.without_invisible(&[], &settings());
    let poses = TrainSettings { pose_opt: true, ..settings() };
    let refused = with_run(context(), &initial, Some(&nobody), &poses, |run| refusal(run.try_begin()));
    assert_says(&refused, &["pose_opt"]);
    assert!(nobody.frozen.is_empty());
    end(&mut trainer(context(), &initial, Some(&nobody), &settings()));
}

/// With rates of 0 a clone equals its original, and a split original is gone.
#[test]
fn gaussians_are_added_in_the_core_only() {
    let (initial, block) = divided();
    let still = |strategy, percent_dense| TrainSettings {
        min_opacity: 1e-9,
        percent_dense,
        strategy,
        cap_max: 10_000,
        densify_grad_threshold: 1e-9,
        ..without_rates(settings())
    };
    for (settings, clones) in [
        (still(StrategyType::Reference, 1e3), true),
        (still(StrategyType::Reference, 1e-9), false),
        (TrainSettings { absgrad: true, ..still(StrategyType::Reference, 1e-9) }, false),
        (TrainSettings { absgrad: true, ..still(StrategyType::Budget, 1e-9) }, false),
    ] {
        let key = |mean: &[f32; 3]| mean.map(f32::to_bits);
        // Means of the cloned or split Gaussians.
        let chosen = |block: &SceneBlock| -> Vec<[f32; 3]> {
            let mut trainer = trainer(context(), &initial, Some(block), &settings);
            let densified = trainer.steps(16).iter().rev().find_map(|report| report.densified);
            let densified = densified.expect("a densification");
            assert_eq!((densified.cloned > 0, densified.split > 0), (clones, !clones), "{densified:?}");
            let after = trainer.trained().means;
            let mut seen = HashSet::new();
            match clones {
                true => after.into_iter().filter(|mean| !seen.insert(key(mean))).collect(),
                false => {
                    seen.extend(after.iter().map(key));
                    initial.means.iter().copied().filter(|mean| !seen.contains(&key(mean))).collect()
                }
            }
        };
        let of_block = chosen(&block);
        assert!(of_block.len() > 10, "{} of {:?}", of_block.len(), settings.strategy);
        assert!(of_block.iter().all(|&mean| inside(core(), mean)), "{:?}", settings.strategy);
        // Without a border, some of these Gaussians are outside.
        let free = SceneBlock { core: everything(), ..block.clone() };
        assert!(chosen(&free).iter().any(|&mean| !inside(core(), mean)));
    }
}

#[test]
fn a_resumed_block_ends_with_the_same_bits() {
    let (initial, block) = divided();
    let settings = settings();
    let stops: [&[u32]; 4] = [&[7], &[15], &[20], &[30]];
    let checkpoint = with_run(context(), &initial, Some(&block), &settings, |run| {
        run.check_stops(&stops);
        run.until(30, &[])
    });
    let mut moved = block.clone();
    moved.frozen.means[3][0] += 1e-3;
    let wider = SceneBlock { core: everything(), ..block.clone() };
    for (other, said) in [
        (None, "the whole scene is trained"),
        (Some(moved), "other Gaussians around the block"),
        (Some(wider), "was made for the block -inf,-1.2,-inf,0.2,1.3,9, here the block -inf,"),
    ] {
        let refused = |run: &Run| refusal(run.try_resume(&checkpoint));
        assert_says(with_run(context(), &initial, other.as_ref(), &settings, refused), &[said]);
    }
}

#[test]
fn senseless_blocks_are_refused() {
    let (initial, block) = divided();
    let refused = |settings: &TrainSettings, block: &SceneBlock, word: &str| {
        let said = with_run(context(), &initial, Some(block), settings, |run| refusal(run.try_begin()));
        assert_says(&said, &[word]);
    };
    let mcmc = TrainSettings::of_strategy(StrategyType::Mcmc);
    refused(&mcmc, &block, "'mcmc' adds Gaussians anywhere");
    let poses = TrainSettings { pose_opt: true, ..settings() };
    refused(&poses, &block, "pose_opt");
    let flat = SceneBlock { core: Bounds { min: Vec3::ONE, max: Vec3::ONE }, ..block.clone() };
    refused(&settings(), &flat, "block");
    let mut short = block.clone();
    short.frozen.sh.pop();
    refused(&settings(), &short, "");
    let alone = SceneBlock { frozen: Gaussians::default(), ..block.clone() };
    refused(&mcmc, &alone, "'mcmc' adds Gaussians anywhere");
    let mut trainer = trainer(context(), &initial, Some(&block), &settings());
    let TrainView { camera, photo, .. } = views(1, 9).remove(0);
    let render_settings = trainer.render_settings();
    let align =
        |renderer: &mut Renderer| renderer.align(&camera, &photo, &render_settings, &Default::default());
    assert_says(refusal(trainer.draw(align)), &["an alignment is of one alone, and 2 are drawn"]);
}

/// The forecast suffices. It counts frozen Gaussians with parameters and frames, but no moments.
#[test]
fn the_memory_of_what_lies_around_is_planned() {
    let (initial, block) = divided();
    let settings = settings();
    let needed = |gaussians: u32, frozen: u32| {
        let photos = vec![photo_size("a", [40, 30]); 3];
        let (bytes, what) = forecast(&settings, &photos, [gaussians, frozen], &bounded(Some(1)));
        assert_eq!(what.contains(" others"), frozen > 0, "{what}");
        bytes
    };
    let (count, frozen) = (initial.len() as u32, 100_000);
    let alone = needed(count, 0);
    let [around, trained] = [needed(count, frozen), needed(count + frozen, 0)].map(|bytes| bytes - alone);
    // Ten planes of parameters at SH degree 2.
    assert!(around > u64::from(frozen) * 160, "{around}");
    // Two moments of each parameter.
    assert!(trained > around + u64::from(frozen) * 2 * 160, "{around} {trained}");
    // Enough for a run, and for some of the Gaussians that it adds.
    let mut many = block.clone();
    (0..200).for_each(|_| many.frozen.append(&block.frozen));
    let bound = needed(count, many.frozen.len() as u32) + (1 << 20);
    let context = bounded(Some(bound));
    let mut trainer = trainer(&context, &initial, Some(&many), &settings);
    end(&mut trainer);
    assert!(trainer.memory().last().expect("the total").peak_bytes <= bound);
}

/// A camera far away from the block.
#[test]
fn a_picture_of_what_lies_around_alone_is_drawn() {
    let (initial, block) = divided();
    let mut far = initial.clone();
    far.means.iter_mut().for_each(|mean| mean[0] -= 1e4);
    let block = SceneBlock { core: everything(), ..block };
    let mut trainer = trainer(context(), &far, Some(&block), &settings());
    let intrinsics = Intrinsics::from_fov_x(0.8, 40, 30);
    let camera = Camera::look_at(Vec3::new(0.0, 0.0, -6.0), Vec3::ZERO, Vec3::NEG_Y, intrinsics);
    let settings = trainer.render_settings();
    let ours = trainer.render(&camera, &settings).expect("a picture");
    let mut renderer = loaded(context(), &block.frozen);
    let settings = RenderSettings { sh_degree: Some(trainer.sh_degree()), ..settings };
    let theirs = renderer.render(&camera, &settings).expect("a picture");
    assert!(ours.color == theirs.color && theirs.stats.visible > 0);
}

/// All values that a checkpoint keeps for a Gaussian move with it, in every strategy.
#[test]
fn gaussians_go_from_one_checkpoint_to_another_with_all_that_is_kept_of_them() {
    let settings = TrainSettings {
        strategy: StrategyType::Budget,
        absgrad: true,
        cap_max: 400,
        filter_3d: true,
        ..settings()
    };
    let run = Run::shared(views(3, 9), settings.clone());
    let whole = run.until(12, &[]);
    assert!(whole.filters.len() == whole.gaussians.len());
    let kept = |of: &Checkpoint, rows: &[usize]| {
        let mut kept = of.clone();
        kept.keep(rows);
        kept
    };
    let all: Vec<usize> = (0..whole.gaussians.len()).collect();
    assert!(kept(&whole, &all) == whole);
    let [even, odd]: [Vec<usize>; 2] =
        [0, 1].map(|rest| all.iter().copied().filter(|row| row % 2 == rest).collect());
    let mut joined = kept(&whole, &odd);
    joined.append(&kept(&whole, &even)).expect("of the same settings");
    joined.check().expect("whole");
    assert!(joined == kept(&whole, &[&odd[..], &even[..]].concat()) && joined != whole);
    // Training resumes with them, with capacity for their number.
    let (core, frozen) = (everything(), Gaussians::default());
    joined.settle_in(&SceneBlock { core, frozen, chosen_from: None });
    let last = end(&mut run.resume(&joined));
    assert_eq!(last.iteration, settings.iterations);
    // The expected frames are like the previous ones, instead of showing all Gaussians that fit the capacity.
    assert!(last.capacities.frame_instances >= last.capacities.most_instances);
    assert!(joined.capacities.most_instances > 0);
    assert!(last.capacities.frame_instances < 6 * last.capacities.gaussians, "{:?}", last.capacities);

    let refused = |change: &dyn Fn(&mut Checkpoint), said: &str| {
        let mut other = whole.clone();
        change(&mut other);
        assert_says(refusal(whole.clone().append(&other)), &[said]);
    };
    refused(&|other| other.settings.opacity_lr = 0.5, "other settings: opacity_lr was 0.5, is ");
    refused(&|other| other.strategy.name = "fixed".into(), "another strategy");
    // Only the number of iterations may differ.
    let mut longer = whole.clone();
    longer.settings.iterations += 7;
    assert_eq!(whole.difference_of_settings(&longer.settings), None);
}
