//! Cuts, and exported files: those of the viewer and of `ashsplat convert`.

use super::training::Training;
use super::*;
use ashsplat::scene::{Bounds, Cut};
use ashsplat_files::splats::Format;
use glam::DVec3;

const COUNT: usize = 900;

/// Cuts by each limit and by all; one that keeps everything, and one with swapped sides.
fn cuts() -> Vec<Value> {
    let mut densities: Vec<f32> = (0..COUNT).map(|index| ball(COUNT).log_density(index).exp()).collect();
    densities.sort_unstable_by(f32::total_cmp);
    vec![
        json!({}),
        json!({ "min_opacity": 0.4 }),
        json!({ "min_density": densities[COUNT / 3] }),
        json!({ "low": [-0.3, null, null], "high": [null, 0.25, 0.6] }),
        json!({ "low": [0.5, null, null], "high": [-0.5, null, null] }),
        json!({ "min_opacity": 0.1, "min_density": densities[COUNT / 5], "low": [null, -0.7, null] }),
    ]
}

fn picture(gaussians: &Gaussians, camera: &Camera) -> Vec<u8> {
    rendered(gaussians, camera, &RenderSettings::default())
}

/// The viewer's picture equals that of the file which the displayed command writes. Its exports equal that file,
/// byte for byte.
#[test]
fn viewer_cuts_as_convert_does() {
    let (place, server) = view_ball(COUNT, &[]);
    let mut page = server.page();
    let path = place.at("ball.ply");
    assert_eq!(page.greeting["convert"], format!("ashsplat convert {} ball_cut.ply", path.display()));
    assert_eq!(page.greeting["stem"], "ball");
    let camera = camera(0.3);
    let mut sizes = Vec::new();
    for (number, cut) in cuts().iter().enumerate() {
        let shown = page.look(&camera, &json!({ "quality": 0, "cut": cut }));
        let options = shown.header["convert"].as_str().expect("options");
        assert_eq!(options.is_empty(), number == 0, "{options}");
        let address = shown.header["export"].as_str().expect("an address");
        for format in [Format::Ply, Format::Spz] {
            let converted = format!("{number}{}", format.extension());
            place.run(format!("convert @ball.ply @{converted} {options}")).ok();
            let export = format!("/export/ball_cut{}?{address}", format.extension());
            let (code, head, body) = server.get(&export, &[]);
            assert!(code == 200 && head.contains("content-disposition: attachment"), "{head}");
            assert!(body == place.read(&converted), "{options}: {format}");
        }
        let left = place.gaussians(format!("{number}.ply"));
        let counts = json_body(&server, &format!("/count?{address}"));
        assert_eq!(counts, json!({ "kept": left.len(), "of": COUNT, "losses": [] }));
        assert!(shown.rgb() == picture(&left, &camera), "{options}");
        sizes.push(left.len());
    }
    assert!(sizes[0] == COUNT && sizes[1..].iter().all(|&left| 20 < left && left < COUNT), "{sizes:?}");
    assert_eq!(sizes[2], COUNT - COUNT / 3, "a third is less dense");
    // Picks consider only the Gaussians shown.
    let cut = json!({ "low": [null, null, 0.0] });
    let pick = json!({ "type": "pick", "id": 1, "camera": message(&camera), "pixel": [48, 32], "look": { "cut": cut } });
    page.send(&pick);
    let picked = page.wait_for("picked");
    let samples = picked["samples"].as_array().expect("samples");
    let ids: Vec<u64> = samples.iter().map(|s| s["id"].as_u64().expect("a number")).collect();
    let means = ball(COUNT).means;
    assert!(!ids.is_empty() && ids.iter().all(|&id| means[id as usize][2] >= 0.0), "{ids:?}");
}

/// A tiny scene far from the origin looks like any other. The page gives its box in the coordinates of the file.
#[test]
fn viewer_cuts_distant_scenes_in_their_own_coordinates() {
    let place = TestFolder::empty();
    let frame = WorldFrame { origin: DVec3::new(500_000.0, 4_600_000.0, 100.0), unit: 0.01 };
    let options = WriteOptions { frame, ..WriteOptions::default() };
    splats::write(place.at("ball.ply"), &ball(COUNT), &options).expect("a PLY");
    let server = Server::view(&place.at("ball.ply"), &[]);
    let mut page = server.page();
    assert_eq!(page.greeting["frame"], json!({ "origin": frame.origin.to_array(), "unit": 0.01 }));
    let cut = json!({ "min_density": 0.5, "low": [-0.25, null, null], "high": [null, 0.5, null] });
    let shown = page.look(&camera(0.3), &json!({ "quality": 0, "cut": cut }));
    assert!(shown.rgb().iter().any(|value| *value > 99));
    let options = shown.header["convert"].as_str().expect("options");
    assert!(options.contains("--crop-box=499999.9975,-inf,-inf,inf,4600000.005,inf"), "{options}");
    place.run(format!("convert @ball.ply @cut.ply {options}")).ok();
    let address = shown.header["export"].as_str().expect("an address");
    let counts = json_body(&server, &format!("/count?{address}"));
    assert_eq!(counts["kept"], place.gaussians("cut.ply").len());
}

