//! A viewer's failures are its own.

use super::*;
use crate::config::Settings;
use crate::train::tests::dataset;
use crate::view::protocol::{CameraMessage, Look, ViewRequest};
use ashsplat::scene::{Camera, Intrinsics};
use ashsplat::vk::{ContextOptions, Fault, Faults};
use glam::Vec3;

fn any_port() -> Doors {
    let arguments = LiveArguments {
        view: Some(0),
        view_host: "127.0.0.1".into(),
        view_token: None,
        view_share: 0.2,
        ip: None,
        port: 0,
    };
    arguments.open().expect("a port").expect("an open one")
}

/// The device fails with a picture for a page: that is the viewer's end, and not the training's.
#[test]
fn a_viewer_that_fails_ends_alone() {
    let faults = Faults::new();
    let limit = Some(Duration::from_secs(60));
    let options = ContextOptions { faults: Some(faults.clone()), timeout: limit, ..Default::default() };
    let context = Context::new(&options).expect("a device");
    let folder = tempfile::tempdir().expect("a temporary folder");
    let mut settings = Settings::default();
    settings.data.model_path = folder.path().to_owned();
    let mut run = Run::prepare(&context, dataset(1.0), settings, true).expect("a run");
    run.look_on(Some(any_port()), &context, None).expect("a viewer");
    let (stop, mut watch) = (AtomicBool::new(false), Stopwatch::start());
    let lens = Intrinsics::from_fov_x(0.8, 16, 16);
    let camera = Camera::look_at(Vec3::NEG_Z, Vec3::ZERO, Vec3::NEG_Y, lens);
    let camera = CameraMessage::of(&camera);
    let hub = run.live.as_ref().expect("a viewer").hub.clone();
    let (page, _outbox) = hub.join().expect("room");
    // After too little memory the viewer goes on, after a picture that is not over in time it does not.
    for (fault, ends) in [(Fault::Object, false), (Fault::WaitMemory, false), (Fault::Timeout, true)] {
        let report = run.trainer.step().expect("a step");
        hub.acknowledge(page);
        let look = Look::default();
        hub.set_view(page, ViewRequest { seq: 1, camera, look, follow: false, as_photo: None });
        run.live.as_mut().expect("a viewer").allowance = Allowance::new(0.2);
        let before = faults.injected();
        faults.arm(fault, 0);
        run.show(&report, &stop, &mut watch);
        faults.disarm();
        assert_eq!(faults.injected(), before + 1, "{fault:?}");
        assert!(run.live.is_none() == ends && !stop.load(Ordering::Relaxed), "{fault:?}");
    }
    let report = run.trainer.step().expect("training goes on");
    run.show(&report, &stop, &mut watch);
    run.end_show(&stop);
    // The thread that waits for what was not over in time may need a moment.
    let mut saved = run.save(report.iteration, "");
    for _ in 0..500 {
        if saved.is_ok() {
            break;
        }
        std::thread::sleep(Duration::from_millis(10));
        saved = run.save(report.iteration, "");
    }
    saved.expect("saved");
    run.write_checkpoint().expect("saved");
}
