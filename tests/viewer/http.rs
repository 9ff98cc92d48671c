//! The page, tokens, ports and photos.

use super::*;
use crate::cli::finish;
use std::net::TcpListener;
use tungstenite::HandshakeError;
use tungstenite::client::IntoClientRequest;

/// Status of a WebSocket's handshake from this origin.
fn handshake(server: &Server, origin: &str) -> u16 {
    let mut request = format!("ws://{}/socket", server.host).into_client_request().expect("a request");
    request.headers_mut().insert("Origin", origin.parse().expect("a header"));
    match tungstenite::client(request, server.connect()) {
        Ok((_, answer)) => answer.status().as_u16(),
        Err(HandshakeError::Failure(tungstenite::Error::Http(answer))) => answer.status().as_u16(),
        Err(error) => panic!("{origin}: {error}"),
    }
}

#[test]
fn viewer_without_a_scene_says_what_to_do() {
    let server = Server::start(&["view", "--port", "0"]);
    let (code, head, body) = server.get("/", &[]);
    assert_eq!(code, 200, "{head}");
    assert!(head.contains("text/html") && String::from_utf8_lossy(&body).contains("main.js"), "{head}");
    let (code, head, _) = server.get("/main.js", &[]);
    assert!(code == 200 && head.contains("text/javascript"), "{head}");
    assert_eq!(server.get("/nothing", &[]).0, 404);
    assert_eq!(server.get("/film/..%2f..%2fetc%2fpasswd", &[]).0, 404);
    let mut page = server.page();
    assert_eq!(page.greeting["empty"], true);
    assert!(page.greeting["note"].as_str().expect("a note").contains("ashsplat view scene.ply"));
    // Requests for frames are answered with an error.
    page.send(&view(1, &camera(0.0), &json!({})));
    let problem = page.wait_for_problem();
    assert!(problem.contains("scene"), "{problem}");
}

#[test]
fn viewer_lets_in_who_knows_the_token() {
    let (place, server) = view_ball(50, &["--host", "0.0.0.0", "--token", "sesame"]);
    let others = "view @ball.ply --host 0.0.0.0 --port 0";
    place.run(others).refused(&["--host", "0.0.0.0", "--token"]);
    finish(place.command(others).args(["--token", ""])).refused(&["--token"]);
    // A bad output folder is refused before the page is served.
    place.run("view @ball.ply --port 0 -o @ball.ply/below").refused(&["ball.ply", "no folder"]);
    let said = &server.said;
    crate::common::assert_says(said, &["localhost:", "/?token=WORD"]);
    assert!(!said.contains("0.0.0.0"), "{said}");
    for (path, headers) in [
        ("/", vec![]),
        ("/?token=sesam", vec![]),
        ("/main.js?token=sesamesesame", vec![]),
        ("/socket", vec![]),
        ("/photo/0", vec![("Cookie", "ashsplat_token=sesame")]),
    ] {
        let (code, _, body) = server.get(path, &headers);
        assert_eq!(code, 401, "{path}");
        assert!(String::from_utf8_lossy(&body).contains("token"), "{path}");
    }
    let (code, head, _) = server.get("/?token=sesame", &[]);
    let cookie = |server: &Server, word: &str| {
        format!("ashsplat_token_{}={word}", server.host.rsplit_once(':').expect("a port").1)
    };
    let own = cookie(&server, "sesame");
    assert!(code == 200 && head.contains(&format!("{own}; HttpOnly; SameSite=Strict")), "{head}");
    assert_eq!(server.get("/main.js", &[("Cookie", &format!("other=1; {own}"))]).0, 200);
    assert_eq!(server.get("/main.js", &[("Cookie", &cookie(&server, "wrong"))]).0, 401);
    // Browsers send the cookies of all ports of a host: another viewer's token must not replace this one's.
    let another = Server::view(&place.at("ball.ply"), &["--token", "open"]);
    let both = format!("{own}; {}", cookie(&another, "open"));
    for server in [&server, &another] {
        assert_eq!(server.get("/main.js", &[("Cookie", &both)]).0, 200);
    }
    assert!(server.page_with("").err().expect("refused").contains("401"));
    let page = server.page_with("?token=sesame").expect("let in");
    assert_eq!(page.greeting["gaussians"], 50);
}

