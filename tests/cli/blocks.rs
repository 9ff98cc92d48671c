//! `train --block`: trains a part of a scene and draws the rest.

use super::checkpoints::{Place, assert_trained};
use super::*;
use ashsplat::Gaussians;
use ashsplat_files::splats::{self, ReadOptions};

const LEFT: &str = "--block=-inf,-inf,-inf,-0.2,inf,inf";
const EVERYTHING: &str = "--block=-inf,-inf,-inf,inf,inf,inf";

fn trained(place: &Place, model: &str, iteration: u32) -> Gaussians {
    let path = place.model(model).join(format!("point_cloud/iteration_{iteration}/point_cloud.ply"));
    splats::read(path, &ReadOptions::default()).expect("a PLY").gaussians
}

#[test]
fn a_block_that_is_everything_is_plain_training_to_the_byte() {
    let place = Place::new();
    let options = ["--iterations", "30", "--checkpoint_iterations", "20"];
    assert_trained(&place.train("plain", &options));
    assert_trained(&place.train("block", &[options.as_slice(), &[EVERYTHING]].concat()));
    assert!(place.ply("block", 30) == place.ply("plain", 30), "other bits");
    let checkpoint = |model: &str| std::fs::read(place.model(model).join("chkpnt20.safetensors")).ok();
    assert!(checkpoint("block") == checkpoint("plain") && checkpoint("plain").is_some());
}

/// A block starts from the points of the data set or from the Gaussians of a scene, stops and resumes.
#[test]
fn a_block_is_trained_among_the_rest_of_its_scene() {
    let place = Place::new();
    assert_trained(&place.train("coarse", &["--iterations", "20"]));
    let scene = place.model("coarse").join("point_cloud/iteration_20/point_cloud.ply");
    let init = ["--init", text(&scene)];
    for begin in [&[][..], &init[..]] {
        let block = [LEFT, "--margin", "0.1", "--scene-extent", "1.5", "--iterations"];
        let run = |model: &str, more: &[&str]| place.train(model, &[&block, more, begin].concat());
        let names = [format!("whole{}", begin.len()), format!("parts{}", begin.len())];
        assert_trained(&run(&names[0], &["30"]));
        // Rates and densification limits depend on the extent.
        let larger = [LEFT, "--margin", "0.1", "--scene-extent", "3", "--iterations", "30"];
        assert_trained(&place.train("larger", &[&larger, begin].concat()));
        assert!(place.ply(&names[0], 30) != place.ply("larger", 30), "the extent is not looked at");
        std::fs::remove_dir_all(place.model("larger")).expect("removed");
        let counts = |gaussians: &Gaussians| {
            gaussians.means.iter().filter(|mean| mean[0] <= 0.3).count() as f64 / gaussians.len() as f64
        };
        let ours = trained(&place, &names[0], 30);
        assert!(ours.len() > 20 && counts(&ours) > 0.95, "{} {}", ours.len(), counts(&ours));
        assert_trained(&run(&names[1], &["20", "--checkpoint_iterations", "20"]));
        assert_trained(&run(&names[1], &["30", "--start_checkpoint", "latest"]));
        assert!(place.ply(&names[0], 30) == place.ply(&names[1], 30), "other bits");
        // A run from its settings alone.
        let settings = place.model(&names[1]).join("settings.toml");
        let written = std::fs::read_to_string(&settings).expect("settings");
        assert!(written.contains("block = [-inf, -inf, -inf, -0.2, inf, inf]"), "{written}");
        assert!(written.contains("margin = 0.1") && written.contains("scene_extent = 1.5"), "{written}");
        let again = place.model("again");
        let again = ["train", "--config", text(&settings), "-m", text(&again), "--quiet"];
        assert_trained(&finish(program().args(again)));
        assert!(place.ply(&names[0], 30) == place.ply("again", 30), "other bits");
        std::fs::remove_dir_all(place.model("again")).expect("removed");
        // The frozen neighbours must be unchanged.
        for (other, said) in [
            (&[LEFT, "--margin", "0.2"][..], "of another scene or margin"),
            (&["--block=-9,-9,-9,-0.2,9,9", "--margin", "0.1"], "here it is -9,"),
            (&[], "the whole scene is trained"),
        ] {
            let goes_on = ["--scene-extent", "1.5", "--iterations", "40", "--start_checkpoint", "latest"];
            let refused = place.train(&names[1], &[other, &goes_on, begin].concat());
            assert_refused(&refused, &["chkpnt20", said]);
        }
        // Verification can train a block, too.
        let verified = program()
            .args(["train", "--config", text(&settings), "--verify-determinism", "3"])
            .output()
            .expect("a run");
        assert!(verified.status.success(), "{}", String::from_utf8_lossy(&verified.stderr));
    }
    // Only the trained Gaussians are written.
    let all = trained(&place, "coarse", 20);
    let inside = all.means.iter().filter(|mean| mean[0] <= -0.2 + 0.1).count();
    let (still, one) = (["--strategy", "fixed"], ["--iterations", "1", "--margin", "0.1", LEFT]);
    let (data, out) = (place.model("data"), place.model("one"));
    let one = [&["train", "-s", text(&data), "-m", text(&out), "--quiet"][..], &still, &one, &init].concat();
    assert_trained(&finish(program().args(one)));
    assert_eq!(trained(&place, "one", 1).len(), inside);
    assert!(inside > 20 && inside < all.len() - 20, "{inside} of {}", all.len());
}

