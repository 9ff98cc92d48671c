//! Frames in flight, changing sizes and cameras, several renderers, insufficient capacity.

use crate::stage::*;
use std::sync::Mutex;

#[test]
fn a_recorded_frame_is_the_owned_paths_to_the_bit() {
    let (gaussians, camera) = (cloud(1500, 3), camera(0.4, 150, 100));
    let settings = RenderSettings { inverse_depth: true, ..RenderSettings::default() };
    let expected = owned(&gaussians, &camera, &settings);
    with_each_guest(|host, context| {
        let scene = uploaded(&context, &gaussians);
        let reservation = Reservation { inverse_depth: true, ..Reservation::new(1500, 1, 150, 100) };
        let mut renderer = reserved(&context, &reservation);
        let scenes = [(&scene).into()];
        let pixels = rendered(host, &mut renderer, &RecordedFrame::new(&scenes, &camera, &settings));
        assert_same(&pixels, &expected);
        let report = report_of(&mut renderer, 0);
        assert_eq!(report.visible, expected.stats.visible);
        assert_eq!(report.instances_needed, expected.stats.instances);
        assert!(!report.overflow && report.gaussians == 1500, "{report:?}");
        if context.limits().timestamp_period_ns > 0.0 {
            assert!(report.scopes.iter().any(|s| s.name == "blend" && s.nanoseconds > 0.0), "{report:?}");
        }
        // [`Renderer::render`], which submits by itself, works on the host's queue as well.
        renderer.upload(&gaussians).expect("a scene");
        let frame = renderer.render(&camera, &settings).expect("a frame");
        assert_eq!(frame.color, expected.color);
    });
}

/// Threads render with their own renderers on one context; the host gives its queue to one thread at a time.
#[test]
fn renderers_may_be_used_by_different_threads() {
    with_guest(|host, context| {
        let queue = Mutex::new(());
        std::thread::scope(|threads| {
            for number in 0..3 {
                let (context, queue) = (context.clone(), &queue);
                threads.spawn(move || {
                    let locked = || queue.lock().expect("no panic while held");
                    let gaussians = cloud(300 + 50 * number, number as u32);
                    let scene = {
                        let _queue = locked();
                        uploaded(&context, &gaussians)
                    };
                    let mut renderer = reserved(&context, &Reservation::new(600, 1, 64, 48));
                    let scenes = [(&scene).into()];
                    for turn in [0.5, 1.5, 2.5] {
                        let camera = camera(turn, 64, 48);
                        // Only one thread at a time may use the host's command pool, like its queue.
                        let pixels = {
                            let _queue = locked();
                            rendered(host, &mut renderer, &frame_of(&scenes, &camera))
                        };
                        assert_same(&pixels, &owned(&gaussians, &camera, &SETTINGS));
                    }
                });
            }
        });
    });
}

/// Draws a thousand frames of changing size and camera in three slots. `before` is called with each frame's number,
/// and with the number of frames at the end.
pub fn draw_a_thousand(host: &Host, context: &Context, mut before: impl FnMut(u32)) {
    let scene = uploaded(context, &cloud(150, 7));
    let mut renderer = reserved(context, &Reservation { slots: 3, ..Reservation::new(150, 1, 64, 48) });
    let scenes = [(&scene).into()];
    let frames = [0; 3].map(|_| Commands::new(host));
    let memory = context.memory();
    for number in 0..1000 {
        before(number);
        let (slot, frame) = (number % 3, &frames[(number % 3) as usize]);
        if number >= 3 {
            frame.wait();
            let report = report_of(&mut renderer, slot);
            assert!(!report.overflow, "frame {number}: {report:?}");
        }
        let camera = changing_view(number);
        renderer.record(frame.begun(context), slot, &frame_of(&scenes, &camera)).expect("a recording");
        frame.submit();
    }
    frames.iter().for_each(Commands::wait);
    before(1000);
    assert_eq!(context.memory(), memory);
}

/// A camera whose picture is never larger than 64 x 48 pixels.
pub fn changing_view(number: u32) -> Camera {
    camera(number as f32 * 0.1, 1 + number * 7 % 64, 1 + number * 5 % 48)
}

