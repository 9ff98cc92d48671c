//! Scenes that pages upload or name.

use super::*;

pub const BINARY: (&str, &str) = ("Content-Type", "application/octet-stream");
pub const JSON: (&str, &str) = ("Content-Type", "application/json");

/// A viewer that was started without a scene, in the folder `started`.
struct Empty {
    place: TestFolder,
    server: Server,
}

impl Empty {
    fn start(more: &[&str]) -> Empty {
        let place = TestFolder::empty();
        place.create_folder("started");
        place.create_folder("room");
        let command = [&["view", "--port", "0", "-o", "films"], more].concat();
        let room = place.at("room");
        let server = Server::start_in(
            &place.at("started"),
            &[(if cfg!(windows) { "TMP" } else { "TMPDIR" }, text(&room))],
            &command,
        );
        Empty { place, server }
    }

    fn left(&self) -> usize {
        std::fs::read_dir(self.place.at("room")).expect("a folder").count()
    }

    fn post(&self, path: &str, headers: &[(&str, &str)], bytes: &[u8]) -> (u16, String) {
        let (code, _, body) = self.server.post(path, headers, bytes);
        (code, String::from_utf8_lossy(&body).into_owned())
    }

    fn open(&self, path: &str) -> (u16, String) {
        self.post("/open", &[JSON], json!({ "path": path }).to_string().as_bytes())
    }
}

fn bytes_of(count: usize, ending: &str) -> Vec<u8> {
    let place = TestFolder::empty();
    let name = format!("ball{ending}");
    splats::write(place.at(&name), &ball(count), &WriteOptions::default()).expect("written");
    place.read(name)
}

impl Page {
    fn opened(&mut self) -> Result<Value, String> {
        loop {
            let PageMessage::Message(message) = self.receive() else { continue };
            match (message["type"].as_str(), message["failed"].as_str()) {
                (Some("scene"), _) => return Ok(message),
                (Some("loading"), Some(failed)) => return Err(failed.to_owned()),
                _ => {}
            }
        }
    }
}

#[test]
fn viewer_shows_files_that_are_dropped() {
    let empty = Empty::start(&[]);
    let (mut page, mut other) = (empty.server.page(), empty.server.page());
    assert_eq!((&page.greeting["empty"], page.greeting["open"]["folder"].is_null()), (&json!(true), false));
    for (count, ending) in
        [(300, ".ply"), (200, ".spz"), (100, ".splat"), (50, ".glb"), (70, ".compressed.ply")]
    {
        let name = format!("my%20ball{ending}");
        let (code, head, _) =
            empty.server.post(&format!("/upload/{name}"), &[BINARY], &bytes_of(count, ending));
        assert_eq!(code, 202, "{head}");
        let scene = page.opened().expect("a scene");
        assert_eq!((&scene["gaussians"], &scene["empty"]), (&json!(count), &json!(false)), "{ending}");
        assert_eq!(scene["name"], format!("my ball{ending}"));
        assert_eq!(scene["stem"], "my ball");
        assert_eq!(scene["convert"], format!("ashsplat convert \"my ball{ending}\" \"my ball_cut.ply\""));
        // All pages see the scene, and the upload is deleted after reading.
        assert_eq!(other.opened().expect("a scene")["run"], scene["run"]);
        assert!(!page.look(&camera(0.0), &json!({})).picture.is_empty());
        assert_eq!(empty.left(), 0, "{ending}");
    }
    // Folders in a name are ignored, and such a name is in no command, since another system may read it differently.
    let (code, ..) = empty.server.post("/upload/..%2f..%2fa.ply", &[BINARY], &bytes_of(60, ".ply"));
    let scene = page.opened().expect("a scene");
    assert_eq!((code, &scene["gaussians"], &scene["convert"]), (202, &json!(60), &Value::Null));
    assert!(other.opened().is_ok() && !empty.place.has("a.ply") && !empty.place.has("../a.ply"));
    // The exported scene is the uploaded one.
    let (_, _, back) = empty.server.get("/export/back.compressed.ply", &[]);
    assert!(!back.is_empty());
    // An invalid file gives an error; the previous scene stays.
    let last = page.look(&camera(0.0), &json!({ "quality": 0 })).rgb();
    let mut cut_short = bytes_of(300, ".ply");
    cut_short.truncate(9000);
    for (name, bytes) in [("bad.spz", &b"no splats at all"[..]), ("short.ply", &cut_short)] {
        assert_eq!(empty.server.post(&format!("/upload/{name}"), &[BINARY], bytes).0, 202);
        // The error has the file's name, without the temporary folder.
        let problem = page.opened().expect_err(name);
        assert!(problem.contains(name) && !problem.contains("room"), "{problem}");
        assert!(other.opened().is_err());
    }
    assert!(page.look(&camera(0.0), &json!({ "quality": 0 })).rgb() == last && empty.left() == 0);
    assert_eq!(empty.server.page().greeting["gaussians"], 60);
}

