//! `partition`, `train --job` and `merge`: a scene that is trained in blocks.

use super::checkpoints::{Place, assert_trained};
use super::*;
use ashsplat::Gaussians;
use ashsplat::scene::Bounds;
use ashsplat_files::splats::{self, ReadOptions};
use serde_json::Value;

pub(super) fn read(path: &Path) -> Gaussians {
    splats::read(path, &ReadOptions::default()).expect("Gaussians").gaussians
}

/// A data set and a coarse model of it.
pub(super) fn place() -> Place {
    let place = Place::new();
    assert_trained(&place.train("coarse", &["--iterations", "12", "--eval"]));
    place
}

pub(super) fn partition(place: &Place, file: &str, more: &[&str]) -> Finished {
    let (coarse, out) = (place.model("coarse"), place.model(file));
    let given = ["partition", "--coarse", text(&coarse), "-o", text(&out), "--iterations", "14"];
    // The Gaussians are faint after so few steps.
    let share = if more.contains(&"--min-share") { &[][..] } else { &["--min-share", "0.03"] };
    finish(program().args(given).args(share).args(more))
}

/// Trains a block for a few steps, with the low SH degree of the coarse model.
pub(super) fn job(place: &Place, number: u32, more: &[&str]) -> Finished {
    let job = format!("{}:{number}", text(&place.model("blocks.json")));
    finish(program().args(["train", "--job", &job, "--quiet", "--sh-degree", "1"]).args(more))
}

pub(super) fn merge(place: &Place, out: &str) -> Finished {
    let (blocks, out) = (place.model("blocks.json"), place.model(out));
    finish(program().args(["merge", text(&blocks), "-o", text(&out)]))
}

/// Status of each block, and the number of trained blocks.
pub(super) fn status(place: &Place) -> (Vec<Value>, Value) {
    let told = succeed(&["blocks", text(&place.model("blocks.json")), "--json"]);
    let told: Value = serde_json::from_str(&told).expect("JSON");
    (told["blocks"].as_array().expect("blocks").clone(), told["trained"].clone())
}

pub(super) fn division(place: &Place) -> Value {
    let text = std::fs::read_to_string(place.model("blocks.json")).expect("blocks.json");
    serde_json::from_str(&text).expect("JSON")
}

/// Number of pixels of a block's photos or of the parts used.
fn pixels_of(block: &Value) -> u64 {
    let names =
        ["photos", "held_out"].map(|list| block[list].as_array().cloned().unwrap_or_default()).concat();
    let of = |name: &Value| {
        let part = &block["parts"][name.as_str().expect("a name")];
        let side = |list: &str, index: usize| {
            let number = |at: &Value| at.as_f64().expect("a number");
            let all = f64::from(SIZE[index]);
            let share = || (number(&part[list][1]) - number(&part[list][0])) / number(&part["of"][index]);
            if part.is_null() { all } else { (share() * all).ceil() }
        };
        (side("columns", 0) * side("rows", 1)) as u64
    };
    names.iter().map(of).sum()
}

/// Core box of a block; null means unbounded.
pub(super) fn core(block: &Value) -> Bounds {
    let corner = |name: &str, end: f32| {
        Vec3::from_array(
            [0, 1, 2].map(|axis| block["core"][name][axis].as_f64().map_or(end, |side| side as f32)),
        )
    };
    Bounds { min: corner("min", f32::NEG_INFINITY), max: corner("max", f32::INFINITY) }
}

