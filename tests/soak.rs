//! Many small steps and frames: neither memory nor results drift. Not part of CI:
//! `cargo test --release --test engine -- --ignored soak --nocapture`.

use std::time::Instant;

use ashsplat::trainer::Trainer;
use ashsplat::vk::{Context, ContextOptions};
use ashsplat::{RenderSettings, Renderer, TrainSettings};

use crate::checkpoints::{start, views};
use crate::common::engine::camera;
use crate::common::scenes::small_view;

/// Without the validation layer, whose records would hide a growth of memory.
fn context() -> Context {
    Context::new(&ContextOptions::default()).expect("a device")
}

/// Resident memory of the process, KiB; 0 if the system does not report it.
fn resident_kib() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    line.and_then(|rest| rest.split_whitespace().next()?.parse().ok()).unwrap_or(0)
}

fn number(name: &str, usual: u32) -> u32 {
    std::env::var(name).ok().and_then(|n| n.parse().ok()).unwrap_or(usual)
}

/// Device memory that densification soon fills: afterwards it only removes, and is limited each time.
const MEMORY: u64 = 12 << 20;

/// The first half has densifications and opacity resets; the second half has neither.
#[test]
#[ignore = "takes minutes"]
fn soak_training() {
    let steps = number("ASHSPLAT_SOAK_STEPS", 20_000);
    let tenth = steps / 10;
    let settings = TrainSettings {
        iterations: steps + 1,
        densify_from_iter: 50,
        densify_until_iter: steps / 2,
        densify_grad_threshold: 1e-5,
        opacity_reset_interval: tenth,
        sh_degree_interval: 100,
        ..TrainSettings::default()
    };
    let context = Context::new(&ContextOptions { max_memory: Some(MEMORY), ..ContextOptions::default() });
    let context = context.expect("a device");
    let mut trainer = Trainer::new(&context, views(5, 90), &start(), 5.0, settings).expect("a trainer");
    let begin = Instant::now();
    let (mut sum, mut losses) = (0.0, Vec::new());
    let (mut device_bytes, mut resident, mut densified, mut limited) = (Vec::new(), Vec::new(), 0, 0);
    for step in 1..=steps {
        let report = trainer.step().expect("a step");
        assert!(report.loss.is_finite() && report.skipped_non_finite == 0, "{report:?}");
        sum += f64::from(report.loss);
        densified += u32::from(report.densified.is_some());
        limited += u32::from(report.densified.is_some_and(|d| d.limited));
        if step % tenth == 0 {
            losses.push(std::mem::take(&mut sum) / f64::from(tenth));
            device_bytes.push(context.memory_total().bytes);
            resident.push(resident_kib());
            eprintln!(
                "{step} steps, {:.0} s: mean loss {:.5}, {} Gaussians, {densified} densifications ({limited} without \
                 room), {} KiB of device memory, {} KiB resident",
                begin.elapsed().as_secs_f64(),
                losses[losses.len() - 1],
                report.gaussians,
                device_bytes[device_bytes.len() - 1] >> 10,
                resident[resident.len() - 1]
            );
        }
    }
    assert!(densified > 0 && context.memory_total().peak_bytes <= MEMORY);
    assert!(
        device_bytes[6..].iter().all(|bytes| *bytes == device_bytes[6]),
        "device memory grows: {device_bytes:?}"
    );
    assert!(resident[9] < resident[0] + 16_384, "memory grows, KiB: {resident:?}");
    // The second half keeps its results: no tenth is much worse than the best before it.
    let mut best = f64::INFINITY;
    for loss in &losses[6..] {
        assert!(*loss < 1.2 * best, "the loss drifts: {losses:?}");
        best = best.min(*loss);
    }
}

#[test]
#[ignore = "takes minutes"]
fn soak_rendering() {
    let frames = number("ASHSPLAT_SOAK_FRAMES", 5000);
    let context = context();
    let mut renderer = Renderer::new(&context).expect("a renderer");
    renderer.upload(&start()).expect("upload");
    let sizes = [[70, 50], [33, 90], [128, 8]];
    let mut render = |size: [u32; 2]| {
        let frame = renderer.render(&camera(&small_view(size)), &RenderSettings::default());
        frame.expect("a frame").color
    };
    let first = sizes.map(&mut render);
    let settled = (context.memory_total().bytes, resident_kib());
    for frame in 0..frames as usize {
        let which = frame % sizes.len();
        assert!(render(sizes[which]) == first[which], "frame {frame} differs from the first of its size");
    }
    eprintln!("{frames} frames: {} KiB resident at first, {} at the end", settled.1, resident_kib());
    assert_eq!(context.memory_total().bytes, settled.0, "device memory grows");
    assert!(resident_kib() < settled.1 + 16_384, "memory grows from {} to {} KiB", settled.1, resident_kib());
}