#[test]
fn viewer_bounds_what_is_sent() {
    let empty = Empty::start(&["--max-host-memory", "64K"]);
    let ball = bytes_of(100, ".ply");
    let (code, text) = empty.post("/upload/ball.ply", &[BINARY, ("Content-Length", "65537")], &[]);
    assert!(code == 413 && text.contains("--max-host-memory"), "{text}");
    // The answer arrives although the server does not read the whole file.
    assert_eq!(empty.post("/upload/ball.ply", &[BINARY], &vec![0; 4 << 20]).0, 413);
    assert_eq!(empty.post("/upload/ball.ply", &[("Content-Type", "text/plain")], &ball).0, 415);
    assert_eq!(empty.post("/upload/ball.ply", &[], &ball).0, 415);
    for name in ["ball.gltf", "data.zip", "ball", "..%2fball.exe"] {
        assert_eq!(empty.post(&format!("/upload/{name}"), &[BINARY], &ball).0, 415, "{name}");
    }
    let chunked = [BINARY, ("Transfer-Encoding", "chunked")];
    assert_eq!(empty.post("/upload/ball.ply", &chunked, b"0\r\n\r\n").0, 411);
    assert_eq!(empty.post("/open", &[JSON], b"no JSON").0, 400);
    assert_eq!(empty.post("/open", &[JSON], &[b' '; 70_000]).0, 400);
    assert_eq!(empty.server.get("/upload/ball.ply", &[]).0, 405);
    // One upload at a time: a second one is refused until the first has ended.
    let mut slow = empty.server.connect();
    let head = format!(
        "POST /upload/slow.ply HTTP/1.1\r\nHost: {}\r\nContent-Type: {}\r\nContent-Length: 60000\r\n\r\nply",
        empty.server.host, BINARY.1
    );
    slow.write_all(head.as_bytes()).expect("sent");
    let until = |wanted: u16| {
        wait_until("another answer", || empty.post("/upload/ball.ply", &[BINARY], &ball).0 == wanted);
    };
    // The first attempts may arrive before the slow upload has begun.
    until(503);
    assert_eq!(empty.left(), 1);
    let mut page = empty.server.page();
    drop(slow);
    until(202);
    assert_eq!(page.opened().expect("a scene")["gaussians"], 100);
    // The file is removed once the page has its answer.
    wait_until("no file to be left", || empty.left() == 0);
    // The file fits into memory, the scene does not.
    let packed = bytes_of(900, ".spz");
    assert!(packed.len() < 65_536);
    assert_eq!(empty.post("/upload/large.spz", &[BINARY], &packed).0, 202);
    assert!(page.opened().expect_err("too large").contains("--max-host-memory"));
    // Two scenes fit, but not together: the first stays, and a smaller one joins it.
    assert_eq!(empty.post("/upload/more.spz?add=1", &[BINARY], &bytes_of(650, ".spz")).0, 202);
    assert!(page.opened().expect_err("too large").contains("--max-host-memory"));
    assert_eq!(empty.post("/upload/ball.ply?add=1", &[BINARY], &ball).0, 202);
    assert_eq!(page.opened().expect("a scene")["gaussians"], 200);
}

