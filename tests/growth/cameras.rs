//! Cameras from files stay in double precision until they are stored.

use crate::cameras_json;
use crate::dataset::{Dataset, DatasetOptions};
use crate::images::{Photo, PhotoFileFormat};
use crate::progress::Progress;
use ashsplat::scene::{Camera, Intrinsics, WorldFrame};
use glam::{DMat3, DQuat, DVec3};

const INTRINSICS: Intrinsics = Intrinsics { fx: 5.0, fy: 5.0, cx: 2.0, cy: 1.0, width: 4, height: 2 };

/// Rotations, and positions away from the origin.
fn poses(count: u32) -> impl Iterator<Item = (DMat3, DVec3)> {
    (0..count).map(f64::from).map(|index| {
        let rotation = DQuat::from_xyzw(0.3, -0.2, 0.1 * index, 0.9).normalize();
        (DMat3::from_quat(rotation), DVec3::new(61.3, -17.9, 25.0 + 0.37 * index))
    })
}

/// Far from the origin, a camera's position is accurate to one unit in the last place, instead of accumulating an
/// error per operation.
#[test]
fn cameras_far_out_keep_their_place() {
    let (_turn, _folder, path) = super::alone("cameras.json");
    for (rotation, position) in poses(50) {
        let row = |i: usize| rotation.transpose().row(i).to_array();
        let text = format!(
            "[{{\"id\": 0, \"img_name\": \"a\", \"width\": 4, \"height\": 2, \"position\": {:?}, \"rotation\": {:?}, \
             \"fy\": 5.0, \"fx\": 5.0}}]",
            position.to_array(),
            [row(0), row(1), row(2)]
        );
        std::fs::write(&path, text).unwrap();
        let camera = cameras_json::read(&path, &WorldFrame::default()).unwrap()[0].camera;
        let exact = -(camera.camera_from_world.as_dmat3() * position);
        assert_eq!(camera.translation, exact.as_vec3());
        // The written camera is read back to the bit.
        cameras_json::write(&path, [("a", &camera)], &WorldFrame::default()).unwrap();
        assert_eq!(cameras_json::read(&path, &WorldFrame::default()).unwrap()[0].camera, camera);
    }
}

#[test]
fn cameras_that_look_from_far_out_keep_their_place() {
    let _turn = super::turn();
    let (eye, target) = (DVec3::new(1061.3, -517.9, 25.25), DVec3::new(1.0, 2.0, 3.0));
    let camera = Camera::look_at(eye.as_vec3(), target.as_vec3(), glam::Vec3::Z, INTRINSICS);
    let eye = eye.as_vec3().as_dvec3();
    assert_eq!(camera.translation, (-(camera.camera_from_world.as_dmat3() * eye)).as_vec3());
}

#[test]
fn frames_far_out_keep_their_place() {
    let _turn = super::turn();
    for (rotation, place) in poses(20) {
        let rows: Vec<_> =
            (0..3).map(|i| [rotation.row(i).to_array().to_vec(), vec![place[i]]].concat()).collect();
        let camera = load_posed(&format!("{rows:?}"), "\"k1\": 0.0").unwrap().train[0].camera;
        // From y up and z backward to y down and z forward.
        let exact = DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0)) * rotation.transpose() * place;
        assert_eq!(camera.translation, (-exact).as_vec3());
    }
}

/// Loads a transforms.json with matrices of 3 rows, and a lens.
fn load(lens: &str) -> Result<Dataset, String> {
    load_posed("[[1, 0, 0, 0.5], [0, 1, 0, 2], [0, 0, 1, 4]]", lens)
}

fn load_posed(matrix: &str, lens: &str) -> Result<Dataset, String> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    Photo { width: 40, height: 20, rgb: vec![7; 2400] }.write_png(path.join("a.png")).unwrap();
    let frames = format!("[{{\"file_path\": \"a.png\", \"transform_matrix\": {matrix}}}]");
    let text = format!("{{\"fl_x\": 20, \"w\": 40, \"h\": 20, {lens}, \"frames\": {frames}}}");
    std::fs::write(path.join("transforms.json"), text).unwrap();
    Dataset::load(path, &DatasetOptions::default(), Progress::NONE).map_err(|error| error.to_string())
}

#[test]
fn matrices_may_have_three_rows() {
    let _turn = super::turn();
    let camera = load("\"k1\": 0.0").unwrap().train[0].camera;
    assert_eq!(camera.position().to_array(), [0.5, 2.0, 4.0]);
}

#[test]
fn lenses_that_fold_the_photo_over_are_refused() {
    let _turn = super::turn();
    for lens in ["\"k1\": -0.05", "\"k1\": 0.2", "\"k1\": -0.1, \"k2\": 0.02"] {
        load(lens).unwrap();
    }
    for lens in
        ["\"k1\": -0.5", "\"k1\": -1.0, \"k2\": 0.4", "\"k1\": -3.0, \"k2\": 2.0", "\"k1\": 0.1, \"p1\": 0.6"]
    {
        let message = load(lens).unwrap_err();
        assert!(message.contains("frame a.png") && message.contains("folds the picture"), "{message}");
    }
}
