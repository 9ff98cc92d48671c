//! Strategies and presets in the program: initial values, resumed and verified runs, refusals of contradictory
//! settings.

use super::checkpoints::Place;
use super::*;
use ashsplat::Gaussians;
use ashsplat_files::splats::{self, ReadOptions};

/// Options as users choose them.
const WAYS: [&[&str]; 4] = [
    &["--strategy", "budget", "--few-photos", "off"],
    &["--strategy", "mcmc", "--few-photos", "off"],
    &["--preset", "fast", "--few-photos", "off"],
    // Chosen automatically with so few photos.
    &["--exposure"],
];

const SHORT: [&str; 12] = [
    "--quiet",
    "--eval-share",
    "0",
    "--sh-degree",
    "1",
    "--sh-degree-interval",
    "6",
    "--scale-sh-degree=false",
    "--densify-from-iter",
    "5",
    "--densification-interval",
    "6",
];

#[test]
fn every_way_to_train_goes_on_and_is_verified() {
    let place = Place::new();
    let data = place.model("data");
    let mut ends = Vec::new();
    for (number, way) in WAYS.iter().enumerate() {
        let name = number.to_string();
        let model = place.model(&name);
        let train = ["train", "-s", text(&data), "-m", text(&model), "--iterations", "40"];
        let train = [&train[..], &SHORT, way].concat();
        succeed(&[&train[..], &["--checkpoint-iterations", "13", "27"]].concat());
        let whole = place.ply(&name, 40);
        for iteration in [13, 27] {
            std::fs::remove_dir_all(model.join("point_cloud")).expect("removed");
            let checkpoint = model.join(format!("chkpnt{iteration}.safetensors"));
            succeed(&[&train[..], &["--start-checkpoint", text(&checkpoint)]].concat());
            assert!(place.ply(&name, 40) == whole, "{way:?}: other bits from {iteration} on");
        }
        let said = succeed(&[&train[..], &["--verify-determinism", "20"]].concat());
        assert!(said.starts_with("20 iterations twice on ") && said.contains("the same bits"), "{said}");
        ends.push(whole);
    }
    ends.sort();
    ends.dedup();
    assert_eq!(ends.len(), WAYS.len(), "two ways do the same");
}

/// 3DGS-MCMC starts with more opaque, smaller Gaussians. A given scene keeps its values.
#[test]
fn a_strategy_begins_with_its_own_values() {
    let place = Place::new();
    let data = place.model("data");
    let begun = |name: &str, more: &[&str]| -> (PathBuf, Gaussians) {
        let model = place.model(name);
        // The last iteration makes no step.
        let train =
            ["train", "-s", text(&data), "-m", text(&model), "--iterations", "1", "--few-photos", "off"];
        succeed(&[&train[..], &SHORT, more].concat());
        let path = model.join("point_cloud/iteration_1/point_cloud.ply");
        let gaussians = splats::read(&path, &ReadOptions::default()).expect("a PLY").gaussians;
        (path, gaussians)
    };
    let (path, reference) = begun("reference", &[]);
    let (_, mcmc) = begun("mcmc", &["--strategy", "mcmc"]);
    let (_, given) = begun("given", &["--initial-opacity", "0.9", "--initial-scale", "3"]);
    let (_, scene) = begun("scene", &["--strategy", "mcmc", "--init", text(&path)]);
    let check = |gaussians: &Gaussians, opacity: f32, scale: f32| {
        let logit = (opacity / (1.0 - opacity)).ln();
        assert!(gaussians.opacity_logits.iter().all(|&own| (own - logit).abs() < 1e-5), "{logit}");
        let scales = gaussians.log_scales.iter().flatten().zip(reference.log_scales.iter().flatten());
        let far = scales.map(|(own, usual)| (own - usual - scale.ln()).abs()).fold(0.0, f32::max);
        assert!(far < 1e-5, "{far} off {scale}");
    };
    let points = ashsplat_files::initial_gaussians(&wall_points(), 1).expect("Gaussians");
    assert!(reference.log_scales == points.log_scales);
    check(&reference, 0.1, 1.0);
    check(&mcmc, 0.5, 0.1);
    check(&given, 0.9, 3.0);
    check(&scene, 0.1, 1.0);
}

#[test]
fn contradictions_are_refused_before_the_work() {
    let place = Place::new();
    let (data, model) = (place.model("data"), place.model("model"));
    let train = ["train", "-s", text(&data), "-m", text(&model), "--iterations", "20", "--few-photos", "off"];
    let cases: [(&[&str], [&str; 2]); 10] = [
        (&["--preset", "fast", "--strategy", "mcmc"], ["a preset has the strategy budget", "leave out"]),
        (&["--average-last", "0.1", "--strategy", "budget"], ["average_last: is 0.1", "multi_step = false"]),
        (&["--optimizer-type", "sparse_adam", "--strategy", "budget"], ["multi_step", "sparse_adam"]),
        (&["--strategy", "mcmc", "--cap-max", "7"], ["cap_max: 7 is less than the 400", "raise it"]),
        (&["--strategy", "budget", "--cap-max", "7"], ["cap_max: 7 is less than the 400", "raise it"]),
        (&["--strategy", "budget", "--cap-ratio", "0.5"], ["cap_ratio: is 0.5", "1 or more"]),
        (
            &["--warm-up", "5", "--depth-points", "0.1"],
            ["warm_up: is 5 (preset fast sets it)", "depth_points"],
        ),
        (&["--strategy", "reference", "--recovery"], ["recovery: is true", "strategy reference"]),
        (&["--strategy", "mcmc", "--multi-step"], ["multi_step: is true", "strategy mcmc"]),
        (&["--exposure", "--exposure-lr-init", "-1"], ["exposure_lr_init: is -1", "above 0"]),
    ];
    for (given, words) in cases {
        refuse(&[&train[..], given].concat(), &words);
        assert!(!model.exists(), "{given:?}");
    }
}
