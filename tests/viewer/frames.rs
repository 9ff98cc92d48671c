//! Frames and picks, and views with the exposure of their photo and the effects of its lens.

use super::training::Training;
use super::*;
use ashsplat::Shape;
use ashsplat::scene::Intrinsics;
use std::sync::atomic::{AtomicBool, Ordering};

#[test]
fn viewer_shows_what_the_library_renders() {
    let (_place, server) = view_ball(800, &[]);
    let mut page = server.page();
    assert_eq!(page.greeting["sh_degree"], 1);
    let camera = camera(0.3);
    let plain = RenderSettings::default();
    let shown = page.look(&camera, &json!({ "quality": 0 }));
    assert_eq!(shown.header["format"], "image/png");
    assert!(shown.rgb() == rendered(&ball(800), &camera, &plain));
    let changed = json!({ "quality": 0, "background": [0.5, 0.25, 1.0], "sh_degree": 0, "scale": 0.5 });
    let settings =
        RenderSettings { background: [0.5, 0.25, 1.0], sh_degree: Some(0), scale_modifier: 0.5, ..plain };
    assert!(page.look(&camera, &changed).rgb() == rendered(&ball(800), &camera, &settings));
    let centres = RenderSettings { shape: Shape::Point, ..plain };
    let shown = page.look(&camera, &json!({ "quality": 0, "mode": "centres" }));
    assert!(shown.rgb() == rendered(&ball(800), &camera, &centres));
    let jpeg = page.look(&camera, &json!({ "quality": 95 }));
    assert_eq!(jpeg.header["format"], "image/jpeg");
    let error = mean_difference(&jpeg.rgb(), &rendered(&ball(800), &camera, &plain));
    assert!(error < 3.0, "{error}");
}

/// A picture of one very long line does not change later pictures of usual sizes.
#[test]
fn viewer_is_none_the_worse_for_odd_sizes() {
    let (_place, server) = view_ball(300, &[]);
    let mut page = server.page();
    let of_size = |width, height| {
        let lens = Intrinsics::from_fov_x(0.9, width, height);
        Camera::look_at(Vec3::NEG_Z * 4.0, Vec3::ZERO, Vec3::NEG_Y, lens)
    };
    for (width, height) in [(65_535, 1), (320, 180), (1, 65_535), (320, 180)] {
        let camera = of_size(width, height);
        let shown = page.look(&camera, &json!({ "quality": 0 }));
        assert_eq!((&shown.header["width"], &shown.header["height"]), (&json!(width), &json!(height)));
        assert!(shown.rgb() == rendered(&ball(300), &camera, &RenderSettings::default()), "{width}x{height}");
    }
}

#[test]
fn viewer_has_modes_with_legends() {
    let (_place, server) = view_ball(800, &["--validation"]);
    let mut page = server.page();
    let camera = camera(0.0);
    let mut seen = Vec::new();
    for mode in ["splats", "centres", "ellipsoids", "depth", "tiles", "normals"] {
        let shown = page.look(&camera, &json!({ "quality": 0, "mode": mode }));
        let legend: Option<Vec<f64>> =
            serde_json::from_value(shown.header["legend"].clone()).expect("numbers, or null");
        match mode {
            "depth" => assert!(legend.is_some_and(|l| l[0] > 2.0 && l[0] < l[1] && l[1] < 7.0)),
            "tiles" => {
                let longest = shown.header["stats"]["longest_tile"].as_f64().expect("a number");
                assert_eq!(legend, Some(vec![0.0, longest]));
            }
            _ => assert_eq!(legend, None),
        }
        let rgb = shown.rgb();
        assert!(seen.iter().all(|other| *other != rgb), "{mode} looks like another");
        seen.push(rgb);
    }
    assert_eq!(server.end(), (Some(0), String::new()));
}

#[test]
fn viewer_sends_the_newest_view_only() {
    let (_place, server) = view_ball(300, &[]);
    let (mut slow, mut quick) = (server.page(), server.page());
    for seq in 1..=30 {
        slow.send(&view(seq, &camera(seq as f32 * 0.01), &json!({})));
    }
    let first = slow.frame().header["seq"].as_u64().expect("a number");
    assert!(slow.is_silent(), "the first frame was not acknowledged");
    // Other pages do not wait for it.
    for _ in 0..5 {
        quick.look(&camera(0.0), &json!({}));
    }
    slow.send(&json!({ "type": "ack" }));
    if first < 30 {
        assert_eq!(slow.frame().header["seq"], 30);
        slow.send(&json!({ "type": "ack" }));
    }
    assert!(slow.is_silent(), "nothing has changed");
}

