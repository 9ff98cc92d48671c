//! `partition`, `train --job` and `merge`: a scene that is trained in blocks.

use super::*;
use ashsplat::scene::Bounds;

impl TestFolder {
    pub(super) fn with_coarse_model() -> TestFolder {
        let place = TestFolder::new();
        place.train("coarse", "--iterations 12 --eval");
        place
    }

    pub(super) fn partition(&self, file: &str, more: &str) -> Finished {
        // The Gaussians are faint after so few steps.
        let share = if more.contains("--min-share") { "" } else { "--min-share 0.03" };
        self.run(format!("partition --coarse @coarse -o @{file} --iterations 14 {share} {more}"))
    }

    /// Trains a block for a few steps, with the low SH degree of the coarse model.
    pub(super) fn job(&self, number: u64, more: &str) -> Finished {
        self.run(format!("train --job @blocks.json:{number} --quiet --sh-degree 1 {more}"))
    }

    pub(super) fn merge(&self, out: &str) -> Finished {
        self.run(format!("merge @blocks.json -o @{out}"))
    }

    /// Status of each block, and the number of trained blocks.
    pub(super) fn status(&self) -> (Vec<Value>, Value) {
        let output = self.json_of("blocks @blocks.json --json");
        (list(&output, "blocks").clone(), output["trained"].clone())
    }

    pub(super) fn division(&self) -> Value {
        self.read_json("blocks.json")
    }
}

pub(super) fn list<'a>(of: &'a Value, name: &str) -> &'a Vec<Value> {
    of[name].as_array().unwrap_or_else(|| panic!("no list {name}"))
}

pub(super) fn number(of: &Value, name: &str) -> u64 {
    of[name].as_u64().unwrap_or_else(|| panic!("no number {name} in {of}"))
}

fn real(of: &Value, name: &str) -> f64 {
    of[name].as_f64().unwrap_or_else(|| panic!("no number {name} in {of}"))
}

pub(super) fn file_of(block: &Value, name: &str) -> String {
    format!("{}/{name}", block["folder"].as_str().expect("a folder"))
}

