//! Camera paths as films.

use super::training::Training;
use super::*;
use crate::program::cinema::{Cinema, film, pixels};

#[test]
fn viewer_makes_films() {
    let cinema = Cinema::open();
    let mut page = cinema.server.page();
    page.send(&film(6, [64, 48]));
    let files = page.hears("files");
    let gif = format!("/film/{}", files["gif"].as_str().expect("a GIF"));
    let (code, head, gif) = cinema.server.get(&gif, &[]);
    assert!(code == 200 && head.contains("image/gif"), "{head}");
    // Other files of the folder are not served.
    for other in ["film_900.gif", "secret.json"] {
        std::fs::write(cinema.films().join(other), "older").expect("written");
        assert_eq!(cinema.server.get(&format!("/film/{other}"), &[]).0, 404, "{other}");
        std::fs::remove_file(cinema.films().join(other)).expect("removed");
    }
    let path = format!("/film/{}", files["path"].as_str().expect("a path"));
    assert_eq!(cinema.server.get(&path, &[]).0, 200);
    let decoder = image::codecs::gif::GifDecoder::new(std::io::Cursor::new(gif)).expect("a GIF");
    let frames = image::AnimationDecoder::into_frames(decoder).collect_frames().expect("frames");
    assert_eq!((frames.len(), frames[5].buffer().dimensions()), (6, (64, 48)));
    let milliseconds = frames.iter().map(|frame| frame.delay().numer_denom_ms());
    assert_eq!(milliseconds.map(|(ms, parts)| ms / parts).sum::<u32>(), 6000);
    // Either a film, or a note why there is none.
    assert!(files["mp4"].is_string() != files["note"].is_string(), "{files}");
    // `render` accepts the path and makes the same frames.
    let cameras = cinema.films().join(files["path"].as_str().expect("a path"));
    let [scene, again] = ["ball.ply", "again"].map(|name| cinema.folder.path().join(name));
    crate::cli::succeed(&["render", text(&scene), "--path", text(&cameras), "-o", text(&again)]);
    let film = Path::new(files["frames"].as_str().expect("a folder"));
    for index in 0..6 {
        // The cameras were written as text, so rounding may differ.
        let (a, b) = (pixels(film, index), pixels(&again, index));
        let worst = a.iter().zip(&b).map(|(a, b)| a.abs_diff(*b)).max();
        assert!(worst <= Some(2) && a.len() == b.len(), "frame {index}: {worst:?}");
    }
}

#[test]
fn viewer_films_take_turns_and_can_be_called_off() {
    let cinema = Cinema::open();
    let [mut first, mut second, mut gone] = [(); 3].map(|()| cinema.server.page());
    // Far longer than the test runs.
    first.send(&film(3000, [64, 48]));
    assert_eq!(first.hears("waiting"), 0);
    first.hears("done");
    // Another page's film waits, and cancelling it does not affect the first.
    second.send(&film(3, [32, 24]));
    assert_eq!(second.hears("waiting"), 1);
    second.send(&json!({ "type": "cancel" }));
    assert_eq!(second.hears("cancelled"), true);
    let done = first.hears("done").as_u64();
    assert!(first.hears("done").as_u64() > done, "it goes on");
    // A page has one film at a time.
    first.send(&film(3, [32, 24]));
    assert!(first.wait_for_problem().contains("cancel it first"));
    // A cancelled film leaves no files, and the next one starts.
    second.send(&film(3, [32, 24]));
    assert_eq!(second.hears("waiting"), 1);
    first.send(&json!({ "type": "cancel" }));
    assert_eq!(first.hears("cancelled"), true);
    assert_eq!(second.hears("files")["gif"], "film_001.gif");
    // A page that closes cancels its film.
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

/// Training does not wait for a film, but the program does at its end.
#[test]
fn viewer_films_of_a_training_are_made_to_their_end() {
    let mut training = Training::start("150 --view-share 0.05");
    let mut page = training.server.page();
    page.send(&film(150, [32, 24]));
    let files = page.hears("files");
    let frames = Path::new(files["frames"].as_str().expect("a folder"));
    assert_eq!(std::fs::read_dir(frames).expect("frames").count(), 150);
    let (code, stderr) = training.server.wait();
    assert_eq!(code, Some(0), "{stderr}");
    let gif = files["gif"].as_str().expect("a GIF");
    assert!(training.place.at("model/films").join(gif).is_file(), "{gif}");
}
