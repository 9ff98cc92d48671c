//! `tiles`.

use super::*;
use ashsplat_files::splats::{self, WriteOptions};
use serde_json::Value;

use crate::common::splats::scene;

fn written(folder: &Path, gaussians: usize) -> PathBuf {
    let path = folder.join("scene.ply");
    splats::write(&path, &scene(gaussians, 1), &WriteOptions::default()).expect("a scene");
    path
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
    let place = tempfile::tempdir().expect("a folder");
    let (scene, out) = (written(place.path(), 400), place.path().join("tiles"));
    let told = succeed(&["tiles", text(&scene), "-o", text(&out), "--max-gaussians", "50"]);
    let document = std::fs::read_to_string(out.join("tileset.json")).expect("a tileset");
    let document: Value = serde_json::from_str(&document).expect("JSON");
    let (mut gaussians, mut tiles) = (0, 0);
    check(&document["root"], &mut gaussians, &mut tiles);
    assert_eq!(gaussians, 400);
    assert!(told.contains("400 Gaussians") && told.contains(&format!("{tiles} tiles")), "{told}");
    // Pictures 20 units wide, whose channels differ by less than 1, and 3 levels.
    let error = document["root"]["geometricError"].as_f64().expect("an error");
    assert!((0.1..80.0).contains(&error), "{error}");
    // Packed: smaller files of the same tree and the same scene.
    let packed = place.path().join("packed");
    succeed(&["tiles", text(&scene), "-o", text(&packed), "--max-gaussians", "50", "--spz", "--quiet"]);
    let own = std::fs::read_to_string(packed.join("tileset.json")).expect("a tileset");
    assert!(own.contains("KHR_gaussian_splatting_compression_spz_2"), "{own}");
    let own: Value = serde_json::from_str(&own).expect("JSON");
    let (mut of_packed, mut tiles_of_packed) = (0, 0);
    check(&own["root"], &mut of_packed, &mut tiles_of_packed);
    assert_eq!((of_packed, tiles_of_packed), (gaussians, tiles));
    let bytes = |folder: &Path| -> u64 {
        let files = files_below(folder).into_iter().map(|file| folder.join(file));
        files.map(|file| std::fs::metadata(file).expect("a file").len()).sum()
    };
    assert!(2 * bytes(&packed) < bytes(&out), "{} {}", bytes(&packed), bytes(&out));
    let pictures = [&out, &packed].map(|tree| {
        let picture = tree.with_extension("png");
        let look = ["--orbit", "1", "--width", "96", "--height", "64", "--quiet"];
        succeed(&[&["render", text(tree), "-o", text(&picture)][..], &look].concat());
        image::open(picture).expect("a picture").to_rgb8().into_raw()
    });
    let far = pictures[0].iter().zip(&pictures[1]).map(|(a, b)| f64::from(a.abs_diff(*b)).powi(2));
    let psnr = 10.0 * (255.0_f64.powi(2) * pictures[0].len() as f64 / far.sum::<f64>()).log10();
    assert!(psnr > 30.0, "{psnr}");
    // Scaled scenes: lengths scale with them, also if everything is nearer than the near plane's z.
    for scale in ["0.01", "100"] {
        let [other, tiles] = ["other.ply", &format!("tiles{scale}")].map(|name| place.path().join(name));
        succeed(&["convert", text(&scene), text(&other), "--scale", scale, "--quiet"]);
        succeed(&["tiles", text(&other), "-o", text(&tiles), "--max-gaussians", "50", "--quiet"]);
        let own = std::fs::read_to_string(tiles.join("tileset.json")).expect("a tileset");
        let own: Value = serde_json::from_str(&own).expect("JSON");
        let own = own["root"]["geometricError"].as_f64().expect("an error");
        let ratio = own / error / scale.parse::<f64>().expect("a number");
        assert!((ratio - 1.0).abs() < 0.02, "{scale}: {own}, {error} at 1");
    }
    // Errors are measured with antialiasing if the file is marked so.
    let [plain, antialiased] = [false, true].map(|antialiased| {
        let [file, tiles] = ["glb", "tiles"].map(|end| place.path().join(format!("{antialiased}.{end}")));
        let options = WriteOptions { antialiased, ..WriteOptions::default() };
        splats::write(&file, &crate::common::splats::scene(400, 1), &options).expect("a scene");
        succeed(&["tiles", text(&file), "-o", text(&tiles), "--max-gaussians", "50", "--quiet"]);
        let own = std::fs::read_to_string(tiles.join("tileset.json")).expect("a tileset");
        let own: Value = serde_json::from_str(&own).expect("JSON");
        own["root"]["geometricError"].as_f64().expect("an error")
    });
    assert!((plain / error - 1.0).abs() < 1e-3, "{plain} {error}");
    assert!((antialiased / plain - 1.0).abs() > 1e-2, "{antialiased} {plain}");
    // A merged tile is no copy: finer tiles have smaller errors.
    let finest = place.path().join("one");
    succeed(&["tiles", text(&scene), "-o", text(&finest), "--quiet"]);
    let one = std::fs::read_to_string(finest.join("tileset.json")).expect("a tileset");
    let one: Value = serde_json::from_str(&one).expect("JSON");
    assert_eq!(one["root"]["geometricError"], 0.0);
}

