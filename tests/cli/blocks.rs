//! `train --block`: trains a part of a scene and draws the rest.

use super::*;

const LEFT: &str = "--block=-inf,-inf,-inf,-0.2,inf,inf";

/// A block starts from the points of the data set or from the Gaussians of a scene, stops and resumes.
#[test]
fn a_block_is_trained_among_the_rest_of_its_scene() {
    let place = TestFolder::new();
    place.train("coarse", "--iterations 20");
    let init = format!("--init @{}", point_cloud("coarse", 20));
    for (kind, begin) in [("points", ""), ("scene", &init)] {
        let run = |model: &str, extent: &str, more: &str| {
            let block = format!("{LEFT} --margin 0.1 --scene-extent {extent} --iterations");
            place.train(model, format!("{block} {more} {begin}"));
        };
        let [whole, parts] = ["whole", "parts"].map(|name| format!("{name}_{kind}"));
        run(&whole, "1.5", "30");
        if kind == "points" {
            continue;
        }
        run(&parts, "1.5", "20 --checkpoint_iterations 20");
        run(&parts, "1.5", "30 --start_checkpoint latest");
        assert!(place.ply(&whole, 30) == place.ply(&parts, 30), "other bits");
        let ours = place.gaussians(point_cloud(&whole, 30));
        let inside = ours.means.iter().filter(|mean| mean[0] <= 0.3).count() as f64;
        assert!(ours.len() > 20 && inside > 0.95 * ours.len() as f64, "{inside} of {}", ours.len());
        // Rates and densification limits depend on the extent.
        run("larger", "3", "30");
        assert!(place.ply(&whole, 30) != place.ply("larger", 30), "the extent is not looked at");
        // A run from its settings alone.
        let written = place.read_text(format!("{parts}/settings.toml"));
        let block = "block = [-inf, -inf, -inf, -0.2, inf, inf]";
        assert_says(&written, &[block, "margin = 0.1", "scene_extent = 1.5"]);
        place.run(format!("train --config @{parts}/settings.toml -m @again --quiet")).ok();
        assert!(place.ply(&whole, 30) == place.ply("again", 30), "other bits");
        // The frozen neighbours must be unchanged.
        for (other, said) in [
            (format!("{LEFT} --margin 0.2"), "of another scene or margin"),
            ("--block=-9,-9,-9,-0.2,9,9 --margin 0.1".into(), "here the block -9,"),
            (String::new(), "the whole scene is trained"),
        ] {
            let resume = "--scene-extent 1.5 --iterations 40 --start_checkpoint latest";
            place.attempt(&parts, format!("{other} {resume} {begin}")).refused(&["chkpnt20", said]);
        }
        // Verification can train a block, too.
        place.run(format!("train --config @{parts}/settings.toml --verify-determinism 3")).ok();
    }
    // Only the trained Gaussians are written.
    let all = place.gaussians(point_cloud("coarse", 20));
    let inside = all.means.iter().filter(|mean| mean[0] <= -0.2 + 0.1).count();
    let one = format!("--strategy fixed --iterations 1 --margin 0.1 {LEFT} {init}");
    place.run(format!("train -s @data -m @one --quiet {one}")).ok();
    assert_eq!(place.gaussians(point_cloud("one", 1)).len(), inside);
    assert!(inside > 20 && inside < all.len() - 20, "{inside} of {}", all.len());
}

