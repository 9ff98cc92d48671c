//! A run that resumes from a checkpoint ends with the same bits as an uninterrupted one.

use crate::common::device::planned_peak;
use crate::common::prelude::*;
use crate::few_photos::{few, mapped};
use ashsplat::scene::WorldFrame;
use ashsplat::train::{Actions, MomentState, MomentsType, OptimizerType};
use glam::DVec3;
use std::path::Path;

pub use crate::common::training::{settings, start, views};

/// Values that no training can have are refused when a file is read, even with valid hashes.
#[test]
fn numbers_out_of_their_range_are_refused() {
    let run = Run::shared(views(3, 9), settings());
    let whole = run.until(3, &[]);
    let (_folder, [path]) = new_paths(["checkpoint.safetensors"]);
    let read = |spoil: &dyn Fn(&mut Checkpoint)| {
        let mut spoilt = whole.clone();
        spoil(&mut spoilt);
        spoilt.write(&path).expect("written");
        Checkpoint::read(&path)
    };
    assert!(read(&|_| ()).expect("whole") == whole);
    type Spoil<'a> = &'a dyn Fn(&mut Checkpoint);
    let kinds: &[(&str, Spoil)] = &[
        ("capacities.blend_passes: is 100000000", &|c| c.capacities.blend_passes = 100_000_000),
        ("capacities.gaussians: is 4294967295", &|c| c.capacities.gaussians = u32::MAX),
        ("capacities.frame_gaussians: is 0", &|c| c.capacities.frame_gaussians = 0),
        ("iteration: is 4294967295", &|c| c.iteration = u32::MAX),
        ("optimizer_steps: is 4", &|c| c.optimizer_steps = 4),
        ("opacity_steps: is 9", &|c| c.opacity_steps = 9),
        ("skipped: is 5", &|c| c.skipped = 5),
        ("scene_extent: is inf", &|c| c.scene_extent = f32::INFINITY),
        ("sh_degree_interval: is 0", &|c| c.settings.sh_degree_interval = 0),
        ("means: value 4 is NaN", &|c| c.gaussians.means[1][1] = f32::NAN),
        ("second_moment.opacity_logits: value 2 is -1", &|c| {
            if let MomentState::F32([_, second]) = &mut c.moments {
                second.opacity_logits[2] = -1.0;
            }
        }),
    ];
    for (words, spoil) in kinds {
        assert_says(refusal(read(spoil)), &[words, "checkpoint.safetensors"]);
    }
    // Work that the strategy does not support.
    let unknown = read(&|c| c.due = Actions(1 << 9)).expect("read");
    assert_says(refusal(run.resume(&unknown).step()), &["has work (0x200)"]);
}

fn growing(context: &Context, settings: TrainSettings) -> Run<'_> {
    let start = gaussians(&small_scene(&mut Random::new(31), 3000, 9));
    Run { start, ..Run::new(context, views(5, 40), settings) }
}

fn is_limited(report: &StepReport) -> bool {
    report.densified.is_some_and(|densified| densified.limited)
}

/// Checks that with insufficient memory a run of 3000 Gaussians grows as far as possible, continues, and is still
/// deterministic.
pub fn check_growth_in_bounded_memory(settings: &TrainSettings) {
    let run = |max_memory: Option<u64>| {
        let context = bounded(max_memory);
        let mut trainer = growing(&context, settings.clone()).begin();
        let limited = trainer.finish().iter().filter(|report| is_limited(report)).count();
        (limited, trainer.state(), [context.memory_total().peak_bytes, planned_peak(&context)])
    };
    let (none, free, [_, peak]) = run(None);
    assert_eq!(none, 0);
    let some = Some(peak * 3 / 4);
    let ((limited, bounded, [used, _]), (_, again, _)) = (run(some), run(some));
    assert!(limited > 0, "{} Gaussians with {used} bytes of {peak}", bounded.gaussians.len());
    assert!(bounded == again, "other bits each time");
    assert!(Some(used) <= some, "{used} bytes, three quarters of {peak} were allowed");
    assert!((3000..free.gaussians.len()).contains(&bounded.gaussians.len()));
}

