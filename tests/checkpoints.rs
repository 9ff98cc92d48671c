//! A run that resumes from a checkpoint ends with the same bits as an uninterrupted one.

use ashsplat::scene::WorldFrame;
use ashsplat::trainer::{Actions, Checkpoint, OptimizerType, PoseState, Room, TrainView, Trainer};

use ashsplat::{Gaussians, TrainSettings};
use ashsplat_files::{CheckpointFile, Photo};
use glam::DVec3;
use std::path::Path;
use tempfile::tempdir;

use crate::common::bounded;
use crate::common::device::planned_peak;
use crate::common::engine::{camera, gaussians};
use crate::common::gpu::Gpu;
use crate::common::scenes::{Random, rotation_about_y, small_scene, small_view};
use crate::reference::types::View;

const EXTENT: f32 = 5.0;

/// Densifies after 15 and 30, resets opacities after 20.
pub fn settings() -> TrainSettings {
    TrainSettings {
        iterations: 40,
        sh_degree: 2,
        sh_degree_interval: 12,
        densify_from_iter: 10,
        densification_interval: 15,
        densify_until_iter: 38,
        opacity_reset_interval: 20,
        densify_grad_threshold: 2e-5,
        random_background: true,
        seed: 6,
        ..TrainSettings::default()
    }
}

/// Grey views: the result of the training does not matter.
pub fn views(count: u32, gray: u8) -> Vec<TrainView> {
    (0..count)
        .map(|i| {
            let turned = View { camera_from_world: rotation_about_y(f64::from(i)), ..small_view([40, 30]) };
            let rgb = (0..40 * 30 * 3).map(|k| gray.wrapping_add((k * (i + 3)) as u8)).collect();
            TrainView::new(camera(&turned), Photo { width: 40, height: 30, rgb })
        })
        .collect()
}

pub fn start() -> Gaussians {
    gaussians(&small_scene(&mut Random::new(31), 150, 9))
}

/// The end of a run that is resumed from a checkpoint after each of `stops`.
pub fn end_of_run(start: &Gaussians, settings: &TrainSettings, iterations: u32, stops: &[u32]) -> Checkpoint {
    let gpu = Gpu::new();
    let mut trainer =
        Trainer::new(gpu.context, views(3, 9), start, EXTENT, settings.clone()).expect("a trainer");
    for iteration in 1..=iterations {
        trainer.step().expect("a step");
        if stops.contains(&iteration) {
            let checkpoint = trainer.checkpoint().expect("a checkpoint");
            let resumed = Trainer::resume(gpu.context, views(3, 9), EXTENT, settings.clone(), &checkpoint);
            trainer = resumed.expect("resumed");
        }
    }
    trainer.checkpoint().expect("the end")
}

/// The end of a run with these views.
pub fn end_with(views: Vec<TrainView>, settings: &TrainSettings) -> Checkpoint {
    let gpu = Gpu::new();
    let trainer = Trainer::new(gpu.context, views, &start(), EXTENT, settings.clone());
    let mut trainer = trainer.expect("a trainer");
    (0..settings.iterations).for_each(|_| drop(trainer.step().expect("a step")));
    trainer.checkpoint().expect("the end")
}