#[test]
fn tiles_refuse_by_name() {
    let place = tempfile::tempdir().expect("a folder");
    let scene = written(place.path(), 20);
    let folder = |name: &str| place.path().join(name);
    let refused = |out: &Path, more: &[&str], words: &[&str]| {
        refuse(&[&["tiles", text(&scene), "-o", text(out)], more].concat(), words);
    };
    refused(&scene, &[], &["scene.ply", "is a file"]);
    std::fs::create_dir(folder("full")).expect("a folder");
    std::fs::write(folder("full").join("mine"), "1").expect("a file");
    refused(&folder("full"), &[], &["full", "is there already"]);
    refused(&folder("new"), &["--max-gaussians", "1"], &["2 or more"]);
    refused(&scene.join("new"), &[], &["scene.ply"]);
    refused(&folder("full/.."), &[], &["is there already"]);
    // An empty folder is replaced, but not one behind a link.
    #[cfg(unix)]
    {
        let away = tempfile::tempdir().expect("a folder");
        std::os::unix::fs::symlink(away.path(), folder("link")).expect("a link");
        refused(&folder("link"), &[], &["link", "cannot be replaced"]);
        assert!(std::fs::read_dir(away.path()).is_ok_and(|mut entries| entries.next().is_none()));
        std::fs::remove_file(folder("link")).expect("a link");
    }
    let mut names: Vec<_> = std::fs::read_dir(place.path())
        .expect("a folder")
        .map(|e| e.expect("an entry").file_name())
        .collect();
    names.sort();
    assert_eq!(names, ["full", "scene.ply"]);
}

#[test]
fn a_tree_is_drawn_within_a_budget() {
    let place = tempfile::tempdir().expect("a folder");
    let (scene, out) = (written(place.path(), 400), place.path().join("tiles"));
    let told = succeed(&["tiles", text(&scene), "-o", text(&out), "--max-gaussians", "50", "--measure"]);
    let rows: Vec<Vec<f64>> = told.lines().filter(|line| line.contains('%')).map(numbers).collect();
    assert_eq!(rows.iter().map(|row| row[0]).collect::<Vec<_>>(), [5.0, 10.0, 25.0, 50.0, 100.0], "{told}");
    for row in &rows {
        // The coarsest tile is always drawn.
        assert!(
            row[1] <= (4.0 * row[0]).max(50.0) && row[2] >= 1.0 && row[3] >= row[4] && row[5] > 0.0,
            "{told}"
        );
    }
    assert!(
        rows[4][1] == 400.0 && rows[4][4] > 60.0 && rows[3][4] < 60.0 && rows[3][3] > rows[0][3],
        "{told}"
    );
    let pictures = place.path().join("pictures");
    let drawn = |budget: &[&str]| {
        let views = ["--orbit", "2", "--width", "64", "-o", text(&pictures)];
        succeed(&[&["render", text(&out)], &views[..], budget].concat())
    };
    let of = |told: &str| {
        let counts =
            told.lines().filter_map(|line| line.split(" of ").nth(1)?.split(' ').next()?.parse().ok());
        counts.collect::<Vec<u32>>()
    };
    assert_eq!(of(&drawn(&[])), [400, 400]);
    // Opens the tileset by its description; other commands explain what the folder is.
    let described = out.join("tileset.json");
    assert_eq!(of(&succeed(&["render", text(&described), "--orbit", "1", "-o", text(&pictures)])), [400]);
    refuse(&["info", text(&out)], &["is a folder of tiles", "ashsplat render"]);
    let half = of(&drawn(&["--budget", "50%"]));
    assert!(half.len() == 2 && half.iter().all(|count| (100..=200).contains(count)), "{half:?}");
    // The coarsest tile exceeds the budget.
    let coarsest = of(&drawn(&["--budget", "1"]));
    assert!(coarsest[0] == coarsest[1] && (2..=50).contains(&coarsest[0]), "{coarsest:?}");
    refuse(&["render", text(&scene), "--budget", "1", "--orbit", "1"], &["--budget", "folders of tiles"]);
    std::fs::remove_file(out.join("0.glb")).expect("a tile");
    let orbit = ["--orbit", "1", "-o", text(&pictures)];
    refuse(&[&["render", text(&out)], &orbit[..]].concat(), &["0.glb"]);
}

/// Numbers in a line of a table.
fn numbers(line: &str) -> Vec<f64> {
    let words = line.split_whitespace().map(|word| word.trim_end_matches('%').replace(',', ""));
    words.map(|word| word.parse().expect("a number")).collect()
}