#[test]
fn viewer_picks_what_inspect_lists() {
    let (place, server) = view_ball(800, &[]);
    let mut page = server.page();
    let camera = camera(0.0);
    page.send(&json!({ "type": "pick", "id": 5, "camera": message(&camera), "pixel": [48, 32] }));
    let picked = page.wait_for("picked");
    cameras_json::write(place.at("cameras.json"), [("one", &camera)], &WorldFrame::default())
        .expect("written");
    let inspected = place.json_of("inspect @ball.ply --path @cameras.json --pixel 48,32 --json");
    assert_eq!((&picked["id"], &picked["pixel"]), (&json!(5), &json!([48, 32])));
    let ids = |of: &Value| -> Vec<Value> {
        of["samples"].as_array().expect("samples").iter().map(|sample| sample["id"].clone()).collect()
    };
    assert_eq!(ids(&picked), ids(&inspected));
    assert!(ids(&picked).len() > 3, "{picked}");
    let depth = picked["depth"].as_f64().expect("a depth");
    assert!((2.0..6.5).contains(&depth), "{depth}");
    let number = |axis: usize| picked["point"][axis].as_f64().expect("a number") as f32;
    let (x, y, z) = camera.project(Vec3::new(number(0), number(1), number(2)));
    assert!((x - 48.5).abs() < 0.01 && (y - 32.5).abs() < 0.01 && (f64::from(z) - depth).abs() < 1e-3);
    // A pick beside the ball has no depth.
    page.send(&json!({ "type": "pick", "id": 6, "camera": message(&camera), "pixel": [0, 0] }));
    assert_eq!(page.wait_for("picked")["depth"], Value::Null);
}