#[test]
fn a_frame_without_room_says_what_it_needs() {
    with_guest(|host, context| {
        let (gaussians, camera) = (cloud(800, 9), camera(0.2, 96, 96));
        let scene = uploaded(&context, &gaussians);
        let small = Reservation { instances: 100, ..Reservation::new(800, 1, 96, 96) };
        let mut renderer = reserved(&context, &small);
        let scenes = [(&scene).into()];
        let frame = frame_of(&scenes, &camera);
        rendered(host, &mut renderer, &frame);
        let report = report_of(&mut renderer, 0);
        assert!(report.overflow && report.instances_needed > report.instance_capacity, "{report:?}");
        let grown = small.grown(&report);
        assert!(grown.instances >= report.instances_needed);
        renderer.reserve(&grown).expect("memory");
        assert_drawn(host, &mut renderer, &frame, &gaussians);
        let report = report_of(&mut renderer, 0);
        assert!(!report.overflow, "{report:?}");
        assert_eq!(grown.grown(&report), grown);
        // No reservation fits a number that cannot be counted.
        let mut uncounted = report;
        (uncounted.overflow, uncounted.instances_needed) = (true, u32::MAX);
        assert_eq!(small.grown(&uncounted), small);
    });
}

/// A tile with more entries than two passes take, if the driver limits loops. Otherwise one pass is enough.
#[test]
fn long_tiles_are_blended_in_several_passes() {
    with_guest(|host, context| {
        let (gaussians, camera) = (cloud(30_000, 9), camera(0.2, 16, 16));
        let scene = uploaded(&context, &gaussians);
        let mut renderer = Renderer::new(&context).expect("kernels");
        let estimated = Reservation::new(scene.count(), 1, 16, 16);
        let scenes = [(&scene).into()];
        let frame = frame_of(&scenes, &camera);
        let mut passes = |wanted: &Reservation| {
            renderer.reserve(wanted).expect("memory");
            let pixels = rendered(host, &mut renderer, &frame);
            let report = report_of(&mut renderer, 0);
            assert_eq!(report.overflow, report.blend_passes < report.blend_passes_needed, "{report:?}");
            if !report.overflow {
                assert_same(&pixels, &owned(&gaussians, &camera, &SETTINGS));
            }
            report
        };
        let report = passes(&Reservation { blend_passes: 1, ..estimated });
        let is_bounded = context.limits().max_loop_iterations.is_some();
        assert_eq!(report.overflow, is_bounded, "{report:?}");
        let report = passes(&estimated);
        assert_eq!(report.blend_passes, if is_bounded { 2 } else { 1 });
        let grown = estimated.grown(&report);
        assert_eq!(grown == estimated, !report.overflow, "{grown:?}");
        let report = passes(&grown);
        assert!(!report.overflow, "{report:?}");
        assert_eq!(grown.grown(&report), grown);
    });
}

#[test]
fn the_first_frame_that_is_reserved_for_is_whole() {
    with_guest(|host, context| {
        let (mut gaussians, camera) = (cloud(600, 9), camera(0.2, 96, 96));
        gaussians.log_scales.iter_mut().flatten().for_each(|s| *s += 3.0);
        let scene = uploaded(&context, &gaussians);
        let scenes = [(&scene).into()];
        let frame = frame_of(&scenes, &camera);
        let wanted = Reservation { slots: 2, ..Reservation::new(600, 1, 96, 96) };
        // A plain reservation cuts the frame off.
        let mut renderer = reserved(&context, &wanted);
        rendered(host, &mut renderer, &frame);
        assert!(report_of(&mut renderer, 0).overflow);
        let reserved = renderer.reserve_for(&wanted, &frame).expect("memory");
        assert_eq!((reserved.slots, reserved.gaussians), (2, 600));
        assert_eq!(renderer.slot_report(0).expect("none"), None);
        let expected = owned(&gaussians, &camera, &SETTINGS);
        assert!(reserved.instances >= expected.stats.instances);
        assert_same(&rendered(host, &mut renderer, &frame), &expected);
        assert!(!report_of(&mut renderer, 0).overflow);
        // A reservation that fits stays; a feature that is not reserved is refused.
        let few = cloud(20, 9);
        let scene = uploaded(&context, &few);
        let scenes = [(&scene).into()];
        let small = frame_of(&scenes, &camera);
        assert_eq!(renderer.reserve_for(&wanted, &small).expect("memory"), wanted);
        assert_error(renderer.reserve_for(&Reservation::new(10, 1, 96, 96), &small), "20 Gaussians");
    });
}