#[test]
fn viewer_refuses_foreign_pages() {
    let (_place, server) = view_ball(50, &[]);
    assert_eq!(server.get("/", &[("Host", "rebound.example:80")]).0, 403);
    // Requests of a foreign page are refused, whatever they ask for: photos cost memory, and need no script.
    let paths = "/ /main.js /photo/0 /thumbnail/0 /film/film_001.gif /count /export/scene.ply /nothing";
    for path in paths.split(' ') {
        for foreign in [
            ("Sec-Fetch-Site", "cross-site"),
            ("Sec-Fetch-Site", "same-site"),
            ("Origin", "http://elsewhere.example"),
            ("Origin", "http://localhost:1"),
            ("Origin", "http://"),
            ("Origin", ""),
            ("Origin", "http://\u{e4}.example"),
        ] {
            assert_eq!(server.get(path, &[foreign]).0, 403, "{path} {foreign:?}");
        }
        for site in ["same-origin", "none"] {
            assert_ne!(server.get(path, &[("Sec-Fetch-Site", site)]).0, 403, "{path}");
        }
    }
    // A link may open the page.
    let link =
        [("Sec-Fetch-Site", "cross-site"), ("Sec-Fetch-Mode", "navigate"), ("Sec-Fetch-Dest", "document")];
    assert_eq!((server.get("/", &link).0, server.get("/photo/0", &link).0), (200, 403));
    assert_eq!(server.get("/", &[link[0], link[1], ("Sec-Fetch-Dest", "iframe")]).0, 403);
    let own = format!("http://{}", server.host);
    assert_eq!(server.get("/", &[("Origin", &own), ("Origin", "http://elsewhere.example")]).0, 403);
    for (origin, expected) in [("http://elsewhere.example", 403), ("null", 403), (&own, 101)] {
        assert_eq!(handshake(&server, origin), expected, "{origin}");
    }
}

/// A proxy at viewer.example sends its upstream name in the header Host, as nginx does by default.
#[test]
fn viewer_behind_a_proxy_says_what_to_do_and_can_be_told() {
    let (place, server) = view_ball(50, &[]);
    let (shown, evil) = ("https://viewer.example", "https://evil.example");
    assert_eq!(handshake(&server, shown), 403);
    // A page cannot see the reason; it sends another request.
    for (headers, expected, word) in [
        (&[("Origin", shown)][..], 403, "--allow-origin"),
        (&[("Host", "viewer.example")], 403, "--allow-origin"),
        (&[], 426, "Upgrade"),
    ] {
        let (code, _, body) = server.post("/socket", headers, &[]);
        let said = String::from_utf8(body).expect("text");
        assert!(code == expected && said.contains(word), "{headers:?}: {code} {said}");
    }
    let (_, output) = server.end();
    assert_eq!(output.matches("--allow-origin").count(), 1, "{output}");
    assert!(output.contains(shown), "{output}");
    let server = Server::view(&place.at("ball.ply"), &["--allow-origin", "https://Viewer.example:443/"]);
    assert_eq!([shown, evil].map(|origin| handshake(&server, origin)), [101, 403]);
    for (headers, expected) in [
        (&[("Host", "viewer.example"), ("Origin", shown)][..], 200),
        (&[("Host", "viewer.example")], 200),
        (&[("Host", "evil.example"), ("Origin", evil)], 403),
        (&[("Host", "evil.example"), ("X-Forwarded-Host", "viewer.example")], 403),
    ] {
        assert_eq!(server.get("/", headers).0, expected, "{headers:?}");
    }
    let run = place.run("view @ball.ply --allow-origin viewer.example");
    run.refused(&["--allow-origin", "https://HOST"]);
    // Others can reach the viewer, so they may not name paths.
    let server = Server::start_in(&place.at(""), &[], &["view", "--port", "0", "--allow-origin", shown]);
    assert!(server.page().greeting["open"]["folder"].is_null());
}

#[test]
fn viewer_is_told_what_is_up() {
    let (place, server) = view_ball(50, &["--up", "0,0,2"]);
    let page = server.page();
    assert_eq!(page.greeting["up"], json!([0.0, 0.0, 1.0]));
    let rows = &page.greeting["start"]["rotation"];
    // The camera's second row points down in the picture.
    assert!(rows[1][2].as_f64().expect("a number") < -0.9, "{rows}");
    place.run("view @ball.ply --up 0,0,0 --port 0").refused(&["--up", "not all 0"]);
}

