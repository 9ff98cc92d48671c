//! Cameras of transforms.json: matrices and lenses.

use crate::dataset::{Dataset, DatasetOptions};
use crate::images::{Photo, PhotoFileFormat};
use crate::progress::Progress;

/// Loads a transforms.json with matrices of 3 rows, and a lens.
fn load(lens: &str) -> Result<Dataset, String> {
    let matrix = "[[1, 0, 0, 0.5], [0, 1, 0, 2], [0, 0, 1, 4]]";
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
