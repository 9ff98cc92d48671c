//! Names of photos: long, deep, many, missing.

use super::{assert_linear, inspect, on_a_small_stack};
use crate::images::{Photo, PhotoFileFormat};
use serde_json::json;
use std::path::Path;

/// A transforms.json with these paths; each frame has a different focal length.
fn write(folder: &Path, paths: &[String], key: &str) {
    let frame = |(index, path): (usize, &String)| {
        let mut frame = json!({
            "file_path": "images/a.png", "fl_x": 20.0 + index as f64,
            "transform_matrix": [[1, 0, 0, index], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]],
        });
        frame[key] = json!(path);
        frame
    };
    let frames: Vec<_> = paths.iter().enumerate().map(frame).collect();
    let document = json!({ "w": 4, "h": 2, "frames": frames });
    std::fs::write(folder.join("transforms.json"), document.to_string()).unwrap();
    std::fs::create_dir_all(folder.join("images")).unwrap();
    Photo { width: 4, height: 2, rgb: vec![7; 24] }.write_png(folder.join("images/a.png")).unwrap();
}

fn colmap(folder: &Path, names: &[String]) {
    let sparse = folder.join("sparse/0");
    std::fs::create_dir_all(&sparse).unwrap();
    std::fs::create_dir_all(folder.join("images")).unwrap();
    std::fs::write(sparse.join("cameras.txt"), "1 PINHOLE 4 2 5 5 2 1\n").unwrap();
    let row = |(index, name): (usize, &String)| format!("{} 1 0 0 0 0 0 {index} 1 {name}\n\n", index + 1);
    let rows: String = names.iter().enumerate().map(row).collect();
    std::fs::write(sparse.join("images.txt"), rows).unwrap();
}

fn refused(folder: &Path, words: &str) {
    let report = inspect(folder);
    assert!(report.problems.iter().any(|problem| problem.contains(words)), "{report}");
    assert!(report.problems.iter().all(|problem| problem.len() < 600), "{report}");
}

#[test]
fn paths_of_many_folders_need_no_stack() {
    on_a_small_stack(|| {
        for key in ["file_path", "mask_path"] {
            for (path, words) in [
                ("a/".repeat(8000) + "x.png", "is a path of 16005 bytes"),
                ("../".to_owned() + &"a/".repeat(8000), "is a path of 16003 bytes"),
            ] {
                let folder = tempfile::tempdir().unwrap();
                write(folder.path(), &[path], key);
                refused(folder.path(), words);
            }
        }
        let folder = tempfile::tempdir().unwrap();
        colmap(folder.path(), &["a/".repeat(8000) + "x.png"]);
        refused(folder.path(), "the name has 16005 bytes");
    });
}

#[test]
fn folders_within_folders_need_no_stack() {
    on_a_small_stack(|| {
        let folder = tempfile::tempdir().unwrap();
        colmap(folder.path(), &["x.png".into()]);
        let deep = folder.path().join("images").join("a/".repeat(900));
        std::fs::create_dir_all(&deep).unwrap();
        std::fs::write(deep.join("b.png"), "").unwrap();
        std::fs::write(deep.join("c.png"), "").unwrap();
        let report = inspect(folder.path());
        assert!(report.warnings.iter().any(|w| w.contains("only 1 of its 2 photos")), "{report}");
    });
}

/// Missing folders, and existing ones.
#[test]
fn a_path_of_many_folders_that_leads_out() {
    for (key, step, size) in
        [("file_path", "a/", 500), ("mask_path", "a/", 500), ("file_path", "images/", 128)]
    {
        let write = |folder: &Path, size: usize| {
            write(folder, &["../".to_owned() + &step.repeat(size)], key);
            std::fs::create_dir_all(folder.join("images/".repeat(16))).unwrap();
        };
        assert_linear(size, write, |folder| refused(folder, "leads out of the folder"));
    }
}

/// Paths of frames that lead out; photos that are missing, each with its own lens; and photos under another case,
/// for which a folder is listed once, instead of once per name.
#[test]
fn many_paths() {
    let paths = |size: usize, path: &dyn Fn(usize) -> String| (0..size).map(path).collect::<Vec<String>>();
    let write_outside = |folder: &Path, size: usize| {
        write(folder, &paths(size, &|index| format!("/home/me/{index}/images/A.png")), "file_path");
    };
    assert_linear(100, write_outside, |folder| assert!(inspect(folder).is_sound()));
    let missing = |size| paths(size, &|index| format!("images/{index}.png"));
    let of_frames = |folder: &Path, size: usize| write(folder, &missing(size), "file_path");
    let of_a_model = |folder: &Path, size: usize| colmap(folder, &missing(size));
    for write in [&of_frames as &dyn Fn(&Path, usize), &of_a_model] {
        assert_linear(250, write, |folder| assert!(inspect(folder).problems.len() >= 250));
    }
    let of_another_case = |folder: &Path, size: usize| {
        write(folder, &paths(size, &|index| format!("images/img_{index}.png")), "file_path");
        for index in 0..size {
            std::fs::copy(folder.join("images/a.png"), folder.join(format!("images/IMG_{index}.PNG")))
                .unwrap();
        }
    };
    assert_linear(100, of_another_case, |folder| assert!(inspect(folder).is_sound()));
}

/// macOS stores accents separately from their letters, other systems as one character.
#[test]
fn accents_are_found_in_either_form() {
    let _turn = super::turn();
    for (named, there) in [("cafe\u{301}.png", "caf\u{e9}.png"), ("Caf\u{e9}", "cafe\u{301}.PNG")] {
        let folder = tempfile::tempdir().unwrap();
        write(folder.path(), &[format!("e\u{301}te/{named}")], "file_path");
        std::fs::create_dir(folder.path().join("\u{e9}te")).unwrap();
        std::fs::rename(folder.path().join("images/a.png"), folder.path().join("\u{e9}te").join(there))
            .unwrap();
        let report = inspect(folder.path());
        assert!(report.is_sound(), "{report}");
    }
}