#[test]
fn viewer_names_a_busy_port_and_the_options_of_its_command() {
    let place = TestFolder::new();
    write_ball(&place.at(""), 50);
    let taken = TcpListener::bind("127.0.0.1:0").expect("a port");
    let port = taken.local_addr().expect("its address").port().to_string();
    let train = "train -s @data -m @model --iterations 5 --quiet";
    for (line, words) in [
        (format!("view @ball.ply --port {port}"), &[&port, "in use", "--port"][..]),
        (format!("{train} --view={port}"), &[&port, "in use", "--view=PORT"]),
        (format!("{train} --view=0 --view-host 0.0.0.0"), &["--view-host", "--view-token WORD"]),
    ] {
        place.run(line).refused(words);
        assert!(!place.has("model"));
    }
}

/// The file is checked before the page's address is printed.
#[test]
fn viewer_of_a_missing_file_says_only_so() {
    let run = TestFolder::empty().run("view nosuch.ply --port 0").refused(&["nosuch.ply", "(os error 2)"]);
    assert_eq!(run.stdout, "");
}

#[test]
fn viewer_shows_a_data_set_and_its_photos() {
    let place = TestFolder::new();
    let view = || Server::view(&place.at("data"), &[]);
    let server = view();
    let page = server.page();
    assert_eq!((&page.greeting["gaussians"], &page.greeting["empty"]), (&json!(400), &json!(false)));
    let cameras = page.greeting["cameras"].as_array().expect("cameras");
    assert_eq!((cameras.len(), cameras[1]["name"].as_str()), (9, Some("02.png")));
    // Browsers cache photos: another run at the same port must use other addresses.
    let run = page.greeting["run"].as_str().expect("a word");
    assert_ne!(view().page().greeting["run"].as_str(), Some(run));
    let script = String::from_utf8(server.get("/photos.js", &[]).2).expect("text");
    assert!(script.contains("?run=${this.run}&page=${this.page}"));
    assert_eq!(server.get(&format!("/thumbnail/0?run={run}"), &[]).0, 200);
    let (code, head, body) = server.get("/photo/1", &[]);
    assert!(code == 200 && head.contains("image/jpeg"), "{head}");
    let shown = image::load_from_memory(&body).expect("a JPEG").to_rgb8();
    let stored = place.picture("data/images/02.png");
    assert!(shown.dimensions() == (48, 32) && mean_difference(&shown, &stored) < 4.0);
    assert_eq!(server.get("/thumbnail/8", &[]).0, 200);
    assert_eq!(server.get("/photo/9", &[]).0, 404);
    // A missing photo gives an error, and the server continues.
    place.remove("data/images/03.png");
    let (code, _, body) = server.get("/photo/2", &[]);
    assert!(code == 422 && String::from_utf8_lossy(&body).contains("03.png"), "{code}");
    assert_eq!(server.get("/photo/1", &[]).0, 200);
}

/// Smaller copies of the photos, as in the reference's data sets.
#[test]
fn viewer_takes_photos_from_the_folder_that_it_is_told() {
    let place = TestFolder::new();
    place.create_folder("data/images_2");
    for name in place.files("data/images") {
        let photo = place.picture(Path::new("data/images").join(&name));
        let small = image::imageops::thumbnail(&photo, photo.width() / 2, photo.height() / 2);
        small.save(place.at("data/images_2").join(name)).expect("written");
    }
    let size = |path: &str, options: &str| {
        let options = place.words(options);
        let options: Vec<&str> = options.iter().map(String::as_str).collect();
        let (code, _, body) = Server::view(&place.at(path), &options).get("/photo/1", &[]);
        assert_eq!(code, 200);
        image::load_from_memory(&body).expect("a JPEG").to_rgb8().dimensions()
    };
    assert_eq!(size("data", ""), (48, 32));
    for option in ["--images images_2", "-i images_2"] {
        assert_eq!(size("data", option), (24, 16));
    }
    // The option also applies to a scene's data set, and is never ignored silently.
    write_ball(&place.at(""), 20);
    assert_eq!(size("ball.ply", "-s @data -i images_2"), (24, 16));
    // The page is served first, so the viewer needs a free port.
    place.run("view @data --port 0 --images images_9").refused(&["images_9"]);
    place.run("view @ball.ply --port 0 --images images_2").refused(&["data set", "-s DATASET"]);
}