fn peak((views, settings): &(Vec<TrainView>, TrainSettings), max_memory: Option<u64>) -> Result<u64> {
    let context = bounded(max_memory);
    let mut trainer = Run::new(&context, views.clone(), settings.clone()).try_begin()?;
    (0..settings.iterations).try_for_each(|_| trainer.step().map(drop))?;
    Ok(context.memory_total().peak_bytes)
}

#[test]
fn memory_of_further_parts_is_planned() {
    let plain = || (views(3, 40), TrainSettings { iterations: 3, ..settings() });
    let exposure = (views(3, 40), TrainSettings { exposure: true, ..plain().1 });
    let lens_effects = (views(3, 40), TrainSettings { lens_effects: true, ..plain().1 });
    let poses = (views(3, 40), TrainSettings { pose_opt: true, ..plain().1 });
    let depth_points = (few(), TrainSettings { depth_points: 0.2, ..plain().1 });
    let maps = (mapped(), plain().1);
    // These views are too small to be reduced, but the forecast still includes the warm-up.
    // Random backgrounds would need the same photograph without a warm-up.
    let whole = || TrainSettings { random_background: false, iterations: 24, ..settings() };
    let warm_up = (views(3, 40), TrainSettings { warm_up: 12, ..whole() });
    for (name, with, without) in [
        ("exposure", exposure, plain()),
        ("lens effects", lens_effects, plain()),
        ("poses", poses, plain()),
        ("warm-up", warm_up, (views(3, 40), whole())),
        ("depth points", depth_points, (few(), plain().1)),
        ("inverse-depth maps", maps, plain()),
    ] {
        let [less, more] = [&without, &with].map(|run| peak(run, None).expect("trained"));
        assert!(more > less, "{name}: {more} bytes, {less} without");
        // Just enough, and much too little.
        assert!(peak(&with, Some(more)).expect(name) <= more, "{name}");
        assert_says(refusal(peak(&with, Some(50_000))), &["bytes"]);
    }
}

/// With too little memory for its growth, an interrupted run grows like an uninterrupted one.
#[test]
fn checkpoints_lose_no_bit_where_memory_is_bounded() {
    let settings = TrainSettings { densify_grad_threshold: 1e-7, iterations: 34, ..settings() };
    let run = |max_memory: Option<u64>, stops: &[u32]| {
        let context = bounded(max_memory);
        let run = growing(&context, settings.clone());
        let mut trainer = run.begin();
        let mut limited = 0;
        for iteration in 0..settings.iterations {
            if stops.contains(&iteration) {
                let checkpoint = trainer.state();
                drop(trainer);
                trainer = run.resume(&checkpoint);
            }
            limited += u32::from(is_limited(&trainer.steps(1)[0]));
        }
        (trainer.state(), limited, planned_peak(&context))
    };
    let (free, none, peak) = run(None, &[]);
    assert_eq!(none, 0);
    // Capacity for the first densification and for a part of the second.
    let some = Some(peak * 3 / 4);
    let (whole, limited, _) = run(some, &[]);
    assert!(limited > 0 && (3000..free.gaussians.len()).contains(&whole.gaussians.len()), "{limited}");
    for stops in [[14, 16], [15, 29], [30, 31]] {
        let (parts, also_limited, _) = run(some, &stops);
        assert!(parts == whole && also_limited == limited, "interrupted after {stops:?}: other bits");
    }
}