/// A block uses only the parts of photos that show it. It stops and resumes.
#[test]
fn a_block_is_trained_on_parts_of_photos() {
    let place = Place::new();
    assert_trained(&place.train("coarse", &["--iterations", "60", "--opacity-lr", "0.2"]));
    let scene = place.model("coarse").join("point_cloud/iteration_60/point_cloud.ply");
    let small = "--block=-inf,-inf,-inf,-0.4,inf,inf";
    let begin = ["train", "-s", text(&place.model("data")), "--init", text(&scene), small].map(String::from);
    let run = |model: &str, more: &[&str]| {
        let out = place.model(model);
        finish(
            program().args(&begin).args(["-m", text(&out), "--few-photos", "off", "--iterations"]).args(more),
        )
    };
    let parts = ["--photo-parts", "on"];
    let of_parts = run("parts", &[&["30"][..], &parts].concat());
    assert_trained(&of_parts);
    let said = &of_parts.stderr;
    assert!(said.contains("of the photos") && said.contains("--photo-parts"), "{said}");
    assert_trained(&run("whole", &["30"]));
    assert!(place.ply("parts", 30) != place.ply("whole", 30), "it changes nothing");
    assert_trained(&run("stopped", &[&["20", "--checkpoint_iterations", "20"][..], &parts].concat()));
    let goes_on = ["30", "--start_checkpoint", "latest"];
    let refused = run("stopped", &goes_on);
    assert_refused(&refused, &["chkpnt20", "other photographs or cameras"]);
    assert_trained(&run("stopped", &[&goes_on[..], &parts].concat()));
    assert!(place.ply("stopped", 30) == place.ply("parts", 30), "other bits");
    // The device holds fewer pixels.
    let photos = |model: &str| -> f64 {
        let report = std::fs::read_to_string(place.model(model).join("report.html")).expect("a report");
        let row = report.split(">photos<").nth(1).expect("photos");
        let number = row.split(|c: char| !c.is_ascii_digit() && c != '.').find(|n| n.parse::<f64>().is_ok());
        number.and_then(|number| number.parse().ok()).expect("a number")
    };
    assert!(photos("parts") < photos("whole"), "{} {}", photos("parts"), photos("whole"));
}

/// The rest of the scene is omitted, and pixels that show it are masked. The training stops and resumes.
#[test]
fn a_block_is_trained_with_the_rest_of_its_scene_masked() {
    let place = Place::new();
    assert_trained(&place.train("coarse", &["--iterations", "60", "--opacity-lr", "0.2"]));
    let scene = place.model("coarse").join("point_cloud/iteration_60/point_cloud.ply");
    let block = ["--init", text(&scene), LEFT, "--margin", "0.1", "--iterations"];
    let run = |model: &str, more: &[&str]| place.train(model, &[&block, more].concat());
    let masked = ["--outside", "masked"];
    assert_trained(&run("drawn", &["30"]));
    assert_trained(&run("masked", &[&["30"][..], &masked].concat()));
    assert!(place.ply("masked", 30) != place.ply("drawn", 30), "it changes nothing");
    assert_trained(&run("parts", &[&["20", "--checkpoint_iterations", "20"][..], &masked].concat()));
    let goes_on = run("parts", &["30", "--start_checkpoint", "latest"]);
    assert_refused(&goes_on, &["chkpnt20"]);
    assert_trained(&run("parts", &[&["30", "--start_checkpoint", "latest"][..], &masked].concat()));
    assert!(place.ply("masked", 30) == place.ply("parts", 30), "other bits");
    let written = std::fs::read_to_string(place.model("masked").join("settings.toml")).expect("settings");
    assert!(written.contains("outside = \"masked\""), "{written}");
    // There are no frozen neighbours, on the device either.
    let report =
        |model: &str| std::fs::read_to_string(place.model(model).join("report.html")).expect("a report");
    assert!(report("drawn").contains(">surroundings<") && !report("masked").contains(">surroundings<"));
    // A block far away from all views.
    let nothing = "--block=-inf,-inf,-inf,inf,inf,-30";
    let refused =
        place.train("nothing", &["--init", text(&scene), nothing, "--margin", "0", "--outside", "masked"]);
    assert_refused(&refused, &["block"]);
    assert!(!place.model("nothing").exists());
}

#[test]
fn senseless_blocks_are_refused_before_the_work() {
    let place = Place::new();
    for (options, words) in [
        (&["--block=1,2,3"][..], &["block", "six numbers"][..]),
        (&["--block=1,0,0,-1,1,1"], &["block", "least side"]),
        (&["--block=nan,0,0,1,1,1"], &["block", "least side"]),
        (&["--block=0,0,0,1,0,1"], &["block", "least side"]),
        (&["--block=50,50,50,60,60,60"], &["block", "none of the 400"]),
        (&[LEFT, "--margin=-1"], &["margin", "0 or more"]),
        (&[LEFT, "--margin=nan"], &["margin", "0 or more"]),
        (&["--margin=1"], &["margin", "--block"]),
        (&["--outside=masked"], &["outside", "--block"]),
        (&["--photo-parts=on"], &["photo_parts", "--block"]),
        (&[LEFT, "--photo-parts=on"], &["photo_parts", "--init"]),
        (&[LEFT, "--outside=masked"], &["outside", "--init"]),
        (&["--scene-extent=-1"], &["scene_extent"]),
        (&["--scene-extent=inf"], &["scene_extent"]),
        (&[LEFT, "--strategy", "mcmc"], &["block", "mcmc"]),
        (&[LEFT, "--pose-opt"], &["pose_opt", "block"]),
    ] {
        let (data, out) = (place.model("data"), place.model("out"));
        let command = [&["train", "-s", text(&data), "-m", text(&out), "--quiet"][..], options].concat();
        refuse(&command, words);
        assert!(!out.exists(), "{options:?}: {:?}", files_below(&out));
    }
}
