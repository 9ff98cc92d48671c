//! Views with the exposure of their photo and the effects of its lens.

use super::training::Training;
use super::*;
use crate::cli::{succeed, write_dataset};
use ashsplat::scene::WorldFrame;
use ashsplat_files::cameras_json;
use tempfile::tempdir;

/// The view of a scene's camera, with or without its photo's exposure and lens.
fn shown(page: &mut Page, place: usize, as_photo: Option<usize>) -> Vec<u8> {
    let camera = page.greeting["cameras"][place]["camera"].clone();
    let look = json!({ "quality": 0 });
    page.send(&json!({ "type": "view", "seq": 1, "camera": camera, "look": look, "as_photo": as_photo }));
    let shown = page.frame().rgb();
    page.send(&json!({ "type": "ack" }));
    shown
}

fn mean_difference(a: &[u8], b: &[u8]) -> f64 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(|(a, b)| f64::from(a.abs_diff(*b))).sum::<f64>() / a.len() as f64
}

fn place_of(page: &Page, name: &str) -> usize {
    let cameras = page.greeting["cameras"].as_array().expect("cameras");
    cameras.iter().position(|camera| camera["name"] == name).expect("the photo")
}

#[test]
fn viewer_shows_views_as_they_were_photographed() {
    let folder = tempdir().expect("a temporary folder");
    let at = |name: &str| folder.path().join(name);
    write_dataset(&at("data"));
    let (data, model, out) = (at("data"), at("model"), at("out"));
    let paths = ["train", "-s", text(&data), "-m", text(&model), "--eval", "--quiet", "--iterations=40"];
    let light = ["--exposure", "--exposure-lr-init=0.1", "--lens-effects", "--lens-lr=0.05", "--sh-degree=0"];
    succeed(&[paths.as_slice(), &light].concat());
    let server = Server::view(&model, &[]);
    let mut page = server.page();
    // The held-out photo was taken with the same lens.
    let all = page.greeting["cameras"].as_array().expect("cameras").clone();
    assert!(all.iter().all(|camera| camera["lit"] == true), "{all:?}");
    let place = place_of(&page, "03.png");
    let (plain, lit) = (shown(&mut page, place, None), shown(&mut page, place, Some(place)));
    assert!(mean_difference(&plain, &lit) > 2.0, "{}", mean_difference(&plain, &lit));
    // Equal to the picture of `render`.
    let named = ["--exposure-of", "03.png", "--lens-of", "03.png"];
    succeed(&[&["render", text(&model), "-o", text(&out), "--quiet"], named.as_slice()].concat());
    let cameras = cameras_json::read(model.join("cameras.json"), &WorldFrame::default()).expect("cameras");
    let index = cameras.iter().position(|camera| camera.name == "03.png").expect("the photo");
    let rendered = image::open(out.join(format!("{index:05}.png"))).expect("a picture").to_rgb8().into_raw();
    let off = mean_difference(&rendered, &lit);
    assert!(off < 0.2 && mean_difference(&rendered, &plain) > 2.0, "{off}");
    // An unknown photo is refused, and the page continues.
    let camera = message(&camera(0.0));
    page.send(&json!({ "type": "view", "seq": 2, "camera": camera, "as_photo": all.len() }));
    let start = Instant::now();
    loop {
        assert!(start.elapsed() < PATIENCE, "no problem");
        if let Message::Text(said) = page.socket.read().expect("a message")
            && said.contains("\"problem\"")
        {
            assert!(said.contains("photo") && said.contains("the scene has 9"), "{said}");
            break;
        }
    }
    assert!(shown(&mut page, place, None) == plain);
}

/// During training, exposures are those learned so far. Trainings that learn none show none.
#[test]
fn viewer_of_a_training_shows_its_exposures() {
    for learns in [true, false] {
        let more: &[&str] = if learns { &["--exposure", "--exposure-lr-init=0.1"] } else { &[] };
        let training = Training::start(&[&["1000000", "--view=0"], more].concat(), "viewer at ");
        let mut page = training.server.page();
        let held_out = place_of(&page, "01.png");
        let place = place_of(&page, "03.png");
        assert_eq!(page.greeting["cameras"][place]["lit"], learns);
        assert_eq!(page.greeting["cameras"][held_out]["lit"], false);
        while page.status(0)["iteration"].as_u64() < Some(30) {
            std::thread::sleep(Duration::from_millis(50));
        }
        page.act("pause");
        page.rest();
        let (plain, lit) = (shown(&mut page, place, None), shown(&mut page, place, Some(place)));
        assert_eq!(plain != lit, learns);
        assert!(shown(&mut page, held_out, Some(held_out)) == shown(&mut page, held_out, None));
    }
}