#[test]
fn a_block_is_trained_on_parts_of_photos() {
    let place = TestFolder::new();
    place.train("coarse", "--iterations 60 --opacity-lr 0.2");
    let begin = format!("train -s @data --init @{}", point_cloud("coarse", 60));
    let run = |model: &str, more: &str| {
        let small = "--block=-inf,-inf,-inf,-0.4,inf,inf --strategy reference";
        place.run(format!("{begin} {small} -m @{model} --iterations {more}"))
    };
    run("parts", "30 --photo-parts on").ok().warns(&["of the photos", "--photo-parts"]);
    run("whole", "30").ok();
    assert!(place.ply("parts", 30) != place.ply("whole", 30), "it changes nothing");
    run("stopped", "20 --checkpoint_iterations 20 --photo-parts on").ok();
    let resume = "30 --start_checkpoint latest";
    run("stopped", resume).refused(&["chkpnt20", "other photographs or cameras"]);
    run("stopped", &format!("{resume} --photo-parts on")).ok();
    assert!(place.ply("stopped", 30) == place.ply("parts", 30), "other bits");
    // The device holds fewer pixels.
    let photos = |model: &str| -> f64 {
        let report = place.read_text(format!("{model}/report.html"));
        let row = report.split(">photos<").nth(1).expect("photos");
        let number = row.split(|c: char| !c.is_ascii_digit() && c != '.').find_map(|n| n.parse().ok());
        number.expect("a number")
    };
    assert!(photos("parts") < photos("whole"), "{} {}", photos("parts"), photos("whole"));
}

/// The rest of the scene is omitted, and pixels that show it are masked. The training stops and resumes.
#[test]
fn a_block_is_trained_with_the_rest_of_its_scene_masked() {
    let place = TestFolder::new();
    place.train("coarse", "--iterations 60 --opacity-lr 0.2");
    let init = format!("--init @{}", point_cloud("coarse", 60));
    let run = |model: &str, more: &str| {
        place.attempt(model, format!("{init} {LEFT} --margin 0.1 --iterations {more}"))
    };
    run("drawn", "30").ok();
    run("masked", "30 --outside masked").ok();
    assert!(place.ply("masked", 30) != place.ply("drawn", 30), "it changes nothing");
    run("parts", "20 --checkpoint_iterations 20 --outside masked").ok();
    run("parts", "30 --start_checkpoint latest").refused(&["chkpnt20"]);
    run("parts", "30 --start_checkpoint latest --outside masked").ok();
    assert!(place.ply("masked", 30) == place.ply("parts", 30), "other bits");
    assert_says(place.read_text("masked/settings.toml"), &["outside = \"masked\""]);
    // There are no frozen neighbours, on the device either.
    let surrounded = |model: &str| place.read_text(format!("{model}/report.html")).contains(">surroundings<");
    assert!(surrounded("drawn") && !surrounded("masked"));
    // A block far away from all views.
    let nothing = "--block=-inf,-inf,-inf,inf,inf,-30 --margin 0 --outside masked";
    place.attempt("nothing", format!("{init} {nothing}")).refused(&["block"]);
    assert!(!place.has("nothing"));
}

#[test]
fn senseless_blocks_are_refused_before_the_work() {
    let place = TestFolder::new();
    for (options, words) in [
        ("--block=1,2,3", &["block", "six numbers"][..]),
        ("--block=1,0,0,-1,1,1", &["block", "least side"]),
        ("--block=nan,0,0,1,1,1", &["block", "least side"]),
        ("--block=0,0,0,1,0,1", &["block", "least side"]),
        ("--block=50,50,50,60,60,60", &["block", "none of the 400"]),
        ("LEFT --margin=-1", &["margin", "0 or more"]),
        ("LEFT --margin=nan", &["margin", "0 or more"]),
        ("--margin=1", &["margin", "--block"]),
        ("--outside=masked", &["outside", "--block"]),
        ("--photo-parts=on", &["photo_parts", "--block"]),
        ("LEFT --photo-parts=on", &["photo_parts", "--init"]),
        ("LEFT --outside=masked", &["outside", "--init"]),
        ("--scene-extent=-1", &["scene_extent"]),
        ("--scene-extent=inf", &["scene_extent"]),
        ("LEFT --strategy mcmc", &["block", "mcmc"]),
        ("LEFT --pose-opt", &["pose_opt", "block"]),
    ] {
        let options = options.replace("LEFT", LEFT);
        place.run(format!("train -s @data -m @out --quiet {options}")).refused(words);
        assert!(!place.has("out"), "{options:?}: {:?}", place.files("out"));
    }
}