#[test]
fn viewer_opens_paths_of_its_folder_only() {
    let empty = Empty::start(&[]);
    let place = &empty.place;
    let (outer, started) = (place.at(""), place.at("started"));
    place.write("secret.ply", bytes_of(10, ".ply"));
    place.create_folder("started/below");
    write_ball(&started.join("below"), 40);
    write_dataset(&started.join("data"));
    #[cfg(unix)]
    std::os::unix::fs::symlink(outer.join("secret.ply"), started.join("link.ply")).expect("a link");
    let mut page = empty.server.page();
    for path in ["../secret.ply", text(&outer.join("secret.ply")), "link.ply", "/etc/passwd", "nothing.ply"] {
        let (code, said) = empty.open(path);
        assert!(code == 404 && said.contains("is not in "), "{path}: {said}");
    }
    assert_eq!(empty.open("below/ball.ply").0, 202);
    assert_eq!(page.opened().expect("a scene")["gaussians"], 40);
    assert_eq!(empty.server.get("/photo/0", &[]).0, 404);
    // A data set with its photos.
    assert_eq!(empty.open(text(&started.join("data"))).0, 202);
    let scene = page.opened().expect("a scene");
    assert_eq!((&scene["gaussians"], scene["cameras"].as_array().map(Vec::len)), (&json!(400), Some(9)));
    assert_eq!(empty.server.get("/photo/0", &[]).0, 200);
    assert_eq!(scene["open"]["folder"], "started");
    // A model may name its data set, but only inside the start folder.
    place.write(point_cloud("started/model", 7), bytes_of(30, ".ply"));
    write_dataset(&outer.join("data"));
    let (inside, outside) = (started.join("data"), outer.join("data"));
    let (own, foreign) = (inside.join("images"), outside.join("images"));
    #[cfg(unix)]
    std::os::unix::fs::symlink(&foreign, inside.join("linked")).expect("a link");
    for (source, images, photos) in [
        (&inside, "images", true),
        (&inside, text(&own), true),
        (&outside, "images", false),
        // A model may not name photos elsewhere, either.
        (&inside, text(&foreign), false),
        (&inside, "../../data/images", false),
        (&inside, "linked", false),
    ] {
        let arguments =
            format!("Namespace(sh_degree=1, source_path='{}', images='{images}')", source.display());
        place.write("started/model/cfg_args", arguments);
        assert_eq!(empty.open("model").0, 202);
        let scene = page.opened().expect("a scene");
        let found = (&scene["gaussians"], &scene["has_photos"]);
        assert_eq!(found, (&json!(30), &json!(photos)), "{} {images}", source.display());
    }
}

