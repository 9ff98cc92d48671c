//! Costs of picks and motion.

use super::truth::{Screens, both, shifted};
use crate::cost::{print_stages, record_cost};
use crate::stage::*;
use std::time::Instant;

/// Prints the median milliseconds of the stages and of the frame, with and without both, measured in turn.
#[test]
#[ignore = "prints a table of the guide"]
fn costs() {
    with_host(&HostOptions::default(), |host| {
        let context = crate::cost::shipped(host, true);
        let scene = uploaded(&context, &cloud(200_000, 1));
        let mut renderer = Renderer::new(&context).expect("kernels");
        let wanted = Reservation::new(200_000, 1, 640, 480);
        let bytes = |wanted: &Reservation| renderer.reservation_bytes(wanted).expect("bytes") as f64;
        let mib = (bytes(&both(wanted)) - bytes(&wanted)) / 1024.0 / 1024.0;
        println!("{mib:.1} MiB more than {:.1}", bytes(&wanted) / 1024.0 / 1024.0);
        renderer.reserve(&both(wanted)).expect("memory");
        let screens = Screens::new(host, &context, [640, 480]);
        let view = camera(0.7, 640, 480);
        let before = shifted(&view, [0.01, 0.0, 0.0]);
        let placed = [Placed::from(&scene)];
        let plain = frame_of(&placed, &view);
        let pick = Some(screens.pick());
        let motion = Some(screens.motion(&before));
        let cases = [
            ("neither", plain),
            ("picks", RecordedFrame { pick, ..plain }),
            ("motion", RecordedFrame { motion, ..plain }),
            ("both", RecordedFrame { pick, motion, ..plain }),
        ];
        print_stages(host, &mut renderer, &cases, &["project", "blend", "compose"], 15);
    });
}

/// Prints microseconds of `record` with and without motion.
#[test]
#[ignore = "prints numbers of the guide"]
fn record_costs() {
    with_host(&HostOptions::default(), |host| {
        println!("scenes | motion | record, median us | fastest");
        for (scenes, frames) in [(1, 100), (64, 50), (2048, 15)] {
            for motion in [false, true] {
                let ([median, fastest], _) = record_cost(host, (scenes, false, motion), false, frames);
                println!("{scenes} | {motion} | {median:.0} | {fastest:.0}");
            }
        }
    });
}

/// Prints a reservation's pipelines and the milliseconds to build them all. MESA_SHADER_CACHE_DISABLE=true includes
/// the compiler.
#[test]
#[ignore = "prints numbers of the guide"]
fn pipelines() {
    println!("reserved | pipelines | milliseconds");
    for (name, [pick, motion]) in
        [("neither", [false; 2]), ("pick", [true, false]), ("motion", [false, true]), ("both", [true; 2])]
    {
        for occlusion in [false, true] {
            let host = Host::new(&HostOptions::default()).expect("a host");
            let context = crate::cost::shipped(&host, false);
            let wanted = Reservation { pick, motion, occlusion, ..Reservation::new(1000, 3, 64, 48) };
            let jobs = Renderer::kernel_jobs(&context, &wanted).expect("a list").len();
            let start = Instant::now();
            let renderer = reserved(&context, &wanted);
            let ms = start.elapsed().as_secs_f64() * 1e3;
            println!("{name}, occlusion {occlusion} | {jobs} | {ms:.0}");
            drop((renderer, context));
            host.destroy();
        }
    }
}
