//! Memory of the process over a thousand frames of changing size and camera. The test has its own process, where no
//! other test allocates, and no validation layer, which keeps records.

use crate::child;
use crate::host::{HostOptions, InFlight};
use crate::stage::{adopt, camera, cloud, guest, with_host};
use ashsplat::{Camera, DeviceScene, RecordedFrame, RenderSettings, Renderer, Reservation};

const FRAMES: u32 = 1000;
/// Number of frames after which allocators and the driver have settled.
const SETTLED: u32 = 200;

/// Resident memory of the process, KiB; None if the system does not report it.
fn resident_kib() -> Option<u64> {
    let statm = std::fs::read_to_string("/proc/self/statm").ok()?;
    let pages: u64 = statm.split_whitespace().nth(1)?.parse().ok()?;
    Some(pages * 4)
}

fn view(number: u32) -> Camera {
    camera(number as f32 * 0.1, 1 + number * 7 % 64, 1 + number * 5 % 48)
}

/// Runs all frames. Returns the resident memory once settled and at the end.
fn measured(mut frame: impl FnMut(u32)) -> [u64; 2] {
    let mut settled = 0;
    for number in 0..FRAMES {
        if number == SETTLED {
            settled = resident_kib().expect("asked before");
        }
        frame(number);
    }
    [settled, resident_kib().expect("asked before")]
}

fn report(path: &str, [settled, end]: [u64; 2], device_bytes: u64) {
    println!(
        "{path}: {settled} KiB resident after {SETTLED} frames, {end} after {FRAMES}; device memory {} KiB all along",
        device_bytes >> 10
    );
    assert!(end <= settled + 1024, "{path}: resident memory grows from {settled} to {end} KiB");
}

#[test]
#[ignore = "the child's part of resident_memory_does_not_grow"]
fn resident_memory_in_a_child() {
    with_host(&HostOptions::default(), |host| {
        let context = guest(host);
        let gaussians = cloud(150, 7);
        let scene = DeviceScene::upload(&context, &gaussians, 0).expect("a scene");
        let (settings, scenes) = (RenderSettings::default(), [(&scene).into()]);

        let mut renderer = Renderer::new(&context).expect("kernels");
        renderer.reserve(&Reservation { slots: 3, ..Reservation::new(150, 1, 64, 48) }).expect("memory");
        let in_flight = [0; 3].map(|_| InFlight::new(host).expect("a command buffer"));
        let reserved = context.memory_total().bytes;
        let recorded = measured(|number| {
            let (slot, frame) = (number % 3, &in_flight[(number % 3) as usize]);
            if number >= 3 {
                frame.wait(host).expect("done");
                assert!(renderer.slot_report(slot).expect("a report").is_some_and(|r| !r.overflow));
            }
            frame.begin(host).expect("recording");
            let camera = view(number);
            let recorded = RecordedFrame::new(&scenes, &camera, &settings);
            renderer.record(adopt(&context, frame), slot, &recorded).expect("a recording");
            frame.submit(host).expect("a submission");
        });
        in_flight.iter().for_each(|frame| frame.wait(host).expect("done"));
        assert_eq!(context.memory_total().bytes, reserved);
        report("recorded", recorded, reserved);
        in_flight.into_iter().for_each(|frame| frame.destroy(host));
        drop(renderer);

        let mut renderer = Renderer::new(&context).expect("kernels");
        renderer.upload(&gaussians).expect("a scene");
        let mut settled = 0;
        let owned = measured(|number| {
            if number == SETTLED {
                settled = context.memory_total().bytes;
            }
            renderer.render(&view(number), &settings).expect("a frame");
        });
        assert_eq!(context.memory_total().bytes, settled);
        report("owned", owned, settled);
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
    assert_eq!(lines.len(), 2, "both paths were measured: {said}");
}
