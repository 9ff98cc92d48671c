//! A viewer's failure does not end the training.

use super::*;
use crate::train::tests::dataset;
use ashsplat::scene::{Camera, Intrinsics};
use ashsplat::vk::{ContextOptions, Fault, Faults};
use ashsplat_view::protocol::{CameraMessage, ViewRequest, ViewSettings};
use glam::Vec3;
use std::net::TcpStream;
use std::path::Path;
use tungstenite::{Message, WebSocket};

fn any_port() -> Port {
    let arguments = LiveArguments {
        view: Some(0),
        view_host: "127.0.0.1".into(),
        view_token: None,
        view_allow_origin: None,
        view_share: 0.2,
    };
    arguments.open().expect("a port").expect("an open one")
}

/// A run with a viewer, with its model in this folder.
fn looked_at(context: &Context, model: &Path) -> Run {
    let mut settings = Settings::reference();
    settings.data.model_path = model.to_owned();
    let mut run = Run::prepare(context, dataset(1.0), settings, true).expect("a run");
    run.serve(Some(any_port()), context, None).expect("a viewer");
    run
}

fn view() -> ViewRequest {
    let lens = Intrinsics::from_fov_x(0.8, 16, 16);
    let camera = CameraMessage::of(&Camera::look_at(Vec3::NEG_Z, Vec3::ZERO, Vec3::NEG_Y, lens));
    ViewRequest { seq: 1, camera, look: ViewSettings::default(), follow: false, as_photo: None }
}

fn page(run: &Run) -> WebSocket<TcpStream> {
    let live = run.live.as_ref().expect("a viewer");
    let address = live._server.address;
    let stream = TcpStream::connect(address).expect("a connection");
    stream.set_read_timeout(Some(Duration::from_secs(60))).expect("a time-out");
    let (mut page, _) = tungstenite::client(format!("ws://{address}/socket"), stream).expect("a page");
    assert!(page.read().expect("a greeting").is_text());
    page
}

fn train_and_save(run: &mut Run) {
    let (stop, mut watch) = (AtomicBool::new(false), Stopwatch::start());
    let report = run.trainer.step().expect("a step");
    run.show(&report, &stop, &mut watch);
    run.save(report.iteration, "").expect("saved");
    run.write_checkpoint().expect("saved");
    assert!(!stop.load(Ordering::Relaxed));
}

/// A panic on the server's threads ends its page. A panic while drawing, or the server's end, ends the viewer.
#[test]
fn panics_and_ends_of_the_viewer_are_its_own() {
    let context = Context::new(&ContextOptions::default()).expect("a device");
    let folder = tempfile::tempdir().expect("a temporary folder");
    let mut run = looked_at(&context, folder.path());
    let hub = run.live.as_ref().expect("a viewer").hub.clone();
    hub.set_status(|since| if since == 7 { panic!("wanted by the test") } else { "fine".to_owned() });
    let ask = |since: u32| Message::text(json!({ "type": "status", "since": since }).to_string());
    let mut first = page(&run);
    first.send(ask(7)).expect("sent");
    while first.read().is_ok() {}
    let begin = Instant::now();
    while hub.pages() > 0 {
        assert!(begin.elapsed() < Duration::from_secs(60), "the page that is gone is still counted");
        std::thread::sleep(Duration::from_millis(5));
    }
    // A silent page would be dropped.
    let mut other = page(&run);
    other.send(ask(0)).expect("sent");
    while other.read().expect("an answer").to_text().is_ok_and(|text| text != "fine") {}
    train_and_save(&mut run);
    assert!(run.live.is_some());
    // A panic on the training thread while it serves viewers: a share of 0 gives an infinite debt.
    run.live.as_mut().expect("a viewer").allowance = Allowance::new(0.0);
    let (page, _outbox) = hub.join().expect("room");
    hub.set_view(page, view());
    train_and_save(&mut run);
    assert!(run.live.is_none());
    train_and_save(&mut run);
}

/// If the device fails at a picture for a page, the viewer ends and training continues.
#[test]
fn a_viewer_that_fails_ends_alone() {
    let faults = Faults::new();
    let limit = Some(Duration::from_secs(60));
    let options = ContextOptions { faults: Some(faults.clone()), timeout: limit, ..Default::default() };
    let context = Context::new(&options).expect("a device");
    let folder = tempfile::tempdir().expect("a temporary folder");
    let mut run = looked_at(&context, folder.path());
    let (stop, mut watch) = (AtomicBool::new(false), Stopwatch::start());
    let hub = run.live.as_ref().expect("a viewer").hub.clone();
    let (page, _outbox) = hub.join().expect("room");
    // After an allocation failure the viewer continues; after a picture that times out it does not.
    for (fault, ends) in [(Fault::Object, false), (Fault::WaitMemory, false), (Fault::Timeout, true)] {
        let report = run.trainer.step().expect("a step");
        hub.acknowledge(page);
        hub.set_view(page, view());
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
    // The thread that waits for the timed-out picture may need a moment.
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
