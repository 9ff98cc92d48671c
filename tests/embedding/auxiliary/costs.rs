//! Costs of picks and motion.

use super::truth::{Screens, both, shifted};
use crate::cost::print_stages;
use crate::stage::*;

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
