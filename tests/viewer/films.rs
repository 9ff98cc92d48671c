//! Camera paths as films.

use super::training::Training;
use super::*;
use crate::cli::succeed;
use std::path::PathBuf;
use std::process::Command;
use tempfile::{TempDir, tempdir};

/// A viewer of a small scene, and where it puts films.
struct Cinema {
    folder: TempDir,
    server: Server,
}

impl Cinema {
    fn open() -> Cinema {
        let folder = tempdir().expect("a temporary folder");
        let scene = write_ball(folder.path(), 200);
        let server = Server::view(&scene, &["-o", text(&folder.path().join("films"))]);
        Cinema { folder, server }
    }

    fn films(&self) -> PathBuf {
        self.folder.path().join("films")
    }

    /// What lies there, by name.
    fn files(&self) -> Vec<String> {
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
fn film(frames: u32, size: [u32; 2]) -> Value {
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
    /// The next word about a film that has something to say of this.
    fn hears(&mut self, key: &str) -> Value {
        loop {
            let film = self.wait_for("film");
            if !film[key].is_null() {
                return film[key].clone();
            }
        }
    }
}

fn pixels(folder: &Path, index: u32) -> Vec<u8> {
    image::open(folder.join(format!("{index:05}.png"))).expect("a PNG").to_rgb8().into_raw()
}

#[test]
fn viewer_makes_films() {
    let cinema = Cinema::open();
    let mut page = cinema.server.page();
    page.send(&film(6, [64, 48]));
    let files = page.hears("files");
    let gif = format!("/film/{}", files["gif"].as_str().expect("a GIF"));
    let (code, head, gif) = cinema.server.get(&gif, &[]);
    assert!(code == 200 && head.contains("image/gif"), "{head}");
    let decoder = image::codecs::gif::GifDecoder::new(std::io::Cursor::new(gif)).expect("a GIF");
    let frames = image::AnimationDecoder::into_frames(decoder).collect_frames().expect("frames");
    assert_eq!((frames.len(), frames[5].buffer().dimensions()), (6, (64, 48)));
    // Either a film, or why there is none.
    assert!(files["mp4"].is_string() != files["note"].is_string(), "{files}");
    // The path is one for `render`, which makes the same frames of it.
    let cameras = cinema.films().join(files["path"].as_str().expect("a path"));
    let (scene, again) = (cinema.folder.path().join("ball.ply"), cinema.folder.path().join("again"));
    succeed(&["render", text(&scene), "--path", text(&cameras), "-o", text(&again)]);
    let film = Path::new(files["frames"].as_str().expect("a folder"));
    for index in 0..6 {
        // Its cameras went through text: rounding may differ.
        let (a, b) = (pixels(film, index), pixels(&again, index));
        let worst = a.iter().zip(&b).map(|(a, b)| a.abs_diff(*b)).max();
        assert!(worst <= Some(2) && a.len() == b.len(), "frame {index}: {worst:?}");
    }
}

/// Sides that are odd and colours that ffmpeg must not shift.
#[test]
fn viewer_films_are_mp4_where_ffmpeg_is_installed() {
    if Command::new("ffmpeg").arg("-version").output().is_err() {
        return eprintln!("skipped: ffmpeg is not installed");
    }
    let cinema = Cinema::open();
    let mut page = cinema.server.page();
    let mut request = film(5, [161, 121]);
    request["look"] = json!({ "background": [0.9, 0.2, 0.1] });
    page.send(&request);
    let files = page.hears("files");
    let name = files["mp4"].as_str().unwrap_or_else(|| panic!("{files}"));
    let (code, head, bytes) = cinema.server.get(&format!("/film/{name}"), &[]);
    assert!(code == 200 && head.contains("video/mp4"), "{head}");
    let path = cinema.films().join(name);
    assert_eq!(std::fs::read(&path).expect("a file"), bytes);
    // As players see it: the tags say how its colours are meant.
    let decode = ["-f", "rawvideo", "-vf", "scale=in_color_matrix=auto", "-pix_fmt", "rgb24", "-"];
    let decoded = Command::new("ffmpeg").args(["-v", "error", "-i"]).arg(&path).args(decode).output();
    let decoded = decoded.expect("ffmpeg");
    assert!(decoded.status.success(), "{}", String::from_utf8_lossy(&decoded.stderr));
    let (width, height) = (162, 122);
    assert_eq!(decoded.stdout.len(), 5 * width * height * 3);
    let frames = Path::new(files["frames"].as_str().expect("a folder"));
    for (index, shown) in (0..).zip(decoded.stdout.chunks_exact(width * height * 3)) {
        let frame = pixels(frames, index);
        let rows = frame.chunks_exact(161 * 3).zip(shown.chunks_exact(width * 3));
        let errors: Vec<f64> =
            rows.flat_map(|(a, b)| a.iter().zip(b).map(|(a, b)| f64::from(a.abs_diff(*b)))).collect();
        let mean = errors.iter().sum::<f64>() / errors.len() as f64;
        assert!(mean < 4.0, "frame {index}: {mean}");
    }
    // Nothing half-done beside it.
    assert_eq!(cinema.files(), ["film_001", "film_001.gif", "film_001.json", "film_001.mp4"]);
}

#[test]
fn viewer_films_take_turns_and_can_be_called_off() {
    let cinema = Cinema::open();
    let [mut first, mut second, mut gone] = [(); 3].map(|()| cinema.server.page());
    // Longer than anybody waits.
    first.send(&film(3000, [64, 48]));
    assert_eq!(first.hears("waiting"), 0);
    first.hears("done");
    // Another page's waits, and calling it off leaves the first alone.
    second.send(&film(3, [32, 24]));
    assert_eq!(second.hears("waiting"), 1);
    second.send(&json!({ "type": "cancel" }));
    assert_eq!(second.hears("cancelled"), true);
    let done = first.hears("done").as_u64();
    assert!(first.hears("done").as_u64() > done, "it goes on");
    // A page has one film at a time.
    first.send(&film(3, [32, 24]));
    assert!(first.wait_for_problem().contains("cancel it first"));
    // Called off, it leaves nothing, and the next one comes.
    second.send(&film(3, [32, 24]));
    assert_eq!(second.hears("waiting"), 1);
    first.send(&json!({ "type": "cancel" }));
    assert_eq!(first.hears("cancelled"), true);
    assert_eq!(second.hears("files")["gif"], "film_001.gif");
    // A page that goes takes its film along.
    gone.send(&film(3000, [64, 48]));
    gone.hears("done");
    first.send(&film(2, [32, 24]));
    assert_eq!(first.hears("waiting"), 1);
    drop(gone);
    assert_eq!(first.hears("files")["gif"], "film_002.gif");
    let left = cinema.files();
    let stems: Vec<&str> = left.iter().map(|name| name.split('.').next().expect("a stem")).collect();
    assert!(stems.iter().all(|stem| ["film_001", "film_002"].contains(stem)), "{left:?}");
    assert_eq!(std::fs::read_dir(cinema.films().join("film_002")).expect("frames").count(), 2);
}

/// Training does not wait for a film, but its end does.
#[test]
fn viewer_films_of_a_training_are_made_to_their_end() {
    let mut training = Training::start(&["150", "--view=0", "--view-share", "0.05"], "viewer at ");
    let mut page = training.server.page();
    page.send(&film(150, [32, 24]));
    let files = page.hears("files");
    let frames = Path::new(files["frames"].as_str().expect("a folder"));
    assert_eq!(std::fs::read_dir(frames).expect("frames").count(), 150);
    let (code, stderr) = training.server.wait();
    assert_eq!(code, Some(0), "{stderr}");
    let gif = training.model().join("films").join(files["gif"].as_str().expect("a GIF"));
    assert!(gif.is_file(), "{}", gif.display());
}
