//! `ashsplat bench suite`: recipes of training on scenes.

use crate::bench::{number, read};
use crate::cli::{program, refuse, succeed, text, write_dataset};
use crate::common::{assert_says, new_paths};
use crate::program::running::Running;

#[test]
fn bench_suite_trains_scenes_by_recipes_and_continues() {
    let (_folder, [data, out, file]) = new_paths(["data", "out", "suite.toml"]);
    write_dataset(&data);
    let suite = r#"
        iterations = 6
        tests = [3]
        options = ["--sh-degree", "1"]
        published = "an article"
        scene = [
            { name = "all", dataset = "data", until = 3.0, published = { psnr = 27.41, ssim = 0.868, lpips = 0.103 } },
            { name = "six", dataset = "data", photographs = 6, first = 1, until = 99.0, published = { psnr = 25.0, ssim = 0.8, lpips = 0.2 } },
        ]
        recipe = [{ name = "usual" }, { name = "reference", options = ["--preset", "reference"] }]
    "#;
    std::fs::write(&file, suite).expect("written");
    let run = || succeed(&["bench", "suite", text(&file), "-o", text(&out)]);
    let table = run();
    assert!(out.join("suite.md").is_file());
    assert_says(&table, &["| PSNR, dB | usual | reference |", "| all |", "| six |", "| **mean** |"]);
    let published = ["Published: an article", "| all | 27.41 | 0.8680 | 0.1030 | – |", "| **mean** | 26.2"];
    assert_says(&table, &published);
    std::fs::write(&file, suite.replace("published = \"an article\"", "")).expect("written");
    refuse(&["bench", "suite", text(&file), "-o", text(&out)], &["suite.toml", "published rows", "source"]);
    std::fs::write(&file, suite).expect("written");
    assert_says(&table, &["Recipe reference", "| all to 3 dB | 3 iterations, "]);
    assert_says(&table, &["| six to 99 dB | not reached | not reached |"]);
    let note = |scene: &str, recipe: &str| out.join(scene).join(format!("{recipe}-0.json"));
    let kept = std::fs::read(note("all", "usual")).expect("a note");
    let results = read(&out.join("all/usual-0/results.json"));
    let (psnr, last) = (number(&results["ours_6"]["PSNR"]), &read(&note("all", "usual"))["last"]);
    assert_eq!(number(&last["PSNR"]), psnr);
    assert!(table.contains(&format!("| all | {psnr:.2} |")), "{table}");
    // The same views are held out for all recipes: 9 views have two inner ones, 6 have one.
    for (scene, names) in [("all", ["03.png", "07.png"].as_slice()), ("six", &["06.png"])] {
        let folder = out.join(scene).join("reference-0");
        let cameras = read(&folder.join("cameras.json"));
        let listed =
            cameras.as_array().expect("cameras").iter().map(|c| c["img_name"].as_str().expect("a name"));
        assert_eq!(listed.take(names.len()).collect::<Vec<_>>(), names, "{scene}");
    }
    // A finished run stays, one without results is made again.
    std::fs::remove_file(note("six", "usual")).expect("removed");
    assert_eq!(run().lines().next(), table.lines().next());
    assert_eq!(std::fs::read(note("all", "usual")).expect("a note"), kept);
    assert!(note("six", "usual").is_file());
}

#[test]
fn bench_suite_keeps_what_is_over_when_stopped() {
    let (_folder, [data, out, file]) = new_paths(["data", "out", "suite.toml"]);
    write_dataset(&data);
    let suite = r#"
        iterations = 20
        seeds = [0, 1, 2]
        scene = [{ name = "all", dataset = "data" }]
        recipe = [{ name = "usual", options = ["--sh-degree", "1"] }]
    "#;
    std::fs::write(&file, suite).expect("written");
    let arguments = ["bench", "suite", text(&file), "-o", text(&out)];
    let mut child = Running::start(program().args(arguments).stderr(std::process::Stdio::null()));
    let first = out.join("all/usual-0.json");
    while !first.exists() {
        assert!(child.try_wait().expect("a child").is_none(), "it is over before the first run");
        std::thread::sleep(std::time::Duration::from_millis(20));
    }
    refuse(&arguments, &["another suite", "choose another -o"]);
    child.interrupt();
    assert_eq!(child.finish().status.code(), Some(130));
    assert!(!out.join("all/usual-2.json").exists() && !out.join("suite.md").exists());
    let kept = std::fs::read(&first).expect("a note");
    let table = succeed(&arguments);
    assert_eq!(std::fs::read(&first).expect("a note"), kept);
    // The mean of the seeds, with the smallest and the largest value.
    let last = table.lines().rfind(|line| line.starts_with("| all | ")).expect("the scene");
    assert!(last.contains(" to ") && last.contains(" ("), "{table}");
}
