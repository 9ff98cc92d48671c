//! A viewer's failures are its own.

use super::*;
use crate::config::Settings;
use crate::train::tests::dataset;
use crate::view::protocol::{CameraMessage, Look, ViewRequest};
use ashsplat::scene::{Camera, Intrinsics, PointCloud};
use ashsplat::trainer::{TrainSettings, TrainView};
use ashsplat::vk::{ContextOptions, Fault, Faults};
use ashsplat_files::Photo;
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
        hub.set_view(page, ViewRequest { seq: 1, camera, look: Look::default(), follow: false });
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

/// A view that cannot be measured costs a curve its point, not the training its life.
#[test]
fn a_view_that_cannot_be_measured_is_told() {
    let lens = Intrinsics::from_fov_x(0.8, 16, 16);
    let camera = Camera::look_at(Vec3::NEG_Z, Vec3::ZERO, Vec3::NEG_Y, lens);
    let photo = |size: u32| Photo { width: size, height: size, rgb: vec![9; (3 * size * size) as usize] };
    let points = PointCloud { positions: vec![[0.0; 3], [0.2; 3]], colors: vec![[9; 3]; 2] };
    let context = Context::new(&ContextOptions::default()).expect("a device");
    let initial = ashsplat_files::initial_gaussians(&points, 0).expect("Gaussians");
    let views = vec![TrainView::new(camera, photo(16))];
    let settings = TrainSettings { sh_degree: 0, ..Default::default() };
    let mut trainer = Trainer::new(&context, views, &initial, 1.0, settings).expect("a trainer");
    let folder = tempfile::tempdir().expect("a temporary folder");
    let subject = Subject {
        name: "test".into(),
        gaussians: initial,
        base: trainer.render_settings(),
        cameras: Vec::new(),
        photos: None,
        note: None,
    };
    let (model, source) = (folder.path(), folder.path());
    let about = About { subject, device: "test", iterations: 9, model, source };
    let mut live = Live::start(any_port(), about).expect("a port");
    let view = |size: u32| View {
        name: "a.png".into(),
        image_id: 1,
        camera,
        original_camera: camera,
        photo: photo(size).into(),
    };
    trainer.step().expect("a step");
    live.measure_or_tell(&mut trainer, &view(8)).expect("training goes on");
    assert!(live.unmeasured && live.tested == 1);
    live.measure_or_tell(&mut trainer, &view(16)).expect("measured");
    assert_eq!(live.tested, 2);
    assert_eq!(
        live.curves.lock().expect("sound").status(0)["points"]["psnr"].as_array().map(Vec::len),
        Some(1)
    );
    live.tell(Error::DeviceLost { call: "a test" }).expect_err("nothing to go on with");
}
