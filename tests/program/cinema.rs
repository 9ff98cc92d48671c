//! Films that the viewer records.

use super::page::{Page, Server, camera, message, write_ball};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use tempfile::{TempDir, tempdir};

/// A viewer of a small scene, and the folder for its films.
pub struct Cinema {
    pub folder: TempDir,
    pub server: Server,
}

impl Cinema {
    pub fn open() -> Cinema {
        let folder = tempdir().expect("a temporary folder");
        let scene = write_ball(folder.path(), 200);
        let films = folder.path().join("films");
        let server = Server::view(&scene, &["-o", films.to_str().expect("UTF-8")]);
        Cinema { folder, server }
    }

    pub fn films(&self) -> PathBuf {
        self.folder.path().join("films")
    }

    pub fn files(&self) -> Vec<String> {
        let entries = std::fs::read_dir(self.films()).expect("a folder");
        let name = |entry: std::io::Result<std::fs::DirEntry>| {
            entry.expect("an entry").file_name().to_string_lossy().into_owned()
        };
        let mut names: Vec<String> = entries.map(name).collect();
        names.sort();
        names
    }
}

/// A film around the scene.
pub fn film(frames: u32, size: [u32; 2]) -> Value {
    let key = |turn: f32| {
        let camera = camera(turn);
        let rows = message(&camera)["rotation"].clone();
        json!({ "position": camera.position().to_array(), "rotation": rows, "fov_y": 0.7 })
    };
    json!({
        "type": "film", "keys": [key(0.0), key(0.5), key(1.0)], "seconds": frames, "frames_per_second": 1,
        "width": size[0], "height": size[1],
    })
}

impl Page {
    /// Waits for the next film message with a value for `key`.
    pub fn hears(&mut self, key: &str) -> Value {
        loop {
            let film = self.wait_for("film");
            if !film[key].is_null() {
                return film[key].clone();
            }
        }
    }
}

pub fn pixels(folder: &Path, index: u32) -> Vec<u8> {
    image::open(folder.join(format!("{index:05}.png"))).expect("a PNG").to_rgb8().into_raw()
}