#[test]
fn blocks_are_trained_one_by_one_and_merged() {
    let place = place();
    let plot = place.model("plan.svg");
    let mut files = files_below(&place.model(""));
    assert_trained(&partition(&place, "blocks.json", &["--max-gaussians", "300", "--plot", text(&plot)]));
    // Photos are referenced, not copied.
    files.extend(["blocks.json", "plan.svg"].map(PathBuf::from));
    files.sort();
    assert_eq!(files_below(&place.model("")), files);
    // A repeated partition gives the same bytes.
    let first = std::fs::read(place.model("blocks.json")).expect("blocks.json");
    let data = place.model("data");
    assert_trained(&partition(&place, "blocks.json", &[text(&data), "--max-gaussians", "300"]));
    assert!(first == std::fs::read(place.model("blocks.json")).expect("blocks.json"), "other bytes");

    let division = division(&place);
    let blocks = division["blocks"].as_array().expect("blocks");
    // Rates are those of a training of the whole scene, with the first and the ninth view held out.
    let extent = ashsplat::scene::scene_extent((1..VIEWS - 1).map(|index| view(index).position()));
    let written = division["scene_extent"].as_f64().expect("an extent");
    assert!((written - f64::from(extent)).abs() < 1e-5, "{written} {extent}");
    let coarse = read(&place.model("coarse/point_cloud/iteration_12/point_cloud.ply"));
    let drawn = std::fs::read_to_string(&plot).expect("a drawing");
    assert!(blocks.len() > 2 && drawn.matches(">block ").count() == blocks.len(), "{drawn}");
    // From above and from the side, because the cells of a wall lie one above another.
    let views: Vec<&str> = drawn.split("<g ").skip(1).collect();
    assert_eq!(views.iter().map(|view| view.matches("<title>").count()).collect::<Vec<_>>(), [9, 9]);
    assert!(views[1].matches("stroke-width=\"1.5\"").count() > 1, "{drawn}");
    let told = succeed(&["blocks", text(&place.model("blocks.json"))]);
    let waiting = format!("block 2: waiting, 0/{}\n", blocks[1]["iterations"]);
    assert!(
        told.contains(&waiting) && told.ends_with(&format!("\n0 of {} blocks trained\n", blocks.len())),
        "{told}"
    );
    for block in blocks {
        let inside =
            coarse.means.iter().filter(|&&mean| core(block).contains(Vec3::from_array(mean))).count();
        assert_eq!(block["gaussians"], inside, "{block}");
        assert!((1..=300).contains(&inside) && block["trained"].as_u64() > Some(inside as u64), "{block}");
        let photos = block["photos"].as_array().expect("photos");
        // The first and the ninth photo are held out; 14 iterations use each photo twice.
        assert!(photos.iter().all(|name| name != "01.png" && name != "09.png"), "{block}");
        assert_eq!(block["iterations"], 2 * photos.len(), "{block}");
        assert_trained(&job(&place, block["number"].as_u64().expect("a number") as u32, &[]));
    }
    let (all, trained) = status(&place);
    assert_eq!(trained, blocks.len());
    for (status, block) in all.iter().zip(blocks) {
        assert_eq!((&status["state"], &status["iteration"]), (&"trained".into(), &block["iterations"]));
        assert_eq!(status["iterations"], block["iterations"]);
        let measured = ["gaussians", "psnr", "iterations_per_second", "peak_bytes"];
        assert!(measured.iter().all(|name| status[name].as_f64() > Some(1.0)), "{status}");
        assert!(status["trainer"].is_null());
        let begun = block["trained"].as_u64().expect("a number");
        let pixels = block["pixels"].as_u64().expect("a number");
        assert_eq!(pixels, pixels_of(block));
        assert_eq!(status["memory_bytes"], 1_500_000_000 + 4 * pixels + 10 * 944 * begun);
    }
    refuse(
        &["blocks", text(&place.model("blocks.json")), "--json", "--growth", "0.5"],
        &["--growth", "1 or more"],
    );
    let told = succeed(&["blocks", text(&place.model("blocks.json"))]);
    for line in told.lines().take(blocks.len()) {
        assert!(
            ["trained", " dB, ", " it/s, ", " Gaussians"].iter().all(|word| line.contains(word)),
            "{line}"
        );
    }
    // `--watch` ends when all blocks are trained.
    succeed(&["blocks", text(&place.model("blocks.json")), "--watch", "1"]);
    let sum = |name: &str| blocks.iter().filter_map(|block| block[name].as_u64()).sum::<u64>();
    assert_eq!(sum("gaussians"), coarse.len() as u64);

    let merged = merge(&place, "new/scene.ply");
    assert_trained(&merged);
    let mut union = Gaussians { sh_degree: 1, ..Default::default() };
    for block in blocks {
        let folder = place.model("").join(block["folder"].as_str().expect("a folder"));
        let scene = folder.join(format!("point_cloud/iteration_{}/point_cloud.ply", block["iterations"]));
        let mut own = read(&scene);
        let all = own.len();
        own.retain(|own, index| core(block).contains(Vec3::from_array(own.means[index])));
        assert!(
            own.len() < all && own.len() > 20,
            "the margin is trained, and left out: {} {all}",
            own.len()
        );
        assert!(merged.stdout.contains(&format!("block {}: {} Gaussians", block["number"], own.len())));
        union.append(&own);
    }
    let scene = read(&place.model("new/scene.ply"));
    assert!(scene == union, "{} {}", scene.len(), union.len());
    for mean in scene.means.iter().map(|&mean| Vec3::from_array(mean)) {
        assert_eq!(blocks.iter().filter(|block| core(block).contains(mean)).count(), 1, "{mean}");
    }
    // `merge --report` measures the scene and the coarse model as `eval` does.
    let (blocks_json, coarse_model) = (place.model("blocks.json"), place.model("coarse"));
    let (out, page) = (place.model("again.ply"), place.model("quality/page.html"));
    let measured = ["merge", text(&blocks_json), "-o", text(&out), "--report", text(&page), "--against"];
    let said = succeed(&[&measured[..], &[text(&coarse_model)]].concat());
    assert!(std::fs::read(&out).ok() == std::fs::read(place.model("new/scene.ply")).ok(), "other bytes");
    let results = std::fs::read(place.model("quality/page.html.json")).expect("JSON");
    let results: Value = serde_json::from_slice(&results).expect("JSON");
    for (name, model) in [("merged", &out), ("against", &coarse_model)] {
        let table = succeed(&["eval", text(model), "-s", text(&data), "--eval", "--quiet", "--json"]);
        let table: Value = serde_json::from_str(&table).expect("JSON");
        let [own, evaluated] =
            [&results[name]["mean_psnr"], &table["mean"]["PSNR"]].map(|psnr| psnr.as_f64());
        assert!(
            own.zip(evaluated).is_some_and(|(own, evaluated)| (own - evaluated).abs() < 0.01),
            "{own:?} {table}"
        );
        // Every pixel lies either inside or along a seam.
        let part = |part: &str| results[name][part].as_f64().expect("a number");
        let (least, most) =
            (part("inside_psnr").min(part("seam_psnr")), part("inside_psnr").max(part("seam_psnr")));
        assert!((least..=most).contains(&part("psnr")) && least < most, "{results}");
        assert!(
            said.contains(&format!("{name}: PSNR {:.2} dB on 2 held-out views", part("mean_psnr"))),
            "{said}"
        );
    }
    let seams = results["seams"].as_array().expect("seams");
    let psnr: Vec<f64> = seams.iter().filter_map(|seam| seam["psnr"].as_f64()).collect();
    assert!(psnr.len() == seams.len() && psnr.is_sorted() && !psnr.is_empty(), "{results}");
    let page = std::fs::read_to_string(page).expect("a page");
    assert_eq!(page.matches("<img").count(), 3);
    // Another format gives the file that convert writes.
    assert_trained(&merge(&place, "scene.spz"));
    let (ply, spz) = (place.model("new/scene.ply"), place.model("converted.spz"));
    succeed(&["convert", text(&ply), text(&spz)]);
    assert!(std::fs::read(place.model("scene.spz")).ok() == std::fs::read(spz).ok(), "other bytes");

    // Input files are never overwritten.
    let own = place
        .model("blocks/001")
        .join(format!("point_cloud/iteration_{}/point_cloud.ply", blocks[0]["iterations"]));
    let aside = place.model("aside.ply");
    for (out, page) in [(&own, &place.model("page.html")), (&aside, &blocks_json)] {
        let merged =
            finish(program().args(["merge", text(&blocks_json), "-o", text(out), "--report", text(page)]));
        assert_refused(&merged, &["is read; give another file"]);
    }
    assert!(std::fs::read(&blocks_json).ok() == Some(first) && !aside.exists());
    // Photos whose poses changed since the blocks were trained cannot measure the scene.
    let (images, kept) = (data.join("sparse/0/images.bin"), place.model("kept.bin"));
    std::fs::copy(&images, &kept).expect("copied");
    let mut moved = std::fs::read(&images).expect("images");
    // The first image's tx: it follows the count, the image's id, and its rotation.
    moved[8 + 4 + 32..][..8].copy_from_slice(&0.25_f64.to_le_bytes());
    std::fs::write(&images, moved).expect("written");
    let page = place.model("page.html");
    let merged =
        finish(program().args(["merge", text(&blocks_json), "-o", text(&aside), "--report", text(&page)]));
    assert_refused(&merged, &["data", "its cameras are not those", "blocks.json"]);
    assert!(!aside.exists() && !page.exists());
    std::fs::rename(&kept, images).expect("moved");

    // A held-out photo is missing.
    let photo = data.join("images/09.png");
    std::fs::rename(&photo, &kept).expect("moved");
    let merged =
        finish(program().args(["merge", text(&blocks_json), "-o", text(&aside), "--report", text(&page)]));
    assert_refused(&merged, &["09.png"]);
    assert!(!aside.exists() && !page.exists());
    std::fs::rename(&kept, &photo).expect("moved");

    // A block is done when its note exists and its scene is intact.
    let folder = place.model("blocks/002");
    let ply = folder.join(format!("point_cloud/iteration_{}/point_cloud.ply", blocks[1]["iterations"]));
    let good = std::fs::read(&ply).expect("a scene");
    let again = job(&place, 2, &["--start-checkpoint", "auto", "--checkpoint-every", "5"]);
    assert!(again.stdout.contains("is trained to its end already"), "{}{}", again.stdout, again.stderr);
    assert!(!folder.join("earlier_1").exists());
    // `eval` uses the block's photos, one of which is held out.
    let known = blocks[1]["held_out"].as_array().map_or(0, Vec::len);
    let evaluated = finish(program().args(["eval", text(&folder), "--quiet"]));
    assert!(
        evaluated.stdout.contains(&format!("mean of {known}")),
        "{}{}",
        evaluated.stdout,
        evaluated.stderr
    );

    // One scene is damaged, and one is missing.
    let mut bad = good.clone();
    let last = bad.len() - 3;
    bad[last] ^= 1;
    std::fs::write(&ply, &bad).expect("written");
    std::fs::rename(place.model("blocks/001/block.json"), place.model("kept")).expect("moved");
    let before = files_below(&place.model(""));
    let refused = merge(&place, "other/scene.ply");
    assert_refused(&refused, &["blocks.json", "1 not trained to the end", "2 damaged", "--job"]);
    assert_eq!(files_below(&place.model("")), before);
    // The same command repairs it.
    assert_trained(&job(&place, 2, &["--start-checkpoint", "auto", "--checkpoint-every", "5"]));
    assert!(std::fs::read(&ply).ok() == Some(good), "other bytes");
    std::fs::rename(place.model("kept"), place.model("blocks/001/block.json")).expect("moved");
    assert_trained(&merge(&place, "new/scene.ply"));
    // A new division must not replace one whose blocks have been trained. If the file is removed, results belong to
    // another division.
    let replaced = partition(&place, "blocks.json", &["--max-gaussians", "300", "--margin", "0.4"]);
    assert_refused(&replaced, &["blocks.json", "blocks have been trained", "(now 0.4)", "another -o"]);
    std::fs::remove_file(&blocks_json).expect("removed");
    assert_trained(&partition(&place, "blocks.json", &["--max-gaussians", "300", "--margin", "0.4"]));
    assert_refused(&merge(&place, "other/scene.ply"), &["1, 2", "trained for another division"]);
    let begun = job(&place, 2, &["--start-checkpoint", "auto", "--checkpoint-every", "5"]);
    assert_refused(&begun, &["of another scene or margin"]);
    assert_eq!(status(&place).0[1]["state"], "of another division");
    // A training of the old division cannot resume as one of the new division.
    let settings = folder.join("settings.toml");
    let begun =
        finish(program().args(["train", "--config", text(&settings), "--start-checkpoint", "latest"]));
    assert_refused(&begun, &["blocks.json", "another division than the one that block 2", "--job"]);
}

