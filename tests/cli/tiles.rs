//! `tiles`.

use super::*;
use crate::common::splats::scene;
use serde_json::json;

fn with_scene(gaussians: usize) -> TestFolder {
    let place = TestFolder::empty();
    place.write_scene("scene.ply", &scene(gaussians, 1));
    place
}

/// Checks the errors of a tile and its children, from the root down.
fn check(tile: &Value, gaussians: &mut u64, tiles: &mut u32) {
    let error = |tile: &Value| tile["geometricError"].as_f64().expect("an error");
    let children = tile["children"].as_array().map_or(&[][..], Vec::as_slice);
    *tiles += 1;
    if children.is_empty() {
        assert_eq!(error(tile), 0.0);
        *gaussians += tile["extras"]["gaussians"].as_u64().expect("a number");
    }
    for child in children {
        assert!(error(tile) > error(child), "{} above {}", error(tile), error(child));
        check(child, gaussians, tiles);
    }
}

#[test]
fn a_scene_becomes_tiles_whose_errors_are_measured() {
    let place = with_scene(400);
    // Writes a tree. Returns its root tile, the root's error, and what is printed.
    let tree = |scene: &str, tree: &str, options: &str| {
        let output = place.run(format!("tiles @{scene} -o @{tree} {options}")).ok().stdout;
        let root = place.read_json(format!("{tree}/tileset.json"))["root"].clone();
        let error = root["geometricError"].as_f64().expect("an error");
        (root, error, output)
    };
    let small = "--max-gaussians 50";
    let (root, error, output) = tree("scene.ply", "tiles", small);
    let (mut gaussians, mut tiles) = (0, 0);
    check(&root, &mut gaussians, &mut tiles);
    assert_eq!(gaussians, 400);
    assert_says(&output, &["400 Gaussians", &format!("{tiles} tiles")]);
    // Pictures 20 units wide, whose channels differ by less than 1, and 3 levels.
    assert!((0.1..80.0).contains(&error), "{error}");
    // Packed: smaller files of the same tree and the same scene.
    let (packed, ..) = tree("scene.ply", "packed", &format!("{small} --spz"));
    let extension = "KHR_gaussian_splatting_compression_spz_2";
    assert_says(place.read_text("packed/tileset.json"), &[extension]);
    let (mut of_packed, mut tiles_of_packed) = (0, 0);
    check(&packed, &mut of_packed, &mut tiles_of_packed);
    assert_eq!((of_packed, tiles_of_packed), (gaussians, tiles));
    let [plain_bytes, packed_bytes] = ["tiles", "packed"].map(|tree| {
        let files = place.files(tree).into_iter().map(|file| place.at(tree).join(file));
        files.map(|file| std::fs::metadata(file).expect("a file").len()).sum::<u64>()
    });
    assert!(2 * packed_bytes < plain_bytes, "{packed_bytes} {plain_bytes}");
    let pictures = ["tiles", "packed"].map(|tree| {
        let look = "--orbit 1 --width 96 --height 64 --quiet";
        place.run(format!("render @{tree} -o @{tree}.png {look}")).ok();
        place.picture(format!("{tree}.png")).into_raw()
    });
    let psnr = psnr(&pictures[0], &pictures[1]);
    assert!(psnr > 30.0, "{psnr}");
    // Scaled scenes: lengths scale with them, also if everything is nearer than the near plane's z.
    for scale in [0.01, 100.0] {
        place.run(format!("convert @scene.ply @other.ply --scale {scale} --quiet")).ok();
        let (_, own, _) = tree("other.ply", &format!("tiles{scale}"), small);
        assert!((own / error / scale - 1.0).abs() < 0.02, "{scale}: {own}, {error} at 1");
    }
    // Errors are measured with antialiasing if the file is marked so.
    let [plain, antialiased] = [false, true].map(|antialiased| {
        let options = WriteOptions { antialiased, ..WriteOptions::default() };
        let file = format!("{antialiased}.glb");
        splats::write(place.at(&file), &scene(400, 1), &options).expect("a scene");
        tree(&file, &format!("{antialiased}.tiles"), small).1
    });
    assert!((plain / error - 1.0).abs() < 1e-3, "{plain} {error}");
    assert!((antialiased / plain - 1.0).abs() > 1e-2, "{antialiased} {plain}");
    // A tree of a single tile is exact: only merged tiles have an error.
    assert_eq!(tree("scene.ply", "one", "").1, 0.0);
}

