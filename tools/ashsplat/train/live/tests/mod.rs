//! A viewer's failures are its own.

use super::*;
use ashsplat::scene::{Camera, Intrinsics, PointCloud};
use ashsplat::trainer::{TrainSettings, TrainView};
use ashsplat::vk::ContextOptions;
use ashsplat_files::Photo;
use glam::Vec3;

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
    let arguments = LiveArguments {
        view: Some(0),
        view_host: "127.0.0.1".into(),
        view_token: None,
        view_share: 0.2,
        ip: None,
        port: 0,
    };
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
    let mut live = Live::start(&arguments, about).expect("a port");
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