#[cfg(unix)]
/// The file lists the parts of photos that a block uses.
#[test]
fn jobs_use_the_parts_of_photos_that_show_them() {
    let place = place();
    let parts = ["--max-gaussians", "300", "--margin", "0.02", "--photo-parts", "on"];
    assert_trained(&partition(&place, "blocks.json", &parts));
    let mut division = division(&place);
    let blocks = division["blocks"].as_array().expect("blocks");
    let names = |block: &Value, kind: &str| -> Vec<String> {
        let all = block[kind].as_array().expect("photos").iter();
        all.map(|name| name.as_str().expect("a name").to_owned()).collect()
    };
    for block in blocks {
        let own = [names(block, "photos"), names(block, "held_out")].concat();
        let parts = block["parts"].as_object().expect("parts");
        assert!(!parts.is_empty() && parts.keys().all(|name| own.contains(name)), "{block}");
    }
    let (block, number) = (blocks[0].clone(), blocks[0]["number"].as_u64().expect("a number") as u32);
    // Tiles and windows fill these small photos: use a smaller part of one.
    let part = |of: u64| serde_json::json!({ "of": [of, of], "columns": [0, 1], "rows": [0, of] });
    let photo = block["photos"][0].as_str().expect("a photo").to_owned();
    division["blocks"][0]["parts"][&photo] = part(8);
    let write = |division: &Value| {
        std::fs::write(place.model("blocks.json"), division.to_string()).expect("written");
    };
    write(&division);
    let loud = |more: &[&str]| {
        let job = format!("{}:{number}", text(&place.model("blocks.json")));
        finish(program().args(["train", "--job", &job, "--sh-degree", "1"]).args(more))
    };
    let iterations = block["iterations"].as_u64().expect("iterations");
    let scene = || {
        let folder = place.model(block["folder"].as_str().expect("a folder"));
        std::fs::read(folder.join(format!("point_cloud/iteration_{iterations}/point_cloud.ply")))
            .expect("a scene")
    };
    let of_parts = loud(&[]);
    assert_trained(&of_parts);
    assert!(
        of_parts.stderr.contains("of the photos ") && of_parts.stderr.contains("--photo-parts"),
        "{}",
        of_parts.stderr
    );
    let ours = scene();
    let whole = loud(&["--photo-parts", "off"]);
    assert_trained(&whole);
    assert!(!whole.stderr.contains("--photo-parts") && scene() != ours, "it changes nothing");
    assert_trained(&loud(&["--photo-parts", "on"]));
    assert!(scene() == ours, "other bytes");

    let weights = place.model("alex.safetensors");
    crate::common::lpips_files::write(&weights, &crate::common::lpips_files::alexnet(0));
    let held_out = block["held_out"][0].as_str().expect("a photo").to_owned();
    division["blocks"][0]["parts"][&held_out] = part(8);
    write(&division);
    let measured = loud(&["--lpips-weights", text(&weights)]);
    assert_refused(&measured, &["the part that shows the block of photo", "--photo-parts off"]);

    division["blocks"][0]["parts"][&photo]["columns"] = serde_json::json!([7, 7]);
    write(&division);
    assert_refused(&loud(&[]), &["blocks.json", &photo, "block 1", "ashsplat partition"]);
}