pub(super) fn scene_of(block: &Value) -> String {
    point_cloud(block["folder"].as_str().expect("a folder"), number(block, "iterations") as u32)
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

pub(super) fn in_core(block: &Value, mean: [f32; 3]) -> bool {
    core(block).contains(Vec3::from_array(mean))
}

/// Holds a lock file, as another process would.
pub(super) fn hold(place: &TestFolder, name: &str, holder: &str) -> std::fs::File {
    place.write(name.replace(".lock", ".holder"), holder);
    let file = std::fs::File::create(place.at(name)).expect("created");
    file.try_lock().expect("free");
    file
}

#[test]
fn blocks_are_trained_one_by_one_and_merged() {
    let place = TestFolder::with_coarse_model();
    let mut files = place.files("");
    place.partition("blocks.json", "--max-gaussians 300").ok();
    // Photos are referenced, not copied.
    files.push(PathBuf::from("blocks.json"));
    files.sort();
    assert_eq!(place.files(""), files);
    // A repeated partition gives the same bytes.
    let first = place.read("blocks.json");
    place.partition("blocks.json", "@data --max-gaussians 300").ok();
    assert!(first == place.read("blocks.json"), "other bytes");

    let division = place.division();
    let blocks = list(&division, "blocks");
    // Rates are those of a training of the whole scene, with the first and the ninth view held out.
    let extent = ashsplat::scene::scene_extent((1..VIEWS - 1).map(|index| view(index).position()));
    let written = real(&division, "scene_extent");
    assert!((written - f64::from(extent)).abs() < 1e-5, "{written} {extent}");
    let coarse = place.gaussians(point_cloud("coarse", 12));
    assert!(blocks.len() > 2, "{division}");
    let output = place.run("blocks @blocks.json").ok().stdout;
    assert_says(&output, &[&format!("block 2: waiting, 0/{}\n", blocks[1]["iterations"])]);
    assert!(output.ends_with(&format!("\n0 of {} blocks trained\n", blocks.len())), "{output}");
    for block in blocks {
        let inside = coarse.means.iter().filter(|&&mean| in_core(block, mean)).count();
        assert_eq!(block["gaussians"], inside, "{block}");
        assert!((1..=300).contains(&inside) && number(block, "trained") > inside as u64, "{block}");
        let photos = list(block, "photos");
        // The first and the ninth photo are held out; 14 iterations use each photo twice.
        assert!(photos.iter().all(|name| name != "01.png" && name != "09.png"), "{block}");
        assert_eq!(block["iterations"], 2 * photos.len(), "{block}");
        place.job(number(block, "number"), "").ok();
    }
    let (all, trained) = place.status();
    assert_eq!(trained, blocks.len());
    for (status, block) in all.iter().zip(blocks) {
        assert_eq!((&status["state"], &status["iteration"]), (&"trained".into(), &block["iterations"]));
        assert_eq!(status["iterations"], block["iterations"]);
        let measured = ["gaussians", "psnr", "peak_bytes"];
        assert!(measured.iter().all(|name| status[name].as_f64() > Some(1.0)), "{status}");
        // A busy machine may need more than a second for an iteration.
        assert!(status["iterations_per_second"].as_f64() > Some(0.0), "{status}");
        assert!(status["trainer"].is_null());
        let pixels = number(block, "pixels");
        assert_eq!(pixels, pixels_of(block));
        let memory = 1_500_000_000 + 4 * pixels + 10 * 728 * number(block, "trained");
        assert_eq!(status["memory_bytes"], memory);
    }
    place.run("blocks @blocks.json --json --growth 0.5").refused(&["--growth", "1 or more"]);
    let output = place.run("blocks @blocks.json").ok().stdout;
    for line in output.lines().take(blocks.len()) {
        assert_says(line, &["trained", " dB, ", " it/s, ", " Gaussians"]);
    }
    // `--watch` ends when all blocks are trained.
    place.run("blocks @blocks.json --watch 1").ok();
    assert_eq!(blocks.iter().map(|block| number(block, "gaussians")).sum::<u64>(), coarse.len() as u64);

    let merged = place.merge("new/scene.ply").ok();
    let mut union = Gaussians { sh_degree: 1, ..Default::default() };
    for block in blocks {
        let mut own = place.gaussians(scene_of(block));
        let all = own.len();
        own.retain(|own, index| in_core(block, own.means[index]));
        let left = own.len();
        assert!(left < all && left > 20, "the margin is trained, and left out: {left} {all}");
        assert_says(&merged.stdout, &[&format!("block {}: {left} Gaussians", block["number"])]);
        union.append(&own);
    }
    let scene = place.gaussians("new/scene.ply");
    assert!(scene == union, "{} {}", scene.len(), union.len());
    for &mean in &scene.means {
        assert_eq!(blocks.iter().filter(|block| in_core(block, mean)).count(), 1, "{mean:?}");
    }
    check_quality(&place);
    // Another format gives the file that convert writes.
    place.merge("scene.spz").ok();
    place.run("convert @new/scene.ply @converted.spz").ok();
    assert!(place.read("scene.spz") == place.read("converted.spz"), "other bytes");

    // Input files are never overwritten.
    let report = |out: &str, page: &str| place.run(format!("merge @blocks.json -o @{out} --report @{page}"));
    for (out, page) in [(scene_of(&blocks[0]).as_str(), "page.html"), ("aside.ply", "blocks.json")] {
        report(out, page).refused(&["is read; give another file"]);
    }
    report("one.ply", "./one.ply").refused(&["--out and --report: both name", "a file of its own"]);
    assert!(place.read("blocks.json") == first);
    // Photos whose poses changed since the blocks were trained cannot measure the scene.
    let images = place.read("data/sparse/0/images.bin");
    let mut moved = images.clone();
    // The first image's tx: it follows the count, the image's id, and its rotation.
    moved[8 + 4 + 32..][..8].copy_from_slice(&0.25_f64.to_le_bytes());
    place.write("data/sparse/0/images.bin", moved);
    report("aside.ply", "page.html").refused(&["data", "its cameras are not those", "blocks.json"]);
    place.write("data/sparse/0/images.bin", images);

    // A held-out photo is missing.
    place.rename("data/images/09.png", "kept.png");
    report("aside.ply", "page.html").refused(&["09.png"]);
    assert!(!place.has("aside.ply") && !place.has("page.html"));
    place.rename("kept.png", "data/images/09.png");

    // A block is done when its note exists and its scene is intact.
    let good = place.read(scene_of(&blocks[1]));
    let again = || place.job(2, "--start-checkpoint auto --checkpoint-every 5");
    again().says(&["is trained to its end already"]);
    assert!(!place.has("blocks/002/earlier_1"));
    // `eval` uses the block's photos, one of which is held out.
    let known = blocks[1]["held_out"].as_array().map_or(0, Vec::len);
    place.run("eval @blocks/002 --quiet").says(&[&format!("mean of {known}")]);

    // One scene is damaged, and one is missing.
    let mut bad = good.clone();
    let last = bad.len() - 3;
    bad[last] ^= 1;
    place.write(scene_of(&blocks[1]), &bad);
    place.rename("blocks/001/block.json", "kept");
    let before = place.files("");
    let words = ["blocks.json", "1 not trained to the end", "2 damaged", "--job"];
    place.merge("other/scene.ply").refused(&words);
    assert_eq!(place.files(""), before);
    // The same command repairs it.
    again().ok();
    assert!(place.read(scene_of(&blocks[1])) == good, "other bytes");
    place.rename("kept", "blocks/001/block.json");
    place.merge("new/scene.ply").ok();
    // A new division must not replace one whose blocks have been trained. If the file is removed, results belong to
    // another division.
    let divide = || place.partition("blocks.json", "--max-gaussians 300 --margin 0.4");
    divide().refused(&["blocks.json", "blocks have been trained", "(now 0.4)", "another -o"]);
    place.remove("blocks.json");
    divide().ok();
    place.merge("other/scene.ply").refused(&["1, 2", "trained for another division"]);
    again().refused(&["of another scene or margin"]);
    assert_eq!(place.status().0[1]["state"], "of another division");
    // A training of the old division cannot resume as one of the new division.
    let begun = place.run("train --config @blocks/002/settings.toml --start-checkpoint latest");
    begun.refused(&["blocks.json", "another division than the one that block 2", "--job"]);
}

/// `merge --report` measures the scene and the coarse model as `eval` does.
fn check_quality(place: &TestFolder) {
    let measured = "merge @blocks.json -o @again.ply --report @quality/page.html --against @coarse";
    let said = place.run(measured).ok().stdout;
    assert!(place.read("again.ply") == place.read("new/scene.ply"), "other bytes");
    let results = place.read_json("quality/page.html.json");
    for (name, model) in [("merged", "again.ply"), ("against", "coarse")] {
        let table =
            place.json_of(format!("eval @{model} -s @data --eval --eval-split reference --quiet --json"));
        let part = |part: &str| real(&results[name], part);
        assert!((part("mean_psnr") - real(&table["mean"], "PSNR")).abs() < 0.01, "{results} {table}");
        // Every pixel lies either inside or along a seam.
        let [inside, seam] = ["inside_psnr", "seam_psnr"].map(part);
        let (min, max) = (inside.min(seam), inside.max(seam));
        assert!((min..=max).contains(&part("psnr")) && min < max, "{results}");
        let line = format!("{name}: PSNR {:.2} dB on 2 held-out views", part("mean_psnr"));
        assert_says(&said, &[&line]);
    }
    let seams = list(&results, "seams");
    let psnr: Vec<f64> = seams.iter().filter_map(|seam| seam["psnr"].as_f64()).collect();
    assert!(psnr.len() == seams.len() && psnr.is_sorted() && !psnr.is_empty(), "{results}");
    assert_eq!(place.read_text("quality/page.html").matches("<img").count(), 3);
}

#[test]
fn jobs_use_the_parts_of_photos_that_show_them() {
    let place = TestFolder::with_coarse_model();
    let parts = "--max-gaussians 300 --margin 0.02 --photo-parts on";
    place.partition("blocks.json", parts).ok();
    let mut division = place.division();
    for block in list(&division, "blocks") {
        let own = [list(block, "photos").as_slice(), list(block, "held_out")].concat();
        let parts = block["parts"].as_object().expect("parts");
        let known = |name: &String| own.iter().any(|own| own == name);
        assert!(!parts.is_empty() && parts.keys().all(known), "{block}");
    }
    let block = division["blocks"][0].clone();
    // Tiles and windows fill these small photos: use a smaller part of one.
    let part = serde_json::json!({ "of": [8, 8], "columns": [0, 1], "rows": [0, 8] });
    let [photo, held_out] = ["photos", "held_out"].map(|list| block[list][0].as_str().expect("a photo"));
    division["blocks"][0]["parts"][photo] = part.clone();
    place.write("blocks.json", division.to_string());
    let loud =
        |more: &str| place.run(format!("train --job @blocks.json:{} --sh-degree 1 {more}", block["number"]));
    loud("").ok().warns(&["of the photos ", "--photo-parts"]);
    let ours = place.read(scene_of(&block));
    let whole = loud("--photo-parts off").ok();
    assert!(!whole.stderr.contains("--photo-parts"), "{}", whole.stderr);
    assert!(place.read(scene_of(&block)) != ours, "it changes nothing");
    loud("--photo-parts on").ok();
    assert!(place.read(scene_of(&block)) == ours, "other bytes");

    let weights = place.at("alex.safetensors");
    crate::common::lpips_files::write(&weights, &crate::common::lpips_files::alexnet(0));
    division["blocks"][0]["parts"][held_out] = part;
    place.write("blocks.json", division.to_string());
    let words = ["the part that shows the block of photo", "--photo-parts off"];
    loud("--lpips-weights @alex.safetensors").refused(&words);

    division["blocks"][0]["parts"][photo]["columns"] = serde_json::json!([7, 7]);
    place.write("blocks.json", division.to_string());
    loud("").refused(&["blocks.json", photo, "block 1", "ashsplat partition"]);
}

#[test]
fn two_merges_at_once_are_refused() {
    let place = TestFolder::with_coarse_model();
    place.partition("blocks.json", "--max-gaussians 100000").ok();
    // The photos lie elsewhere, as on another machine.
    place.rename("data", "elsewhere");
    place.job(1, "-s @elsewhere").ok();
    place.rename("elsewhere", "data");
    // Progress of a block that another process trains.
    let held = hold(&place, "blocks/001/.training.lock", "process 7 on node3");
    assert_eq!(place.status().0[0]["state"], "training");
    let words = ["block 1: training, 14/14", ", process 7 on node3\n"];
    place.run("blocks @blocks.json").ok().says(&words);
    drop(held);
    let held = hold(&place, ".merge.lock", "process 1");
    place.merge("scene.ply").refused(&["another merge (process 1)", "choose another -o"]);
    assert!(!place.has("scene.ply"));
    drop(held);
    place.merge("scene.ply").ok();
    assert!(!place.has(".merge.lock"));
    // A single block is the whole scene, with all photos listed.
    let init = format!("--init @{}", point_cloud("coarse", 12));
    place.train("whole", format!("{init} --eval --eval-split reference --iterations 14 --few-photos off"));
    let options = "--strategy reference --densify-from-iter 5 --densification-interval 10 \
                   --densify-until-iter 35 --opacity-reset-interval 22";
    place.job(1, options).ok();
    place.merge("scene.ply").ok();
    assert!(place.read("scene.ply") == place.ply("whole", 14), "other bits");
}

#[test]
fn what_cannot_be_divided_or_trained_is_refused() {
    let place = TestFolder::with_coarse_model();
    place.partition("plan", "--max-gaussians 300").refused(&["--out", ".json"]);
    let refused = |more: &str, words: &[&str]| {
        place.partition("blocks.json", more).refused(words);
        assert!(!place.has("blocks.json"));
    };
    let words = ["block ", "has no photo", "--min-share"];
    refused("--max-gaussians 9 --min-share 1", &words);
    refused("--max-gaussians 300 --min-share nan", &["--min-share"]);
    refused("--max-gaussians 300 --margin=-1", &["--margin"]);
    refused("--max-gaussians 0", &["--max-gaussians"]);
    place.rename("data/images/05.png", "kept.png");
    refused("--max-gaussians 300", &["05.png", "the photo of image 5 is missing"]);
    place.rename("kept.png", "data/images/05.png");
    // Another data set, with other positions, and with photos that see nothing.
    write_dataset(&place.at("other"));
    let images = |turned: f32| -> Vec<ColmapImage> {
        let image = |index: u32| {
            let eye = vec3(0.1 * (index + 1) as f32, 5.0, -2.5);
            let lens = view(0).intrinsics();
            let camera = Camera::look_at(eye, eye + turned * Vec3::Z, Vec3::NEG_Y, lens);
            ColmapImage::posed(index + 1, 1, photo_name(index), &camera)
        };
        (0..9).map(image).collect()
    };
    write_model(&place.at("other"), &images(1.0), &wall_points());
    let words = ["cameras.json", "of its 9 cameras 0 are in", "another scene"];
    refused("@other --max-gaussians 300", &words);
    write_model(&place.at("other"), &images(-1.0), &wall_points());
    let ply = point_cloud("coarse", 12);
    let bare = |data: &str, scene: &str| {
        place.run(format!("partition @{data} --coarse @{scene} --max-gaussians 300 -o @blocks.json"))
    };
    bare("other", &ply).refused(&["point_cloud.ply", "next to nothing"]);
    // Same size, other colours.
    let mut negative = place.gaussians(&ply);
    negative.sh.iter_mut().flatten().for_each(|coefficient| *coefficient *= -1.0);
    place.write_scene("negative.ply", &negative);
    let words = ["negative.ply", "does not look like the photos", "another scene"];
    bare("data", "negative.ply").refused(&words);

    place.partition("blocks.json", "--max-gaussians 300").ok();
    let (written, before) = (place.read_text("blocks.json"), place.files(""));
    let changed = |from: &str, to: &str, words: &[&str]| {
        assert!(written.contains(from), "{from}");
        place.write("blocks.json", written.replacen(from, to, 1));
        place.job(1, "").refused(words);
        place.merge("scene.ply").refused(words);
        place.run("exchange @blocks.json").refused(words);
        place.run("blocks @blocks.json").refused(words);
        place.write("blocks.json", &written);
    };
    let mut none = place.division();
    none["blocks"][1]["photos"] = serde_json::json!([]);
    place.write("blocks.json", none.to_string());
    for refused in [place.job(2, ""), place.merge("scene.ply")] {
        refused.refused(&["blocks.json", "block 2 has no photos to train on"]);
    }
    changed("\"version\": 1", "\"version\": 2", &["blocks.json", "is of version 2", "partition"]);
    changed("\"version\": 1", "\"versions\": 1", &["blocks.json", "no version"]);
    changed("{", "", &["blocks.json", "no list of blocks"]);
    changed("\"number\": 2", "\"number\": 7", &["blocks.json", "numbered"]);
    changed("null", "-0.3", &["blocks.json", "do not divide"]);
    changed("\"margin\"", "\"margins\"", &["blocks.json", "margins"]);
    place.run("train --job @blocks.json:9999").refused(&["job", "has the blocks 1 to"]);
    place.run("train --job @blocks.json").refused(&["job", "blocks.json:3"]);
    place.run("train --job @blocks.json:9999 --margin 1").refused(&["--job", "cannot be used with"]);
    // A file that the blocks refer to has changed.
    place.rename("data/images/05.png", "kept.png");
    place.job(1, "").refused(&["05.png", "the photo of image 5 is missing"]);
    place.rename("kept.png", "data/images/05.png");
    let kept = place.read(&ply);
    let mut other = kept.clone();
    other[kept.len() - 3] ^= 1;
    place.write(&ply, other);
    place.job(1, "").refused(&["point_cloud.ply", "is not the coarse model that"]);
    place.write(&ply, kept);
    assert_eq!(place.files(""), before);
    write_model(&place.at("data"), &images(1.0), &wall_points());
    place.job(1, "").refused(&["data: its cameras are not those that", "blocks.json"]);
    assert!(!place.has("blocks"));
}

#[test]
fn photos_of_a_single_object_are_used_whole() {
    let place = TestFolder::with_coarse_model();
    let divided = |more: &str| {
        let out = place.partition("blocks.json", &format!("--max-gaussians 500 {more}")).ok();
        (place.division(), out.stdout)
    };
    let parts = |of: &Value| -> Vec<Value> {
        list(of, "blocks").iter().map(|block| block["parts"].clone()).collect()
    };
    let used = |of: &Value| -> usize {
        let both = |block| list(block, "photos").len() + list(block, "held_out").len();
        list(of, "blocks").iter().map(both).sum()
    };
    let (whole, said) = divided("");
    let margin = whole["margin"].as_f64().expect("a margin");
    assert!(used(&whole) == 18 && said.contains("a single object: photos show 100 %"), "{said}");
    assert!(said.contains("whole photos") && parts(&whole) == [Value::Null, Value::Null], "{whole}");
    let (rounds, said) = divided("--rounds 2");
    assert!(said.contains("whole photos") && rounds["blocks"] == whole["blocks"], "{said}");
    assert_eq!(rounds["margin"], whole["margin"]);
    // Parts of photos include the wide margin, too.
    let (of_parts, said) = divided("--rounds 2 --photo-parts on");
    assert!(said.contains("parts of photos") && of_parts["margin"] == whole["margin"], "{said}");
    let (given, _) = divided(&format!("--rounds 2 --photo-parts on --margin {}", margin as f32));
    assert!(parts(&given) != [Value::Null, Value::Null] && given == of_parts, "{given}");
    let (narrow, _) = divided("--rounds 2 --photo-parts on --margin 0.001");
    assert!(parts(&narrow) != parts(&given), "{narrow}");
    assert_eq!(narrow["margin"].as_f64().map(|margin| margin as f32), Some(0.001));

    // Each photo is used for the block that it shows most of, and some photos for more.
    let (several_places, said) = divided("--rounds 2 --min-share 0.33");
    assert!(used(&several_places) < 15 && !said.contains("single object"), "{said}");
    assert!(parts(&several_places) != [Value::Null, Value::Null], "{several_places}");
    let thin = several_places["margin"].as_f64().expect("a margin");
    assert!((thin - margin / 3.0).abs() < 1e-6 * margin, "{thin} {margin}");
    let (off, _) = divided("--rounds 2 --min-share 0.33 --photo-parts off");
    assert_eq!(parts(&off), [Value::Null, Value::Null]);
}