/// The finest level of a streamed SOG is the scene, as exactly as a SOG holds it.
#[test]
fn a_scene_becomes_a_streamed_sog() {
    let place = with_scene(20_000);
    let output = place.run("tiles @scene.ply -o @one --sog --max-gaussians 6000").ok().stdout;
    assert_says(&output, &["20,000 Gaussians", "lod-meta.json", "2 levels", "25,000 Gaussians in all"]);
    place.run("tiles @scene.ply -o @other --sog --max-gaussians 6000").ok();
    assert_eq!(place.files("one"), place.files("other"));
    for file in place.files("one") {
        assert!(place.read(format!("one/{}", text(&file))) == place.read(format!("other/{}", text(&file))));
    }
    let meta = place.read_json("one/lod-meta.json");
    assert_eq!((&meta["counts"], &meta["lodLevels"]), (&json!([20_000, 5000]), &json!(2)));
    assert_eq!(meta["filenames"], json!(["0_0/meta.json", "1_0/meta.json"]));
    let regions = meta["tree"]["children"].as_array().expect("regions");
    let count = |region: &Value, level: &str| region["lods"][level]["count"].as_u64().expect("a number");
    assert!(regions.iter().all(|region| (1..=6000).contains(&count(region, "0"))));
    for (level, whole) in [("0", 20_000), ("1", 5000)] {
        assert_eq!(regions.iter().map(|region| count(region, level)).sum::<u64>(), whole);
    }
    let output = place.run("convert @one @back.ply").ok().stderr;
    assert_says(&output, &["the finest of 2 levels"]);
    place.run("convert @scene.ply @whole.sog").ok();
    let pictures = ["scene.ply", "whole.sog", "back.ply", "one/lod-meta.json"].map(|scene| {
        place.run(format!("render @{scene} -o @p.png --orbit 1 --width 96 --height 64 --quiet")).ok();
        place.picture("p.png").into_raw()
    });
    let [sog, back, streamed] = [1, 2, 3].map(|i| psnr(&pictures[0], &pictures[i]));
    assert!(sog > 35.0 && back > sog - 1.0 && streamed == back, "{sog} {back} {streamed}");
    // Files of others may be wrong.
    for (at, value, words) in [
        ("/filenames/0", json!("../scene.ply"), &["does not lie in its folder"][..]),
        ("/filenames/0", json!("http://a.b/meta.json"), &["does not lie in its folder"]),
        ("/filenames/0", json!("2_0/meta.json"), &["2_0"]),
        ("/tree/children/0/lods/0/file", json!(7), &["in file 7"]),
        ("/tree/children/0/lods/0/count", json!(u64::MAX), &["ends behind the end of 0_0/meta.json"]),
        ("/version", json!(2), &["is version 2 of a streamed SOG"]),
        ("/tree", json!(null), &["lod-meta.json"]),
    ] {
        let mut wrong = meta.clone();
        *wrong.pointer_mut(at).expect("a value") = value;
        place.write("one/lod-meta.json", wrong.to_string());
        place.run("info @one").refused(words);
    }
}

#[test]
fn tiles_refuse_by_name() {
    let place = with_scene(20);
    place.write("full/mine", "1");
    for (out, words) in [
        ("@scene.ply", &["scene.ply", "is a file"][..]),
        ("@full", &["full", "is there already"]),
        ("@new --max-gaussians 1", &["2 or more"]),
        ("@scene.ply/new", &["scene.ply"]),
        ("@full/..", &["is there already"]),
    ] {
        place.run(format!("tiles @scene.ply -o {out}")).refused(words);
    }
    // An empty folder is replaced, but not one behind a link.
    #[cfg(unix)]
    {
        let away = TestFolder::empty();
        std::os::unix::fs::symlink(away.at(""), place.at("link")).expect("a link");
        place.run("tiles @scene.ply -o @link").refused(&["link", "cannot be replaced"]);
        assert!(std::fs::read_dir(away.at("")).is_ok_and(|mut entries| entries.next().is_none()));
        std::fs::remove_file(place.at("link")).expect("a link");
    }
    assert_eq!(place.files(""), ["full/mine", "scene.ply"].map(PathBuf::from));
    assert_eq!(std::fs::read_dir(place.at("")).expect("a folder").count(), 2);
}

#[test]
fn a_tree_is_drawn_within_a_budget() {
    let place = with_scene(400);
    place.run("tiles @scene.ply -o @tiles --max-gaussians 50").ok();
    // Numbers of Gaussians drawn.
    let drawn = |scene: &str, options: &str| -> Vec<u32> {
        let output = place.run(format!("render @{scene} --width 64 -o @pictures {options}")).ok().stdout;
        output.lines().filter_map(|line| line.split(" of ").nth(1)?.split(' ').next()?.parse().ok()).collect()
    };
    assert_eq!(drawn("tiles", "--orbit 2"), [400, 400]);
    // Opens the tileset by its description; other commands explain what the folder is.
    assert_eq!(drawn("tiles/tileset.json", "--orbit 1"), [400]);
    place.run("info @tiles").refused(&["is a folder of tiles", "ashsplat render"]);
    let half = drawn("tiles", "--orbit 2 --budget 50%");
    assert!(half.len() == 2 && half.iter().all(|count| (100..=200).contains(count)), "{half:?}");
    // A larger budget's picture is nearer to that of the whole tree.
    let [all, half, few] = ["100%", "50%", "5%"].map(|budget| {
        place.run(format!("render @tiles --orbit 1 --width 64 -o @one.png --quiet --budget {budget}")).ok();
        place.picture("one.png").into_raw()
    });
    assert!(psnr(&all, &half) > psnr(&all, &few) && half != all);
    // The coarsest tile exceeds the budget.
    let coarsest = drawn("tiles", "--orbit 2 --budget 1");
    assert!(coarsest[0] == coarsest[1] && (2..=50).contains(&coarsest[0]), "{coarsest:?}");
    place.run("render @scene.ply --budget 1 --orbit 1").refused(&["--budget", "folders of tiles"]);
    place.remove("tiles/0.glb");
    place.run("render @tiles --orbit 1 -o @pictures").refused(&["0.glb"]);
}

/// PSNR of 8-bit pictures, dB.
fn psnr(a: &[u8], b: &[u8]) -> f64 {
    let squares = a.iter().zip(b).map(|(a, b)| f64::from(a.abs_diff(*b)).powi(2));
    10.0 * (255.0_f64.powi(2) * a.len() as f64 / squares.sum::<f64>()).log10()
}