/// Values that no training can have are refused when a file is read, even with valid hashes.
#[test]
fn numbers_out_of_their_range_are_refused() {
    let whole = end_of_run(&start(), &settings(), 3, &[]);
    let folder = tempdir().expect("a folder");
    let path = folder.path().join("checkpoint.safetensors");
    let read = |spoil: &dyn Fn(&mut Checkpoint)| {
        let mut spoilt = whole.clone();
        spoil(&mut spoilt);
        spoilt.write(&path).expect("written");
        Checkpoint::read(&path)
    };
    assert!(read(&|_| ()).expect("whole") == whole);
    type Spoil<'a> = &'a dyn Fn(&mut Checkpoint);
    let kinds: &[(&str, Spoil)] = &[
        ("room_blend_passes: is 100000000", &|c| c.room.blend_passes = 100_000_000),
        ("room_backward: is 2", &|c| c.room.backward = 2),
        ("room_gaussians: is 4294967295", &|c| c.room.gaussians = u32::MAX),
        ("room_frame_gaussians: is 0", &|c| c.room.frame_gaussians = 0),
        ("room_frame_width: is 70000", &|c| c.room.frame_width = 70_000),
        ("iteration: is 4294967295", &|c| c.iteration = u32::MAX),
        ("optimizer_steps: is 4", &|c| c.optimizer_steps = 4),
        ("opacity_steps: is 9", &|c| c.opacity_steps = 9),
        ("left_out: is 5", &|c| c.skipped = 5),
        ("scene_extent: is inf", &|c| c.scene_extent = f32::INFINITY),
        ("sh_degree_interval: is 0", &|c| c.settings.sh_degree_interval = 0),
        ("means: value 4 is NaN", &|c| c.gaussians.means[1][1] = f32::NAN),
        ("second_moment.opacity_logits: value 2 is -1", &|c| c.second_moments.opacity_logits[2] = -1.0),
    ];
    for (words, spoil) in kinds {
        let message = read(spoil).expect_err(words).to_string();
        assert!(message.contains(words) && message.contains("checkpoint.safetensors"), "{message}");
    }
    // Work that the strategy does not support.
    let unknown = read(&|c| c.due = Actions(1 << 9)).expect("read");
    let resumed = Trainer::resume(Gpu::new().context, views(3, 9), EXTENT, settings(), &unknown);
    let refused = resumed.expect("resumed").step().expect_err("refused").to_string();
    assert!(refused.contains("has work (0x200)"), "{refused}");
}

/// Checks that a run with these views is deterministic, also if interrupted at each stop. Returns its end.
pub fn check_resumed_with(
    views: impl Fn() -> Vec<TrainView>,
    settings: &TrainSettings,
    stops: &[u32],
) -> Checkpoint {
    let gpu = Gpu::new();
    let whole = end_with(views(), settings);
    assert!(end_with(views(), settings) == whole, "other bits each time");
    for &stop in stops {
        let first = Trainer::new(gpu.context, views(), &start(), EXTENT, settings.clone());
        let mut first = first.expect("a trainer");
        (0..stop).for_each(|_| drop(first.step().expect("a step")));
        let checkpoint = first.checkpoint().expect("a checkpoint");
        let resumed = Trainer::resume(gpu.context, views(), EXTENT, settings.clone(), &checkpoint);
        let mut trainer = resumed.expect("resumed");
        (stop..settings.iterations).for_each(|_| drop(trainer.step().expect("a step")));
        assert!(trainer.checkpoint().expect("the end") == whole, "interrupted after {stop}: other bits");
    }
    whole
}

/// Checks that with insufficient memory a run of 3000 Gaussians grows as far as possible, continues, and is still
/// deterministic.
pub fn check_growth_in_bounded_memory(settings: &TrainSettings) {
    let many = gaussians(&small_scene(&mut Random::new(31), 3000, 9));
    let run = |max_memory: Option<u64>| {
        let context = bounded(max_memory);
        let mut trainer =
            Trainer::new(&context, views(5, 40), &many, EXTENT, settings.clone()).expect("a trainer");
        let limited = (0..settings.iterations)
            .filter(|_| trainer.step().expect("a step").densified.is_some_and(|d| d.limited));
        let limited = limited.count();
        let used = context.memory_total().peak_bytes;
        (limited, trainer.checkpoint().expect("the end"), [used, planned_peak(&context)])
    };
    let (none, free, [_, peak]) = run(None);
    assert_eq!(none, 0);
    let some = Some(peak * 3 / 4);
    let ((limited, bounded, [used, _]), (_, again, _)) = (run(some), run(some));
    assert!(
        limited > 0,
        "{} Gaussians with {peak} bytes, {} with {used}",
        free.gaussians.len(),
        bounded.gaussians.len()
    );
    assert!(bounded == again, "other bits each time");
    assert!(Some(used) <= some, "{used} bytes, three quarters of {peak} were allowed");
    assert!((3000..free.gaussians.len()).contains(&bounded.gaussians.len()));
}

