//! Trainings that cannot start, and the files that failures leave.

mod following;

use super::*;
use ashsplat::scene::{Camera, Intrinsics, PointCloud, WorldFrame};
use ashsplat::train::{Actions, Checkpoint};
use ashsplat::vk::{ContextOptions, Fault, Faults};
use ashsplat_files::{CheckpointFile, Photo, View};
use ashsplat_program::model;
use glam::Vec3;

pub(super) fn dataset(scene_extent: f32) -> Dataset {
    let camera = Camera::look_at(Vec3::NEG_Z, Vec3::ZERO, Vec3::NEG_Y, Intrinsics::from_fov_x(0.8, 16, 16));
    let photo = Photo { width: 16, height: 16, rgb: vec![0; 16 * 16 * 3] };
    let (name, original_camera) = ("a.png".into(), camera);
    let positions = vec![[0.0; 3], [0.2, 0.0, 0.0], [0.0, 0.2, 0.0], [0.2; 3]];
    Dataset {
        frame: WorldFrame::default(),
        notes: Vec::new(),
        train: vec![View {
            name,
            image_id: 1,
            camera_id: 1,
            camera,
            original_camera,
            photo: photo.into(),
            inverse_depth: None,
            depth_points: None,
        }],
        test: Vec::new(),
        points: PointCloud { positions, colors: vec![[9; 3]; 4] },
        scene_extent,
        source: PathBuf::new(),
        warnings: Vec::new(),
    }
}

/// Waits and calls of the third iteration, which begins with an opacity reset, fail one at a time.
#[test]
fn a_failed_iteration_saves_only_what_is_known_and_seen() {
    let faults = Faults::new();
    let options = ContextOptions { faults: Some(faults.clone()), ..Default::default() };
    let context = Context::new(&options).expect("a device");
    let (mut seen, mut reset, mut unknown) = (0, 0, 0);
    for (fault, index) in
        (0..30).step_by(2).map(|i| (Fault::Object, i)).chain((0..3).map(|i| (Fault::WaitMemory, i)))
    {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let mut settings = Settings::reference();
        settings.data.model_path = folder.path().to_owned();
        settings.train.opacity_reset_interval = 2;
        let mut run = Run::prepare(&context, dataset(1.0), settings, true).expect("a run");
        for _ in 0..2 {
            let report = run.trainer.step().expect("a step");
            run.account(&report);
        }
        faults.arm(fault, index);
        let failed = run.trainer.step().is_err();
        faults.disarm();
        if !failed {
            continue;
        }
        run.rescue();
        let scene = model::point_cloud_path(folder.path(), 2).is_file();
        let checkpoint = Checkpoint::read(model::checkpoint_path(folder.path(), 2));
        match (fault, checkpoint) {
            (Fault::WaitMemory, Err(_)) => {
                assert!(!scene, "the state is unknown");
                unknown += 1;
            }
            (_, checkpoint) => {
                let due = checkpoint.expect("one").due.contains(Actions::RESET_OPACITY);
                assert_eq!(scene, due, "{fault:?} {index}");
                *(if due { &mut seen } else { &mut reset }) += 1;
            }
        }
    }
    assert!(seen > 0 && reset > 0 && unknown > 0, "{seen} {reset} {unknown}");
}

/// With a lost device, only the older checkpoint remains, and the error names it.
#[test]
fn a_lost_device_leaves_the_older_checkpoint() {
    let faults = Faults::new();
    let options = ContextOptions { faults: Some(faults.clone()), ..Default::default() };
    let context = Context::new(&options).expect("a device");
    let folder = tempfile::tempdir().expect("a temporary folder");
    let mut settings = Settings::reference();
    settings.data.model_path = folder.path().to_owned();
    let mut run = Run::prepare(&context, dataset(1.0), settings, true).expect("a run");
    assert_eq!(run.older_checkpoint(), None);
    for iteration in 1..=2 {
        let report = run.trainer.step().expect("a step");
        run.account(&report);
        if iteration == 1 {
            run.write_checkpoint().expect("written");
        }
    }
    faults.arm(Fault::SubmitLost, 0);
    assert!(matches!(run.trainer.step(), Err(Error::DeviceLost { .. })));
    run.rescue();
    let advice = run.older_checkpoint().expect("there is one");
    assert!(advice.contains("from iteration 1, ashsplat train --config "), "{advice}");
    assert!(advice.contains("--start-checkpoint latest"), "{advice}");
    Checkpoint::read(model::checkpoint_path(folder.path(), 1)).expect("as it was");
    assert!(!model::checkpoint_path(folder.path(), 2).exists());
    assert!(!model::point_cloud_path(folder.path(), 2).exists());
}