#[test]
fn viewer_pages_cut_for_themselves() {
    let (_place, server) = view_ball(300, &[]);
    let (mut one, mut other) = (server.page(), server.page());
    let camera = camera(0.0);
    let whole = one.look(&camera, &json!({ "quality": 0 })).rgb();
    let half = other.look(&camera, &json!({ "quality": 0, "cut": { "low": [0.0, null, null] } }));
    let bounds =
        Some(Bounds { min: Vec3::new(0.0, f32::NEG_INFINITY, f32::NEG_INFINITY), max: Vec3::INFINITY });
    let limits = Cut { bounds, ..Cut::default() }.limits();
    let mut expected = ball(300);
    expected.retain(|all, index| limits.keeps(all, index));
    assert!(half.rgb() == picture(&expected, &camera) && whole == picture(&ball(300), &camera));
    assert!(one.look(&camera, &json!({ "quality": 0 })).rgb() == whole);
    // Invalid cuts are answered with an error.
    for cut in [json!({ "min_opacity": 7 }), json!({ "min_density": -1 })] {
        one.send(&view(1, &camera, &json!({ "cut": cut })));
        let problem = one.wait_for_problem();
        assert!(problem.contains("cut.min_"), "{cut}: {problem}");
    }
    one.send(&view(1, &camera, &json!({ "cut": { "low": [1, 2] } })));
    assert!(one.wait_for_problem().contains("not understood"));
}

#[test]
fn viewer_exports_of_a_training_are_what_it_saves() {
    let training = Training::endless();
    let server = &training.server;
    let mut page = server.page();
    assert!(page.greeting["open"].is_null());
    page.act("pause");
    let at = page.rest();
    page.act("save");
    page.wait_for("note");
    let (code, head, body) = server.get("/export/now.ply", &[]);
    assert_eq!(code, 200, "{head}");
    assert!(body == training.place.ply("model", at as u32));
    // No scene can be opened in a training.
    assert_eq!(server.post("/upload/ball.ply", &[opening::BINARY], b"ply").0, 403);
    assert_eq!(server.post("/open", &[opening::JSON], b"{\"path\": \".\"}").0, 403);
}

#[test]
fn viewer_exports_what_it_understands_to_who_may_have_it() {
    let (_place, server) = view_ball(100, &["--token", "sesame"]);
    // Opened once the scene is loaded.
    server.page_with("?token=sesame").expect("let in");
    for (path, code) in [
        ("/export/a.ply", 401),
        ("/export/a.ply?token=wrong", 401),
        ("/export/a.ply?token=sesame", 200),
        ("/export/a.spz?token=sesame&low=,0,&high=,,&min_opacity=&sh_degree=0", 200),
        ("/export/a.glb?token=sesame", 200),
        // A format of two files.
        ("/export/a.gltf?token=sesame", 404),
        ("/export/a.usda?token=sesame", 200),
        // A format that is only read.
        ("/export/a.ksplat?token=sesame", 404),
        ("/export/a.png?token=sesame", 404),
        ("/export/..%2f..%2fa.ply%2fb?token=sesame", 404),
        ("/export/a.ply?token=sesame&low=1,2", 400),
        ("/export/a.ply?token=sesame&low=1,2,3,4", 400),
        ("/export/a.ply?token=sesame&high=inf,,", 400),
        ("/export/a.ply?token=sesame&min_opacity=x", 400),
        ("/export/a.ply?token=sesame&min_density=-1", 400),
        ("/export/a.ply?token=sesame&min_opacity=nan", 400),
        ("/export/a.ply?token=sesame&sh_degree=9", 400),
        ("/count", 401),
        ("/count?token=sesame&min_opacity=0.2", 200),
        ("/count?token=sesame&min_opacity=2", 400),
    ] {
        assert_eq!(server.get(path, &[]).0, code, "{path}");
    }
    for foreign in [
        ("Origin", "http://elsewhere.example"),
        ("Sec-Fetch-Site", "cross-site"),
        ("Sec-Fetch-Site", "same-site"),
    ] {
        assert_eq!(server.get("/export/a.ply?token=sesame", &[foreign]).0, 403, "{foreign:?}");
    }
    // Clients that ask for files and do not read them cause a bounded number of files.
    let asked = |_| {
        let mut stream = server.connect();
        write!(stream, "GET /export/a.ply?token=sesame HTTP/1.1\r\nHost: {}\r\n\r\n", server.host)
            .expect("sent");
        stream
    };
    let asking: Vec<TcpStream> = (0..12).map(asked).collect();
    let mut codes = asking.into_iter().map(|mut stream| {
        let mut start = [0; 12];
        stream.read_exact(&mut start).expect("an answer");
        String::from_utf8_lossy(&start[9..]).into_owned()
    });
    assert!(codes.all(|code| ["200", "503"].contains(&code.as_str())));
}

/// A placed scene is exported as `convert` with the page's options places it, byte for byte, after the cut.
#[test]
fn viewer_places_as_convert_does() {
    let (place, server) = view_ball(COUNT, &[]);
    let options = "--rotate=10.5,-20,90 --scale=2.5 --translate=0,-3,0.25 --min-opacity=0.3 --crop-box=-inf,-inf,-inf,0.5,inf,inf";
    place.run(format!("convert @ball.ply @placed.ply {options}")).ok();
    let query = "rotate=10.5,-20,90&scale=2.5&translate=0,-3,0.25&min_opacity=0.3&high=0.5,,";
    let (code, _, body) = server.get(&format!("/export/a.ply?{query}"), &[]);
    assert!(code == 200 && body == place.read("placed.ply"));
    // Far from zero, the file gets an origin of its own.
    place.run("convert @ball.ply @placed.ply --translate=500000,4600000.5,0").ok();
    let (code, _, body) = server.get("/export/a.ply?translate=500000,4600000.5,0", &[]);
    assert!(code == 200 && body == place.read("placed.ply"));
    let losses = json_body(&server, "/count?translate=500000,4600000.5,0&format=ply")["losses"].to_string();
    assert!(losses.contains("relative to 500000, 46000"), "{losses}");
    for query in ["rotate=1,2", "rotate=1,2,x", "translate=0,0,1e19", "scale=0", "scale=-1", "scale=nan"] {
        assert_eq!(server.get(&format!("/export/a.ply?{query}"), &[]).0, 400, "{query}");
    }
}
