//! A training that cannot start.

use super::*;
use crate::config::{CAMERAS_FILE, CFG_ARGS_FILE, SETTINGS_FILE};
use ashsplat::io::Photo;
use ashsplat::scene::{Camera, Intrinsics, PointCloud};
use ashsplat::vk::ContextOptions;
use glam::Vec3;

/// The trainer refuses a scene without extent; what an earlier run left is as it was.
#[test]
fn a_training_that_cannot_start_leaves_the_model_alone() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let files = [SETTINGS_FILE, CFG_ARGS_FILE, CAMERAS_FILE, eval::RESULTS_FILE, "input.ply"];
    files.iter().for_each(|name| std::fs::write(folder.path().join(name), "old").expect("written"));
    let camera = Camera::look_at(Vec3::NEG_Z, Vec3::ZERO, Vec3::NEG_Y, Intrinsics::from_fov_x(0.8, 16, 16));
    let photo = Photo { width: 16, height: 16, rgb: vec![0; 16 * 16 * 3] };
    let (name, original_camera) = ("a.png".into(), camera);
    let dataset = Dataset {
        train: vec![View { name, image_id: 1, camera, original_camera, photo: photo.into() }],
        test: Vec::new(),
        points: PointCloud { positions: vec![[0.0; 3]; 4], colors: vec![[9; 3]; 4] },
        scene_extent: 0.0,
        source: PathBuf::new(),
        warnings: Vec::new(),
    };
    let mut settings = Settings::default();
    settings.data.model_path = folder.path().to_owned();
    let context = Context::new(&ContextOptions::default()).expect("a device");
    let refused = Run::prepare(&context, dataset, settings, true).err().expect("refused");
    assert!(refused.to_string().contains("scene extent"), "{refused}");
    for name in files {
        assert_eq!(std::fs::read_to_string(folder.path().join(name)).expect(name), "old");
    }
    assert_eq!(std::fs::read_dir(folder.path()).expect("the folder").count(), files.len());
}