#[test]
fn viewer_lets_nobody_open_who_may_not() {
    let ball = bytes_of(10, ".ply");
    let requests: [(&str, (&str, &str), &[u8]); 2] =
        [("/upload/a.ply", BINARY, &ball), ("/open", JSON, b"{\"path\": \"a.ply\"}")];
    let empty = Empty::start(&[]);
    for (path, kind, body) in requests {
        for foreign in [
            ("Origin", "http://elsewhere.example"),
            ("Origin", "null"),
            ("Sec-Fetch-Site", "cross-site"),
            ("Sec-Fetch-Site", "same-site"),
            ("Host", "rebound.example"),
        ] {
            assert_eq!(empty.server.post(path, &[kind, foreign], body).0, 403, "{path} {foreign:?}");
        }
        // A browser first asks whether a foreign page may send the request.
        let origin = [("Origin", "http://elsewhere.example")];
        let (code, head, _) = empty.server.request("OPTIONS", path, &origin, &[]);
        assert!(code == 403 && !head.to_lowercase().contains("access-control"), "{head}");
    }
    // With a token and reachable by others: uploads are accepted with the token, paths are not.
    let mut far = Empty::start(&["--host", "0.0.0.0", "--token", "sesame"]);
    far.server.host = far.server.host.replace("0.0.0.0", "127.0.0.1");
    write_ball(&far.place.at("started"), 20);
    for (path, kind, body) in requests {
        assert_eq!(far.server.post(path, &[kind], body).0, 401, "{path}");
    }
    let mut page = far.server.page_with("?token=sesame").expect("let in");
    assert!(page.greeting["open"]["folder"].is_null());
    let (code, said) = far.post("/open?token=sesame", &[JSON], b"{\"path\": \"ball.ply\"}");
    assert!(code == 404 && said.contains("opens no paths"), "{said}");
    assert_eq!(far.server.post("/upload/a.ply?token=sesame", &[BINARY], &ball).0, 202);
    assert_eq!(page.opened().expect("a scene")["gaussians"], 10);
    // A viewer that was started with a scene accepts no other.
    let (_place, server) = view_ball(30, &[]);
    assert!(server.page().greeting["open"].is_null());
    for (path, kind, body) in requests {
        let (code, _, said) = server.post(path, &[kind], body);
        assert!(code == 403 && String::from_utf8_lossy(&said).contains("without a path"), "{path}");
    }
}

/// The page is served before the scene is read. An error in the scene ends the program with a message.
#[test]
fn viewer_ends_with_what_is_wrong_with_its_scene() {
    let place = TestFolder::empty();
    place.write("bad.ply", "ply\nformat ascii 1.0\nend_header\n");
    let path = place.at("bad.ply");
    let (code, stderr) = Server::start(&["view", text(&path), "--port", "0"]).wait();
    assert!(code == Some(2) && stderr.starts_with("error: ") && stderr.contains("bad.ply"), "{stderr}");
}

/// A folder of scenes is listed, and its paths are completed; nothing outside the folder is.
#[test]
fn viewer_lists_a_folder_of_scenes() {
    let place = TestFolder::empty();
    place.create_folder("scenes/more");
    for (name, count) in
        [("scenes/b.ply", 40), ("scenes/a.spz", 30), ("scenes/more/c.splat", 20), ("outside.ply", 10)]
    {
        splats::write(place.at(name), &ball(count), &WriteOptions::default()).expect("written");
    }
    place.write("scenes/notes.txt", b"no scene");
    let server = Server::view(&place.at("scenes"), &[]);
    let mut page = server.page();
    assert_eq!(page.greeting["empty"], true);
    let list = |begin: &str| {
        let (code, _, body) = server.post("/paths", &[JSON], json!({ "path": begin }).to_string().as_bytes());
        assert_eq!(code, 200);
        serde_json::from_slice::<Value>(&body).expect("JSON")
    };
    let listed = |paths: Value| json!({ "paths": paths, "more": false });
    assert_eq!(list(""), listed(json!(["a.spz", "b.ply", "more/"])));
    assert_eq!((list("m"), list("more/")), (listed(json!(["more/"])), listed(json!(["more/c.splat"]))));
    for outside in ["../", "../out", "/", "nosuch/"] {
        assert_eq!(list(outside), listed(json!([])), "{outside}");
    }
    for (path, count) in [("more/c.splat", 20), ("b.ply", 40)] {
        assert_eq!(server.post("/open", &[JSON], json!({ "path": path }).to_string().as_bytes()).0, 202);
        assert_eq!(page.opened().expect("a scene")["gaussians"], count);
    }
    assert_eq!(server.post("/open", &[JSON], b"{\"path\": \"../outside.ply\"}").0, 404);
    // Everyone who can reach the page sees a folder named at the start, but not the shell's current folder.
    let others = ["--allow-origin", "https://viewer.example"];
    assert!(Server::view(&place.at("scenes"), &others).page().greeting["open"]["folder"].is_string());
    // A data set that a user names beside the folder need not lie in it.
    write_dataset(&place.at("data"));
    let server = Server::view(&place.at("scenes"), &["-s", text(&place.at("data"))]);
    let mut page = server.page();
    assert_eq!(server.post("/open", &[JSON], b"{\"path\": \"b.ply\"}").0, 202);
    assert_eq!(page.opened().expect("a scene")["has_photos"], true);
    // Files of cameras make a folder a data set.
    place.write("scenes/cameras.xml", "<document/>");
    let said = Server::start(&["view", text(&place.at("scenes")), "--port", "0"]).wait().1;
    assert!(said.contains("no folder with photos"), "{said}");
    place.remove("scenes/cameras.xml");
    // A viewer of one scene lists nothing.
    let server = Server::view(&place.at("scenes/b.ply"), &[]);
    assert_eq!(server.post("/paths", &[JSON], b"{\"path\": \"\"}").0, 403);
}

