//! Trees of tiles on the page.

use super::*;
use ashsplat_files::Progress;
use ashsplat_files::tiles::{self, Demand, TileOptions, Tree};
use std::collections::BTreeSet;

const COUNT: usize = 900;

/// A tree of the ball as `tree`.
fn with_tree() -> (TestFolder, Tree) {
    let place = TestFolder::empty();
    let tree = place.at("tree");
    let options = TileOptions { max_gaussians: 60, packed: false };
    // The error's value does not matter, as long as coarser tiles have larger ones.
    let mut measure = |_: &Gaussians, _: &Gaussians| Ok(0.1);
    let scene = write_ball(&place.at(""), COUNT);
    tiles::write(&scene, &tree, &options, &ReadOptions::default(), &mut measure, &Progress::NONE)
        .expect("tiles");
    (place, Tree::open(&tree).expect("a tree"))
}

/// Requests frames until no tile is missing. Returns the first and the last frame, and the messages.
fn settled(page: &mut Page, camera: &Camera, look: &Value) -> (PageFrame, PageFrame, BTreeSet<String>) {
    let (start, mut first, mut said) = (Instant::now(), None, BTreeSet::new());
    while start.elapsed() < PATIENCE {
        page.send(&view(1, camera, look));
        let shown = loop {
            match page.receive() {
                PageMessage::Frame(shown) => break shown,
                PageMessage::Message(message) => said.extend(message["message"].as_str().map(str::to_owned)),
            }
        };
        page.send(&json!({ "type": "ack" }));
        if shown.header["tree"]["missing"] == 0 {
            let first = first.unwrap_or(PageFrame { header: shown.header.clone(), picture: Vec::new() });
            return (first, shown, said);
        }
        first.get_or_insert(shown);
        std::thread::sleep(Duration::from_millis(5));
    }
    panic!("tiles do not come");
}

/// A page's first frame shows the coarsest tile. Its last equals the picture of `render --budget`, to the bit.
#[test]
fn viewer_streams_a_tree_until_it_is_what_render_draws() {
    let (place, tree) = with_tree();
    let server = Server::view(&place.at("tree/tileset.json"), &["--budget", "50%"]);
    let mut page = server.page();
    assert_eq!(page.greeting["gaussians"], COUNT);
    assert_eq!(page.greeting["tree"], json!({ "budget": COUNT / 2, "least": tree.tiles()[0].gaussians }));
    let cameras = [0.3, 1.9].map(camera);
    let named = ["a", "b"].into_iter().zip(&cameras);
    cameras_json::write(place.at("cameras.json"), named, &WorldFrame::default()).expect("written");
    for (budget, look) in [("50%", json!({ "quality": 0 })), ("250", json!({ "quality": 0, "budget": 250 }))]
    {
        place.run(format!("render @tree --budget {budget} --path @cameras.json -o @out")).ok();
        for (index, camera) in cameras.iter().enumerate() {
            let (first, last, said) = settled(&mut page, camera, &look);
            let tree = &last.header["tree"];
            if budget == "50%" && index == 0 {
                // No other tile was requested yet, and the frame did not wait.
                assert_eq!((&first.header["tree"]["drawn"], &tree["of"]), (&json!(1), &json!(COUNT)));
                assert!(first.header["tree"]["missing"].as_u64() > Some(3), "{}", first.header);
                assert!(tree["drawn"].as_u64() > Some(3), "{}", last.header);
                assert!(first.rgb() != last.rgb());
            }
            let expected = place.picture(format!("out/{index:05}.png")).into_raw();
            assert!(last.rgb() == expected, "{budget}, camera {index}: {}", last.header);
            assert!(said.is_empty(), "{said:?}");
        }
    }
    // Another page immediately has the tiles that the first one has loaded.
    let mut other = server.page();
    let (first, _, _) = settled(&mut other, &cameras[1], &json!({ "quality": 0, "budget": 250 }));
    assert_eq!(first.header["tree"]["missing"], 0);
    // A part of a tree cannot be saved as a scene.
    assert_eq!(server.get("/export/tree.ply", &[]).0, 422);
    assert!(page.greeting["convert"].is_null());
    assert_eq!(server.end(), (Some(0), String::new()));
}

/// Each missing or damaged tile is named once on the page and on the terminal; coarser ones replace it.
#[test]
fn viewer_names_tiles_that_cannot_be_read() {
    let (place, tree) = with_tree();
    let camera = camera(0.3);
    let cut = tree.cut(&camera, COUNT);
    let lost = [cut[1], *cut.last().expect("tiles")];
    let files = lost.map(|tile| tree.path(tile).expect("a tile"));
    std::fs::remove_file(&files[0]).expect("removed");
    let bytes = std::fs::read(&files[1]).expect("a tile");
    std::fs::write(&files[1], &bytes[..bytes.len() / 2]).expect("damaged");
    let server = Server::view(&place.at("tree"), &["--budget", "100%"]);
    let mut page = server.page();
    let (_, shown, said) = settled(&mut page, &camera, &json!({ "quality": 0 }));
    let drawn = tree.cut_among(&Demand::of(&camera, COUNT), |tile| !lost.contains(&tile));
    assert!(drawn.len() > 3 && drawn != cut, "{drawn:?}");
    let mut expected = Gaussians { sh_degree: 1, ..Gaussians::default() };
    for tile in drawn {
        expected.append(&tree.read(tile, &ReadOptions::default()).expect("a tile").gaussians);
    }
    let expected = rendered(&expected, &camera, &RenderSettings::default());
    assert!(shown.rgb() == expected, "{}", shown.header);
    let names = files.each_ref().map(|file| file.file_name().and_then(|name| name.to_str()).expect("UTF-8"));
    let problem = shown.header["tree"]["problem"].as_str().expect("a problem");
    assert!(names.iter().any(|name| problem.contains(name)), "{problem}");
    let (code, stderr) = server.end();
    assert_eq!(code, Some(0), "{stderr}");
    for name in names {
        let of = |lines: &mut dyn Iterator<Item = &str>| lines.filter(|line| line.contains(name)).count();
        assert_eq!(of(&mut said.iter().map(String::as_str)), 1, "{said:?}");
        assert_eq!(of(&mut stderr.lines()), 1, "{stderr}");
    }
}

#[test]
fn viewer_refuses_what_is_no_tree() {
    let place = TestFolder::empty();
    write_ball(&place.at(""), 50);
    place.run("view @ball.ply --budget 10 --port 0").refused(&["--budget", "folders of tiles"]);
}

/// If tiles leave no memory for a picture, some are dropped, and a message says so once.
#[test]
fn viewer_draws_fewer_tiles_where_a_picture_finds_no_memory() {
    let (place, _) = with_tree();
    // Enough for all tiles, but not for a picture of them, which needs 1 MiB in all.
    let server = Server::view(&place.at("tree"), &["--budget", "100%", "--max-memory", "875K"]);
    let mut page = server.page();
    for turn in [0.3, 1.9, 0.3] {
        let (_, shown, said) =
            settled(&mut page, &camera(turn).scaled_to(192, 128), &json!({ "quality": 0 }));
        let tree = &shown.header["tree"];
        let (drawn, budget) = (tree["drawn"].as_u64(), tree["budget"].as_u64());
        assert!(drawn > Some(1) && budget < Some(COUNT as u64), "{tree}");
        let words = "no memory for 900 Gaussians, at most 450";
        assert!(said.iter().all(|problem| problem.contains(words)), "{said:?}");
    }
    let (code, stderr) = server.end();
    assert_eq!((code, stderr.matches("no memory").count()), (Some(0), 1), "{stderr}");
}