/// The last iteration of a run moves nothing, as in the reference. In a run that is prolonged, it does.
#[test]
fn checkpoints_of_the_last_iteration_go_on_like_a_longer_run() {
    let run = |iterations| {
        let settings = TrainSettings { iterations, ..settings() };
        Run::shared(views(5, 40), settings)
    };
    let mut whole = run(26).begin();
    let expected = whole.losses(26);
    // A plain iteration, one that densifies, and one that resets opacities.
    for last in [12, 15, 20] {
        let mut trainer = run(last).begin();
        let mut parts = trainer.losses(last);
        let mut trainer = run(26).resume(&through_a_file(&trainer.state()));
        parts.extend(trainer.losses(26 - last));
        assert_eq!(parts, expected, "a run of {last}");
        assert!(trainer.state() == whole.state(), "a run of {last}: other bits");
    }
}

#[test]
fn checkpoints_say_what_else_made_them() {
    let gpu = Gpu::new();
    let mut checkpoint = Run::new(gpu.context, views(2, 9), settings()).begin().state();
    let (device, driver) = (checkpoint.device.clone(), checkpoint.driver.clone());
    assert!(!driver.is_empty());
    let kernels = checkpoint.kernels.clone();
    assert_eq!(kernels, gpu.context.limits().kernel_forms());
    assert_eq!(checkpoint.differences(&device, &driver, &kernels), [""; 0]);
    let said = checkpoint.differences(&device, &driver, "gpu, subgroups of 128");
    assert_eq!(said, [format!("was made with kernels of '{kernels}', here it is 'gpu, subgroups of 128'")]);
    assert_eq!(through_a_file(&checkpoint).kernels, kernels);
    checkpoint.version = "0.0.9".into();
    let said = checkpoint.differences("another", "newer", &kernels).join("; ");
    assert_says(&said, &["ashsplat '0.0.9'", "device", "'another'", "driver", "'newer'"]);
}

/// Any flipped bit of a small file is detected, also in settings and counters.
#[test]
fn checkpoints_with_any_bit_flipped_are_refused() {
    let settings =
        TrainSettings { sh_degree: 0, filter_3d: true, pose_opt: true, ..TrainSettings::reference() };
    let one = start().select(&[0]).with_sh_degree(0);
    let run = Run { start: one, ..Run::shared(views(3, 9), settings) };
    let frame = WorldFrame { origin: DVec3::new(500_000.1, -0.5, 120.0), unit: 0.01 };
    let due = Actions::RESET_OPACITY;
    let checkpoint = Checkpoint { frame, due, skipped: 2, ..run.until(3, &[]) };
    let (_folder, [path]) = new_paths(["c.safetensors"]);
    checkpoint.write(&path).expect("written");
    assert!(Checkpoint::read(&path).expect("sound") == checkpoint);
    let mut bytes = std::fs::read(&path).expect("read");
    let mut unnoticed = 0;
    // One bit of each byte in turn, unless all are requested.
    let all = std::env::var_os("ASHSPLAT_ALL_FAULTS").is_some();
    for bit in (0..bytes.len() * 8).filter(|bit| all || bit % 8 == bit / 8 % 8) {
        bytes[bit / 8] ^= 1 << (bit % 8);
        std::fs::write(&path, &bytes).expect("written");
        if let Ok(read) = Checkpoint::read(&path) {
            // For example, white space in the header.
            assert!(read == checkpoint, "bit {bit} of {} changes what is read", bytes.len() * 8);
            unnoticed += 1;
        }
        bytes[bit / 8] ^= 1 << (bit % 8);
    }
    assert!(unnoticed < 100, "{unnoticed} bits do not count");
}

/// Also right where a densification (15) or a reset (20) is due, and within an epoch.
#[test]
fn checkpoints_lose_no_bit() {
    let sparse = TrainSettings { optimizer_type: OptimizerType::SparseAdam, ..settings() };
    let packed = TrainSettings { moments: MomentsType::Packed, decay_last: 0.4, ..settings() };
    let halves = TrainSettings { sh_storage: ShStorage::Half, surface: true, ..packed.clone() };
    let stops: [&[u32]; 6] = [&[0], &[1], &[15], &[20], &[27], &[39]];
    for (settings, stops) in [
        (settings(), &stops[..]),
        (sparse, &[&[18]]),
        (packed, &[&[15], &[18], &[20], &[27]]),
        (halves, &[&[15], &[27]]),
    ] {
        let end = Run::shared(views(5, 40), settings).check_stops(stops);
        assert_ne!(end.gaussians.len(), 150, "nothing was densified");
    }
}