#[test]
fn two_merges_at_once_are_refused() {
    use nix::fcntl::{Flock, FlockArg};
    let place = place();
    assert_trained(&partition(&place, "blocks.json", &["--max-gaussians", "100000"]));
    // The photos lie elsewhere, as on another machine.
    let moved = place.model("elsewhere");
    std::fs::rename(place.model("data"), &moved).expect("moved");
    assert_trained(&job(&place, 1, &["-s", text(&moved)]));
    std::fs::rename(&moved, place.model("data")).expect("moved");
    // Progress of a block that another process trains.
    let path = place.model("blocks/001/.training.lock");
    std::fs::write(&path, "process 7 on node3").expect("written");
    let file = std::fs::File::open(&path).expect("it is there");
    let held = Flock::lock(file, FlockArg::LockExclusiveNonblock).expect("free");
    assert_eq!(status(&place).0[0]["state"], "training");
    let told = succeed(&["blocks", text(&place.model("blocks.json"))]);
    assert!(told.contains("block 1: training, 14/14") && told.contains(", process 7 on node3\n"), "{told}");
    drop(held);
    let path = place.model(".merge.lock");
    std::fs::write(&path, "process 1").expect("written");
    let file = std::fs::File::open(&path).expect("it is there");
    let held = Flock::lock(file, FlockArg::LockExclusiveNonblock).expect("free");
    assert_refused(&merge(&place, "scene.ply"), &["another merge (process 1)", "choose another -o"]);
    assert!(!place.model("scene.ply").exists());
    drop(held);
    assert_trained(&merge(&place, "scene.ply"));
    assert!(!path.exists());
    // A single block is the whole scene, with all photos listed.
    let whole = place.model("coarse/point_cloud/iteration_12/point_cloud.ply");
    let same = place
        .train("whole", &["--init", text(&whole), "--eval", "--iterations", "14", "--few-photos", "off"]);
    assert_trained(&same);
    let options = ["--strategy", "reference", "--densify-from-iter", "5", "--densification-interval", "10"];
    let options = [&options[..], &["--densify-until-iter", "35", "--opacity-reset-interval", "22"]].concat();
    assert_trained(&job(&place, 1, &options));
    assert_trained(&merge(&place, "scene.ply"));
    let merged = std::fs::read(place.model("scene.ply")).expect("a scene");
    assert!(merged == place.ply("whole", 14), "other bits");
}