/// Files that are added lie beside the open scene: one picture, parts that can be selected, and the command that joins the files.
#[test]
fn viewer_opens_several_scenes_together() {
    let empty = Empty::start(&[]);
    let mut page = empty.server.page();
    let upload = |page: &mut Page, name: &str, count: usize| {
        assert_eq!(empty.server.post(&format!("/upload/{name}"), &[BINARY], &bytes_of(count, ".ply")).0, 202);
        page.opened().expect("a scene")
    };
    // There is nothing yet that it could join.
    assert_eq!(upload(&mut page, "a.ply?add=1", 80)["scenes"], json!([]));
    let same = upload(&mut page, "a.ply?add=1", 10);
    assert_eq!((&same["gaussians"], &same["convert"]), (&json!(90), &Value::Null));
    let alone = upload(&mut page, "a.ply", 80);
    let both = upload(&mut page, "b.ply?add=1", 50);
    assert_eq!((&alone["joined"], &both["joined"]), (&Value::Null, &alone["run"]));
    assert_eq!((&both["name"], &both["gaussians"]), (&json!("a.ply + b.ply"), &json!(130)));
    assert_eq!(both["scenes"], json!([{ "name": "a.ply", "count": 80 }, { "name": "b.ply", "count": 50 }]));
    assert_eq!(both["convert"], "ashsplat convert a.ply b.ply a_cut.ply");
    let mut joined = ball(80);
    joined.append(&ball(50));
    let shown = |page: &mut Page| page.look(&camera(0.0), &json!({ "quality": 0 }));
    assert!(shown(&mut page).rgb() == rendered(&joined, &camera(0.0), &RenderSettings::default()));
    let region = json!({ "kind": "range", "first": 80, "count": 50 });
    let edit = |page: &mut Page, op: &str| {
        let run = &both["run"];
        page.send(&json!({ "type": "edit", "run": run, "op": op, "region": region, "how": "set" }));
        shown(page)
    };
    assert_eq!(edit(&mut page, "select").header["edits"]["selected"], 50);
    // Hidden Gaussians would be lost.
    edit(&mut page, "hide");
    assert_eq!(empty.server.post("/upload/c.ply?add=1", &[BINARY], &bytes_of(20, ".ply")).0, 202);
    assert!(page.opened().expect_err("refused").contains("show or delete them first"));
    edit(&mut page, "undo");
    assert!(edit(&mut page, "delete").rgb() == rendered(&ball(80), &camera(0.0), &RenderSettings::default()));
    // Deleted Gaussians stay deleted when another scene joins, and no command brings them back.
    let three = upload(&mut page, "c.ply?add=1", 20);
    assert_eq!(three["scenes"][1], json!({ "name": "b.ply", "count": 0 }));
    assert!(three["convert"].is_null());
    assert_eq!(upload(&mut page, "d.ply", 70)["gaussians"], 70);
}