/// Checks that the memory for these additional settings is forecast and counted.
pub fn check_memory_of(with: &TrainSettings, without: &TrainSettings) {
    let peak = |settings: &TrainSettings, max_memory: Option<u64>| -> ashsplat::Result<u64> {
        let context = bounded(max_memory);
        let mut trainer = Trainer::new(&context, views(3, 40), &start(), EXTENT, settings.clone())?;
        (0..settings.iterations).try_for_each(|_| trainer.step().map(drop))?;
        Ok(context.memory_total().peak_bytes)
    };
    let (less, more) = (peak(without, None).expect("trained"), peak(with, None).expect("trained"));
    assert!(more > less);
    // Just enough, and much too little.
    assert!(peak(with, Some(more)).expect("trained") <= more);
    let refused = peak(with, Some(50_000)).expect_err("too little").to_string();
    assert!(refused.contains("bytes"), "{refused}");
}

fn steps(trainer: &mut Trainer, until: u32) -> Vec<f32> {
    (trainer.iteration()..until).map(|_| trainer.step().expect("a step").loss).collect()
}

/// With too little memory for its growth, an interrupted run grows like an uninterrupted one.
#[test]
fn checkpoints_lose_no_bit_where_memory_is_bounded() {
    let settings = TrainSettings { densify_grad_threshold: 1e-7, iterations: 34, ..settings() };
    let many = gaussians(&small_scene(&mut Random::new(31), 3000, 9));
    let run = |max_memory: Option<u64>, stops: &[u32]| {
        let context = bounded(max_memory);
        let mut trainer =
            Trainer::new(&context, views(5, 40), &many, EXTENT, settings.clone()).expect("a trainer");
        let mut limited = 0;
        for iteration in 0..settings.iterations {
            if stops.contains(&iteration) {
                let checkpoint = trainer.checkpoint().expect("a checkpoint");
                drop(trainer);
                let resumed = Trainer::resume(&context, views(5, 40), EXTENT, settings.clone(), &checkpoint);
                trainer = resumed.expect("resumed");
            }
            let densified = trainer.step().expect("a step").densified;
            limited += u32::from(densified.is_some_and(|d| d.limited));
        }
        let end = trainer.checkpoint().expect("the end");
        (end, limited, planned_peak(&context))
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
    let gpu = Gpu::new();
    let longer = TrainSettings { iterations: 26, ..settings() };
    let mut whole =
        Trainer::new(gpu.context, views(5, 40), &start(), EXTENT, longer.clone()).expect("a trainer");
    let losses = steps(&mut whole, 26);
    let end = whole.checkpoint().expect("the end");
    // A plain iteration, one that densifies, and one that resets opacities.
    for last in [12, 15, 20] {
        let short = TrainSettings { iterations: last, ..longer.clone() };
        let mut trainer =
            Trainer::new(gpu.context, views(5, 40), &start(), EXTENT, short).expect("a trainer");
        let mut parts = steps(&mut trainer, last);
        let mut trainer = through_a_file(trainer, &gpu, &longer);
        parts.extend(steps(&mut trainer, 26));
        assert_eq!(parts, losses, "a run of {last}");
        assert!(trainer.checkpoint().expect("the end") == end, "a run of {last}: other bits");
    }
}

#[test]
fn checkpoints_say_what_else_made_them() {
    let gpu = Gpu::new();
    let trainer = Trainer::new(gpu.context, views(2, 9), &start(), EXTENT, settings()).expect("a trainer");
    let mut checkpoint = trainer.checkpoint().expect("a checkpoint");
    let (device, driver) = (checkpoint.device.clone(), checkpoint.driver.clone());
    assert!(!driver.is_empty());
    let kernels = checkpoint.kernels.clone();
    assert_eq!(kernels, gpu.context.limits().kernel_forms());
    assert_eq!(checkpoint.differences(&device, &driver, &kernels), [""; 0]);
    let said = checkpoint.differences(&device, &driver, "gpu, subgroups of 128");
    assert_eq!(said, [format!("was made with kernels of '{kernels}', here it is 'gpu, subgroups of 128'")]);
    let folder = tempdir().expect("a temporary folder");
    let path = folder.path().join("of_this.safetensors");
    checkpoint.write(&path).expect("written");
    assert_eq!(Checkpoint::read(&path).expect("read").kernels, kernels);
    // Checkpoints of older versions lack this field.
    checkpoint.kernels.clear();
    checkpoint.write(&path).expect("written");
    assert!(!String::from_utf8_lossy(&std::fs::read(&path).expect("a file")).contains("\"kernels\""));
    assert_eq!(Checkpoint::read(&path).expect("read").kernels, "");
    assert_eq!(checkpoint.differences(&device, &driver, &kernels), [""; 0]);
    checkpoint.version = "0.0.9".into();
    let said = checkpoint.differences("another", "newer", &kernels).join("; ");
    for word in ["ashsplat '0.0.9'", "device", "'another'", "driver", "'newer'"] {
        assert!(said.contains(word), "no '{word}' in {said}");
    }
}

/// Any flipped bit of a small file is detected, also in settings and counters.
#[test]
fn checkpoints_with_any_bit_flipped_are_refused() {
    let one = Gaussians {
        sh_degree: 0,
        means: vec![[1.0, 2.0, 3.0]],
        quats: vec![[1.0, 0.0, 0.0, 0.0]],
        log_scales: vec![[-1.0; 3]],
        opacity_logits: vec![0.5],
        sh: vec![[0.1, 0.2, 0.3]],
    };
    let checkpoint = Checkpoint {
        version: "1".into(),
        device: "d".into(),
        driver: "r".into(),
        kernels: "k".into(),
        settings: TrainSettings { sh_degree: 0, filter_3d: true, ..TrainSettings::default() },
        views: 3,
        views_fingerprint: 77,
        scene_extent: 1.5,
        frame: WorldFrame { origin: DVec3::new(500_000.1, -0.5, 120.0), unit: 0.01 },
        iteration: 9,
        optimizer_steps: 9,
        opacity_steps: 8,
        due: ashsplat::trainer::Actions::RESET_OPACITY,
        strategy: Default::default(),
        first_moments: one.clone(),
        second_moments: Gaussians { log_scales: vec![[1.0; 3]], ..one.clone() },
        gaussians: one,
        statistics: vec![[0.5, 2.0]],
        filters: vec![0.25],
        gradient_sums: None,
        means: None,
        exposures: Default::default(),
        lenses: Default::default(),
        poses: Some(PoseState {
            parameters: vec![[0.1; 6]; 3],
            first_moments: vec![[0.2; 6]; 3],
            second_moments: vec![[0.3; 6]; 3],
            depths: vec![0.4; 3],
        }),
        block: None,
        skipped: 2,
        room: Room::default(),
    };
    let folder = tempdir().expect("a temporary folder");
    let path = folder.path().join("c.safetensors");
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

/// Moves a trainer through a file to a new trainer.
fn through_a_file(trainer: Trainer, gpu: &Gpu, settings: &TrainSettings) -> Trainer {
    let folder = tempdir().expect("a temporary folder");
    let path = folder.path().join("a.safetensors");
    let checkpoint = trainer.checkpoint().expect("a checkpoint");
    drop(trainer);
    checkpoint.write(&path).expect("written");
    let read = Checkpoint::read(&path).expect("read back");
    assert!(read == checkpoint, "a checkpoint changes on disk");
    Trainer::resume(gpu.context, views(5, 40), EXTENT, settings.clone(), &read).expect("resumed")
}

fn check_resumed(settings: &TrainSettings, stops: &[u32]) {
    let gpu = Gpu::new();
    let new =
        || Trainer::new(gpu.context, views(5, 40), &start(), EXTENT, settings.clone()).expect("a trainer");
    let mut whole = new();
    let losses = steps(&mut whole, settings.iterations);
    let end = whole.checkpoint().expect("the end");
    assert_ne!(end.gaussians.len(), 150, "nothing was densified");
    for &stop in stops {
        let mut trainer = new();
        let mut parts = steps(&mut trainer, stop);
        let mut trainer = through_a_file(trainer, &gpu, settings);
        assert_eq!(trainer.iteration(), stop);
        parts.extend(steps(&mut trainer, settings.iterations));
        assert_eq!(parts, losses, "interrupted after {stop}");
        assert!(trainer.checkpoint().expect("the end") == end, "interrupted after {stop}: other bits");
    }
}

/// Also right where a densification (15) or a reset (20) is due, and within an epoch.
#[test]
fn checkpoints_lose_no_bit() {
    check_resumed(&settings(), &[0, 1, 15, 20, 27, 39]);
}

#[test]
fn checkpoints_lose_no_bit_of_sparse_adam() {
    check_resumed(&TrainSettings { optimizer_type: OptimizerType::SparseAdam, ..settings() }, &[18]);
}

#[test]
fn checkpoints_of_something_else_are_refused() {
    let gpu = Gpu::new();
    let settings = settings();
    let new = |settings: &TrainSettings| {
        Trainer::new(gpu.context, views(5, 40), &start(), EXTENT, settings.clone()).expect("a trainer")
    };
    let mut trainer = new(&settings);
    steps(&mut trainer, 3);
    let checkpoint = trainer.checkpoint().expect("a checkpoint");
    let refuse = |views, extent, settings: &TrainSettings, words: &[&str]| {
        let refused = Trainer::resume(gpu.context, views, extent, settings.clone(), &checkpoint);
        let message = refused.err().expect("refused").to_string();
        words.iter().for_each(|word| assert!(message.contains(word), "no '{word}' in {message}"));
    };
    let other = TrainSettings { seed: 7, lambda_dssim: 0.5, ..settings.clone() };
    refuse(views(5, 40), EXTENT, &other, &["seed was 6, is 7", "lambda_dssim was 0.2, is 0.5"]);
    let over = TrainSettings { iterations: 2, ..settings.clone() };
    refuse(views(5, 40), EXTENT, &over, &["iteration 3", "raise"]);
    refuse(views(4, 40), EXTENT, &settings, &["5 training views, here are 4"]);
    refuse(views(5, 41), EXTENT, &settings, &["other photographs"]);
    refuse(views(5, 40), 6.0, &settings, &["extent of 5, here it is 6"]);
    // More iterations than planned are still the same training.
    let longer = TrainSettings { iterations: 50, ..settings };
    let resumed = Trainer::resume(gpu.context, views(5, 40), EXTENT, longer.clone(), &checkpoint);
    let mut resumed = resumed.expect("resumed");
    let mut whole = new(&longer);
    steps(&mut whole, 12);
    steps(&mut resumed, 12);
    assert!(whole.checkpoint().expect("one") == resumed.checkpoint().expect("one"));
}

fn refuse_file(path: &Path, bytes: &[u8], words: &[&str]) {
    std::fs::write(path, bytes).expect("written");
    let message = Checkpoint::read(path).expect_err("refused").to_string();
    for word in words.iter().chain(&[path.to_str().expect("UTF-8")]) {
        assert!(message.contains(word), "no '{word}' in {message}");
    }
    assert!(!message.contains('\n'), "{message}");
}

#[test]
fn damaged_checkpoints_are_refused() {
    let gpu = Gpu::new();
    let trainer = Trainer::new(gpu.context, views(2, 9), &start(), EXTENT, settings()).expect("a trainer");
    let folder = tempdir().expect("a temporary folder");
    let path = folder.path().join("c.safetensors");
    trainer.checkpoint().expect("a checkpoint").write(&path).expect("written");
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
    refuse_file(&path, &text(b"ashsplat-checkpoint/2", b"ashsplat-checkpoint/1"), &["checkpoint/1", "reads"]);
    refuse_file(&path, &text(b"\"format\"", b"\"former\""), &["no checkpoint of ashsplat"]);
    refuse_file(&path, &text(b"\"statistics\"", b"\"statistiks\""), &["lacks the tensor 'statistics'"]);
    refuse_file(&path, &text(b"densify_from_iter", b"densify_from_itre"), &["damaged", "metadata"]);
    refuse_file(&path, b"ply\nformat ascii 1.0\n", &["truncated or no safetensors"]);
    // A header that claims to fill the memory.
    refuse_file(
        &path,
        &[&u64::MAX.to_le_bytes(), whole.as_slice()].concat(),
        &["truncated or no safetensors"],
    );
}