#[test]
fn checkpoints_of_something_else_are_refused() {
    let settings = settings();
    let run = |settings: &TrainSettings| Run::shared(views(5, 40), settings.clone());
    let checkpoint = run(&settings).until(3, &[]);
    let refuse = |views, settings: &TrainSettings, words: &[&str]| {
        let refused = Run { views, ..run(settings) }.try_resume(&checkpoint);
        assert_says(refusal(refused), words);
    };
    let other = TrainSettings { seed: 7, lambda_dssim: 0.5, ..settings.clone() };
    refuse(views(5, 40), &other, &["seed was 6, is 7", "lambda_dssim was 0.2, is 0.5"]);
    let over = TrainSettings { iterations: 2, ..settings.clone() };
    refuse(views(5, 40), &over, &["iteration 3", "raise"]);
    refuse(views(4, 40), &settings, &["5 training views, here are 4"]);
    refuse(views(5, 41), &settings, &["other photographs"]);
    let larger = Trainer::resume(context(), views(5, 40), 6.0, settings.clone(), &checkpoint);
    assert_says(refusal(larger), &["extent of 5, here it is 6"]);
    // More iterations than planned are still the same training.
    let longer = TrainSettings { iterations: 50, ..settings };
    let mut resumed = run(&longer).resume(&checkpoint);
    resumed.steps(9);
    assert!(run(&longer).until(12, &[]) == resumed.state());
}

fn refuse_file(path: &Path, bytes: &[u8], words: &[&str]) {
    std::fs::write(path, bytes).expect("written");
    let message = refusal(Checkpoint::read(path));
    assert_says(&message, words);
    assert!(message.contains(path.to_str().expect("UTF-8")) && !message.contains('\n'), "{message}");
}

#[test]
fn damaged_checkpoints_are_refused() {
    let (_folder, [path]) = new_paths(["c.safetensors"]);
    Run::shared(views(2, 9), settings()).begin().state().write(&path).expect("written");
    let whole = std::fs::read(&path).expect("read");
    Checkpoint::read(&path).expect("sound");
    for length in (0..whole.len()).step_by(whole.len() / 40).chain([7, 8, 9, whole.len() - 1]) {
        refuse_file(&path, &whole[..length], &["truncated"]);
    }
    refuse_file(&path, &[whole.as_slice(), b"more"].concat(), &["truncated"]);
    // One bit of the last statistic.
    let mut flipped = whole.clone();
    *flipped.last_mut().expect("not empty") ^= 1;
    refuse_file(&path, &flipped, &["damaged"]);
    let text = |from: &[u8], to: &[u8]| {
        let at = whole.windows(from.len()).position(|bytes| bytes == from).expect("in the header");
        [&whole[..at], to, &whole[at + from.len()..]].concat()
    };
    refuse_file(&path, &text(b"ashsplat-checkpoint/3", b"ashsplat-checkpoint/2"), &["checkpoint/2", "reads"]);
    refuse_file(&path, &text(b"\"format\"", b"\"former\""), &["no checkpoint of ashsplat"]);
    refuse_file(&path, &text(b"\"statistics\"", b"\"statistiks\""), &["lacks the tensor 'statistics'"]);
    refuse_file(&path, &text(b"densify_from_iter", b"densify_from_itre"), &["damaged", "metadata"]);
    refuse_file(&path, b"ply\nformat ascii 1.0\n", &["truncated or no safetensors"]);
    // A header length of u64::MAX.
    let claims = [&u64::MAX.to_le_bytes(), whole.as_slice()].concat();
    refuse_file(&path, &claims, &["truncated or no safetensors"]);
}
