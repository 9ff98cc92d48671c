//! Frames and picks.

use super::*;
use crate::cli::succeed;
use crate::common::engine::renderer;
use ashsplat::scene::{Intrinsics, WorldFrame};
use ashsplat::{RenderSettings, Shape};
use ashsplat_files::Photo;
use glam::Vec3;
use tempfile::tempdir;

/// Picture that the library renders.
fn expected(count: usize, camera: &Camera, settings: &RenderSettings) -> Vec<u8> {
    let mut renderer = renderer();
    renderer.upload(&ball(count)).expect("uploaded");
    let frame = renderer.render(camera, settings).expect("a frame");
    Photo::from_f32(frame.width, frame.height, &frame.color).expect("a picture").rgb
}

#[test]
fn viewer_shows_what_the_library_renders() {
    let folder = tempdir().expect("a temporary folder");
    let server = Server::view(&write_ball(folder.path(), 800), &[]);
    let mut page = server.page();
    assert_eq!(page.greeting["sh_degree"], 1);
    let camera = camera(0.3);
    let plain = RenderSettings::default();
    let shown = page.look(&camera, &json!({ "quality": 0 }));
    assert_eq!(shown.header["format"], "image/png");
    assert!(shown.rgb() == expected(800, &camera, &plain));
    let changed = json!({ "quality": 0, "background": [0.5, 0.25, 1.0], "sh_degree": 0, "scale": 0.5 });
    let settings =
        RenderSettings { background: [0.5, 0.25, 1.0], sh_degree: Some(0), scale_modifier: 0.5, ..plain };
    assert!(page.look(&camera, &changed).rgb() == expected(800, &camera, &settings));
    let centres = RenderSettings { shape: Shape::Point, ..plain };
    let shown = page.look(&camera, &json!({ "quality": 0, "mode": "centres" }));
    assert!(shown.rgb() == expected(800, &camera, &centres));
    let jpeg = page.look(&camera, &json!({ "quality": 95 }));
    assert_eq!(jpeg.header["format"], "image/jpeg");
    let (close, exact) = (jpeg.rgb(), expected(800, &camera, &plain));
    let error: f64 = close.iter().zip(&exact).map(|(a, b)| f64::from(a.abs_diff(*b))).sum();
    assert!(error / (exact.len() as f64) < 3.0, "{error}");
}

/// A picture of one very long line does not change later pictures of usual sizes.
#[test]
fn viewer_is_none_the_worse_for_odd_sizes() {
    let folder = tempdir().expect("a temporary folder");
    let server = Server::view(&write_ball(folder.path(), 300), &[]);
    let mut page = server.page();
    let of_size = |width, height| {
        let lens = Intrinsics::from_fov_x(0.9, width, height);
        Camera::look_at(Vec3::NEG_Z * 4.0, Vec3::ZERO, Vec3::NEG_Y, lens)
    };
    for (width, height) in [(65_535, 1), (320, 180), (1, 65_535), (320, 180)] {
        let camera = of_size(width, height);
        let shown = page.look(&camera, &json!({ "quality": 0 }));
        assert_eq!((&shown.header["width"], &shown.header["height"]), (&json!(width), &json!(height)));
        assert!(shown.rgb() == expected(300, &camera, &RenderSettings::default()), "{width}x{height}");
    }
}

#[test]
fn viewer_has_modes_with_legends() {
    let folder = tempdir().expect("a temporary folder");
    let server = Server::view(&write_ball(folder.path(), 800), &["--validation"]);
    let mut page = server.page();
    let camera = camera(0.0);
    let mut seen = Vec::new();
    for mode in ["splats", "centres", "ellipsoids", "depth", "tiles"] {
        let shown = page.look(&camera, &json!({ "quality": 0, "mode": mode }));
        let legend = shown.header["legend"]
            .as_array()
            .map(|values| values.iter().map(|value| value.as_f64().expect("a number")).collect::<Vec<_>>());
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
    #[cfg(unix)]
    {
        let (code, stderr) = server.end();
        assert_eq!((code, stderr.as_str()), (Some(0), ""));
    }
}

#[test]
fn viewer_sends_the_newest_view_only() {
    let folder = tempdir().expect("a temporary folder");
    let server = Server::view(&write_ball(folder.path(), 300), &[]);
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
    let folder = tempdir().expect("a temporary folder");
    let path = write_ball(folder.path(), 800);
    let server = Server::view(&path, &[]);
    let mut page = server.page();
    let camera = camera(0.0);
    page.send(&json!({ "type": "pick", "id": 5, "camera": message(&camera), "pixel": [48, 32] }));
    let picked = page.wait_for("picked");
    let cameras = folder.path().join("cameras.json");
    ashsplat_files::cameras_json::write(&cameras, [("one", &camera)], &WorldFrame::default())
        .expect("written");
    let said = succeed(&["inspect", text(&path), "--path", text(&cameras), "--pixel", "48,32", "--json"]);
    let inspected: Value = serde_json::from_str(&said).expect("JSON");
    assert_eq!((&picked["id"], &picked["pixel"]), (&json!(5), &json!([48, 32])));
    let ids = |of: &Value| -> Vec<Value> {
        of["samples"].as_array().expect("samples").iter().map(|sample| sample["id"].clone()).collect()
    };
    assert_eq!(ids(&picked), ids(&inspected));
    assert!(ids(&picked).len() > 3, "{picked}");
    let depth = picked["depth"].as_f64().expect("a depth");
    assert!((2.0..6.5).contains(&depth), "{depth}");
    // A pick beside the ball has no depth.
    page.send(&json!({ "type": "pick", "id": 6, "camera": message(&camera), "pixel": [0, 0] }));
    assert_eq!(page.wait_for("picked")["depth"], Value::Null);
}

#[test]
fn viewer_complains_of_nonsense_and_goes_on() {
    let folder = tempdir().expect("a temporary folder");
    let server = Server::view(&write_ball(folder.path(), 100), &[]);
    let mut page = server.page();
    let mut bad = message(&camera(0.0));
    bad["width"] = json!(60_000);
    bad["height"] = json!(60_000);
    let outside = json!({ "type": "pick", "id": 1, "camera": message(&camera(0.0)), "pixel": [96, 0] });
    let cases = [
        (json!({ "type": "dance" }), "not understood"),
        (json!(7), "not understood"),
        (json!({ "type": "view", "seq": 1, "camera": bad }), "pixels"),
        (view(1, &camera(0.0), &json!({ "scale": -1 })), "scale_modifier: is -1"),
        (outside, "outside"),
        (
            json!({ "type": "film", "keys": [], "seconds": 1, "frames_per_second": 1, "width": 9, "height": 9 }),
            "keys",
        ),
    ];
    for (message, word) in cases {
        page.send(&message);
        let problem = page.wait_for_problem();
        assert!(problem.contains(word), "{message}: {problem}");
    }
    assert!(!page.look(&camera(0.0), &json!({})).picture.is_empty());
}
