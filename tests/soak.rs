//! Many small steps and frames: neither memory nor results drift. Not part of CI:
//! `cargo test --release --test engine -- --ignored soak --nocapture`.

use crate::common::prelude::*;

fn context(max_memory: Option<u64>) -> Context {
    Context::new(&ContextOptions { max_memory, ..ContextOptions::default() }).expect("a device")
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
        ..TrainSettings::reference()
    };
    let context = context(Some(MEMORY));
    let mut trainer = Run::new(&context, views(5, 90), settings).begin();
    let (mut losses, mut device_bytes, mut resident, mut densified) = (Vec::new(), Vec::new(), Vec::new(), 0);
    for part in 1..=10 {
        let reports = trainer.steps(tenth);
        assert!(reports.iter().all(|r| r.loss.is_finite() && r.skipped_non_finite == 0), "{reports:?}");
        let loss = reports.iter().map(|report| f64::from(report.loss)).sum::<f64>() / f64::from(tenth);
        densified += reports.iter().filter(|report| report.densified.is_some()).count();
        let (bytes, kib) = (context.memory_total().bytes, resident_kib());
        eprintln!("{part} of 10: loss {loss:.5}, {} KiB on the device, {kib} KiB resident", bytes >> 10);
        losses.push(loss);
        device_bytes.push(bytes);
        resident.push(kib);
    }
    assert!(densified > 0 && context.memory_total().peak_bytes <= MEMORY);
    let is_constant = device_bytes[6..].iter().all(|bytes| *bytes == device_bytes[6]);
    assert!(is_constant, "device memory grows: {device_bytes:?}");
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
    let context = context(None);
    let mut renderer = loaded(&context, &start());
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
