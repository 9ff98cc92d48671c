//! Memory of the process over a thousand frames of changing size and camera, and over a thousand training steps. The test has its own process, where no
//! other test allocates, and no validation layer, which keeps records.

use crate::child;
use crate::frames::{changing_view, draw_a_thousand};
use crate::stage::*;
use crate::training::{settings, trainer};

/// Number of frames, and of steps.
const FRAMES: u32 = 1000;
/// Number of frames or steps after which allocators and the driver have settled.
const SETTLED: u32 = 200;

/// Resident memory of the process, KiB; None if the system does not report it.
fn resident_kib() -> Option<u64> {
    let statm = std::fs::read_to_string("/proc/self/statm").ok()?;
    let pages: u64 = statm.split_whitespace().nth(1)?.parse().ok()?;
    Some(pages * 4)
}

#[derive(Default)]
struct Measured {
    resident_kib: [u64; 2],
    device_bytes: [u64; 2],
}

impl Measured {
    fn note(&mut self, context: &Context, number: u32) {
        let at = match number {
            SETTLED => 0,
            FRAMES => 1,
            _ => return,
        };
        self.resident_kib[at] = resident_kib().expect("asked before");
        self.device_bytes[at] = context.memory_total().bytes;
    }

    fn report(&self, path: &str) {
        let ([settled, end], [device, device_end]) = (self.resident_kib, self.device_bytes);
        println!(
            "{path}: {settled} KiB resident after {SETTLED} rounds, {end} after {FRAMES}; device memory {} KiB all along",
            device >> 10
        );
        assert!(end <= settled + 1024, "{path}: resident memory grows from {settled} to {end} KiB");
        assert_eq!(device, device_end, "{path}");
    }
}

#[test]
#[ignore = "the child's part of resident_memory_does_not_grow"]
fn resident_memory_in_a_child() {
    with_host(&HostOptions::default(), |host| {
        let context = guest(host);
        let mut recorded = Measured::default();
        draw_a_thousand(host, &context, |number| recorded.note(&context, number));
        recorded.report("recorded");

        let mut renderer = Renderer::new(&context).expect("kernels");
        renderer.upload(&cloud(150, 7)).expect("a scene");
        let mut owned = Measured::default();
        for number in 0..FRAMES {
            owned.note(&context, number);
            renderer.render(&changing_view(number), &SETTINGS).expect("a frame");
        }
        owned.note(&context, FRAMES);
        owned.report("owned");

        // Densification ends before the memory is first noted.
        let mut trainer = trainer(&context, TrainSettings { iterations: FRAMES, ..settings() });
        let mut trained = Measured::default();
        for number in 1..=FRAMES {
            let step = trainer.step().expect("a step");
            assert!(step.loss.is_finite() && step.skipped_non_finite == 0, "{step:?}");
            trained.note(&context, number);
        }
        trained.report("trained");
    });
}

#[test]
fn resident_memory_does_not_grow() {
    if resident_kib().is_none() {
        eprintln!("skipped: this system does not tell the resident memory");
        return;
    }
    let said = child::run(&["--exact", "resident::resident_memory_in_a_child"], 1, |_| {});
    let lines: Vec<&str> = said.lines().filter(|line| line.contains("KiB resident")).collect();
    println!("{}", lines.join("\n"));
    assert_eq!(lines.len(), 3, "all paths were measured: {said}");
}