#[test]
fn viewer_complains_of_nonsense_and_continues() {
    let (_place, server) = view_ball(100, &[]);
    let mut page = server.page();
    let mut bad = message(&camera(0.0));
    bad["width"] = json!(60_000);
    bad["height"] = json!(60_000);
    let outside = json!({ "type": "pick", "id": 1, "camera": message(&camera(0.0)), "pixel": [96, 0] });
    let film = |keys: usize, seconds: u32, frames_per_second: u32, width: u32| {
        let key =
            json!({ "position": [0, 0, -3], "rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "fov_y": 0.8 });
        json!({
            "type": "film", "keys": vec![key; keys], "seconds": seconds, "frames_per_second": frames_per_second,
            "width": width, "height": 9,
        })
    };
    let cases = [
        (json!({ "type": "dance" }), "not understood"),
        (json!(7), "not understood"),
        (json!({ "type": "view", "seq": 1, "camera": bad }), "pixels"),
        (view(1, &camera(0.0), &json!({ "scale": -1 })), "scale_modifier: is -1"),
        (outside, "outside"),
        (film(1, 0, 1, 9), "keys"),
        (film(2, 1_000_000_000, 1, 9), "the most"),
        (film(2, 1, 0, 9), "frames per second"),
        (film(2, 1, 1, 0), "0x9"),
    ];
    for (message, word) in cases {
        page.send(&message);
        let problem = page.wait_for_problem();
        assert!(problem.contains(word), "{message}: {problem}");
    }
    assert!(!page.look(&camera(0.0), &json!({})).picture.is_empty());
}

/// A page that sends as fast as possible is answered meanwhile.
#[test]
fn viewer_answers_while_messages_come() {
    let (_place, server) = view_ball(50, &[]);
    let page = server.page();
    let stream = page.socket.get_ref().try_clone().expect("a stream");
    let role = tungstenite::protocol::Role::Client;
    let mut reader = tungstenite::WebSocket::from_raw_socket(stream, role, None);
    let over = AtomicBool::new(false);
    std::thread::scope(|scope| {
        let over = &over;
        scope.spawn(move || {
            let mut page = page;
            page.socket.get_ref().set_write_timeout(Some(Duration::from_millis(50))).expect("a timeout");
            let mut sent = true;
            while !over.load(Ordering::Relaxed) {
                let nonsense = tungstenite::Message::text(r#"{"type":"nonsense"}"#);
                sent = if sent { page.socket.send(nonsense) } else { page.socket.flush() }.is_ok();
            }
        });
        let mut answers = 0;
        while answers < 100 {
            let answer = reader.read().expect("an answer");
            // The server also sends pings.
            if answer.is_ping() {
                continue;
            }
            assert!(answer.to_text().is_ok_and(|text| text.contains("not understood")), "{answer:?}");
            answers += 1;
        }
        over.store(true, Ordering::Relaxed);
    });
}

/// The view of a scene's camera, with or without its photo's exposure and lens.
fn shown(page: &mut Page, place: usize, as_photo: Option<usize>) -> Vec<u8> {
    let camera = page.greeting["cameras"][place]["camera"].clone();
    let look = json!({ "quality": 0 });
    page.send(&json!({ "type": "view", "seq": 1, "camera": camera, "look": look, "as_photo": as_photo }));
    let shown = page.frame().rgb();
    page.send(&json!({ "type": "ack" }));
    shown
}

fn place_of(page: &Page, name: &str) -> usize {
    let cameras = page.greeting["cameras"].as_array().expect("cameras");
    cameras.iter().position(|camera| camera["name"] == name).expect("the photo")
}

#[test]
fn viewer_shows_views_as_they_were_photographed() {
    let place = TestFolder::new();
    let light = "--exposure --exposure-lr-init=0.1 --lens-effects --lens-lr=0.05 --sh-degree=0";
    place.run(format!("train -s @data -m @model --eval --quiet --iterations=40 {light}")).ok();
    let server = Server::view(&place.at("model"), &[]);
    let mut page = server.page();
    // The held-out photo was taken with the same lens.
    let all = page.greeting["cameras"].as_array().expect("cameras").clone();
    assert!(all.iter().all(|camera| camera["lit"] == true), "{all:?}");
    let photo = place_of(&page, "04.png");
    let (plain, lit) = (shown(&mut page, photo, None), shown(&mut page, photo, Some(photo)));
    assert!(mean_difference(&plain, &lit) > 2.0, "{}", mean_difference(&plain, &lit));
    // Equal to the picture of `render`.
    place.run("render @model -o @out --quiet --exposure-of 04.png --lens-of 04.png").ok();
    let cameras = cameras_json::read(place.at("model/cameras.json"), &WorldFrame::default());
    let cameras = cameras.expect("cameras");
    let index = cameras.iter().position(|camera| camera.name == "04.png").expect("the photo");
    let rendered = place.picture(format!("out/{index:05}.png")).into_raw();
    let off = mean_difference(&rendered, &lit);
    assert!(off < 0.2 && mean_difference(&rendered, &plain) > 2.0, "{off}");
    // An unknown photo is refused, and the page continues.
    let camera = message(&camera(0.0));
    page.send(&json!({ "type": "view", "seq": 2, "camera": camera, "as_photo": all.len() }));
    let problem = page.wait_for_problem();
    assert!(problem.contains("photo") && problem.contains("the scene has 9"), "{problem}");
    assert!(shown(&mut page, photo, None) == plain);
}

#[test]
fn viewer_of_a_training_shows_its_exposures() {
    for learns in [true, false] {
        let more = if learns { "--exposure --exposure-lr-init=0.1" } else { "" };
        let training = Training::start(&format!("1000000 {more}"));
        let mut page = training.server.page();
        let held_out = place_of(&page, "03.png");
        let photo = place_of(&page, "04.png");
        assert_eq!(page.greeting["cameras"][photo]["lit"], learns);
        assert_eq!(page.greeting["cameras"][held_out]["lit"], false);
        assert_eq!(
            [held_out, photo].map(|at| page.greeting["cameras"][at]["held_out"] == true),
            [true, false]
        );
        page.pass(29);
        page.act("pause");
        page.rest();
        let (plain, lit) = (shown(&mut page, photo, None), shown(&mut page, photo, Some(photo)));
        assert_eq!(plain != lit, learns);
        assert!(shown(&mut page, held_out, Some(held_out)) == shown(&mut page, held_out, None));
    }
}
