//! Settings of trainings: those of strategies, presets and few photos, contradictions, and settings without effect.

use super::*;
use ashsplat_files::cameras_json;

/// Option sets to test.
const STRATEGIES: [&str; 4] = [
    "--strategy budget --few-photos off",
    "--strategy mcmc --few-photos off",
    "--preset fast --few-photos off",
    // No strategy: few photographs select it.
    "--exposure",
];

const SHORT: &str = "--quiet --eval-share 0 --sh-degree 1 --sh-degree-interval 6 --scale-sh-degree=false \
                     --densify-from-iter 5 --densification-interval 6";

#[test]
fn every_strategy_resumes_and_verifies() {
    let place = TestFolder::new();
    let mut ends = Vec::new();
    for (number, way) in STRATEGIES.iter().enumerate() {
        let name = number.to_string();
        let train = |more: &str| {
            place.run(format!("train -s @data -m @{name} --iterations 40 {SHORT} {way} {more}")).ok()
        };
        train("--checkpoint-iterations 13 27");
        let whole = place.ply(&name, 40);
        let iteration = [13, 27][number % 2];
        place.remove(format!("{name}/point_cloud"));
        train(&format!("--start-checkpoint @{name}/chkpnt{iteration}.safetensors"));
        assert!(place.ply(&name, 40) == whole, "{way:?}: other bits from {iteration} on");
        let said = train("--verify-determinism 20").stdout;
        assert!(said.starts_with("20 iterations twice on ") && said.contains("the same bits"), "{said}");
        ends.push(whole);
    }
    ends.sort();
    ends.dedup();
    assert_eq!(ends.len(), STRATEGIES.len(), "two ways do the same");
}

/// 3DGS-MCMC starts with more opaque, smaller Gaussians. A given scene keeps its values.
#[test]
fn a_strategy_begins_with_its_own_values() {
    let place = TestFolder::new();
    let begun = |name: &str, more: &str| -> Gaussians {
        // The last iteration makes no step.
        place.run(format!("train -s @data -m @{name} --iterations 1 --few-photos off {SHORT} {more}")).ok();
        place.gaussians(point_cloud(name, 1))
    };
    let reference = begun("reference", "");
    assert!(reference.log_scales == wall(1).log_scales);
    let scene = format!("--strategy mcmc --init @{}", point_cloud("reference", 1));
    for (name, options, opacity, scale) in [
        ("reference", "", 0.1_f32, 1.0_f32),
        ("mcmc", "--strategy mcmc", 0.5, 0.1),
        ("given", "--initial-opacity 0.9 --initial-scale 3", 0.9, 3.0),
        ("scene", &scene, 0.1, 1.0),
    ] {
        let gaussians = if name == "reference" { reference.clone() } else { begun(name, options) };
        let logit = (opacity / (1.0 - opacity)).ln();
        assert!(gaussians.opacity_logits.iter().all(|&own| (own - logit).abs() < 1e-5), "{name}: {logit}");
        let scales = gaussians.log_scales.iter().flatten().zip(reference.log_scales.iter().flatten());
        let far = scales.map(|(own, usual)| (own - usual - scale.ln()).abs()).fold(0.0, f32::max);
        assert!(far < 1e-5, "{name}: {far} off {scale}");
    }
}

#[test]
fn contradictions_are_refused_before_the_work() {
    let place = TestFolder::new();
    for (given, words) in [
        ("--preset fast --strategy mcmc", ["the strategy differs from the preset's", "leave out"]),
        ("--strategy mcmc --cap-max 7", ["cap_max: 7 is less than the 400", "raise it"]),
        ("--strategy budget --cap-max 7", ["cap_max: 7 is less than the 400", "raise it"]),
        ("--strategy budget --cap-ratio 0.5", ["cap_ratio: is 0.5", "1 or more"]),
        ("--warm-up 5 --depth-points 0.1", ["warm_up: is 5 (preset fast sets it)", "depth_points"]),
        ("--strategy reference --recovery", ["recovery: is true", "strategy reference"]),
        ("--exposure --exposure-lr-init -1", ["exposure_lr_init: is -1", "above 0"]),
    ] {
        let train = format!("train -s @data -m @model --iterations 20 --few-photos off {given}");
        place.run(train).refused(&words);
        assert!(!place.has("model"), "{given:?}");
    }
}

const SCHEDULE: &str = "--sh_degree 0 --eval-share 0";

fn train(place: &TestFolder, model: &str, more: &str) -> Finished {
    place.run(format!("train -s @data -m @{model} --iterations 12 {SCHEDULE} {more}"))
}

fn setting(place: &TestFolder, model: &str, name: &str) -> String {
    let dump = place.read_text(format!("{model}/settings.toml"));
    let line = dump.lines().find_map(|line| line.strip_prefix(&format!("{name} = ")));
    line.unwrap_or_else(|| panic!("no {name} in {dump}")).to_owned()
}

#[test]
fn growth_that_comes_too_late_is_told() {
    let place = TestFolder::new();
    let growth = "--preset reference --densify-from-iter 2 --densification-interval";
    let output = "at iteration 8, is 4 iterations before the end";
    train(&place, "late", &format!("{growth} 8")).ok().warns(&[output]);
    assert!(!train(&place, "last", &format!("{growth} 12")).ok().stderr.contains("the last densification"));
}

/// Data sets with few photos get special settings, and one line says so. Given options have priority.
#[test]
fn few_photos_are_noticed_and_said() {
    let place = TestFolder::new();
    let setting = |model: &str, name: &str| setting(&place, model, name);
    // The line about few photos, if any.
    let line_of = |run: Finished| -> Option<String> {
        let said = run.ok().stderr;
        let mut lines = said.lines().filter(|line| line.contains("photos to train on: ")).map(str::to_owned);
        let line = lines.next();
        assert_eq!(lines.next(), None, "{said}");
        line
    };
    let said = line_of(train(&place, "auto", "")).expect("a line");
    assert_says(&said, &["--dropout 0.1", "--opacity-reg 0.003", "--decay-last 0.25"]);
    assert_says(&said, &["9 photos to train on", "--few-photos off"]);
    let kinds = |model: &str| ["strategy", "dropout"].map(|name| setting(model, name));
    assert_eq!(kinds("auto"), ["\"budget\"", "0.1"]);
    assert_eq!(setting("auto", "few_photos"), "\"auto\"");
    // A run with the dump's settings is identical, and prints no such line.
    train(&place, "again", "--config @auto/settings.toml").ok();
    assert!(place.ply("again", 12) == place.ply("auto", 12));
    assert_eq!(line_of(train(&place, "off", "--few-photos off")), None);
    assert_eq!(kinds("off"), ["\"budget\"", "0.0"]);
    for strategy in ["mcmc", "fixed"] {
        let words = ["--few-photos", "no settings for --strategy", strategy];
        train(&place, "none", &format!("--few-photos on --strategy {strategy}")).refused(&words);
    }
    let reference = "--few-photos on --strategy reference";
    let said = line_of(train(&place, "given", reference)).expect("a line");
    assert_says(&said, &["--densify-until-iter 1500"]);
    assert_eq!(kinds("given"), ["\"reference\"", "0.0"]);
    let given = format!("{reference} --densify-until-iter 9");
    assert_eq!(line_of(train(&place, "given", &given)), None);
    assert_eq!(setting("given", "densify_until_iter"), "9");
    assert_eq!(line_of(train(&place, "recipe", "--preset reference")), None);
    // A training that began as one with many photos resumes as such.
    let stop = "--few-photos off --checkpoint-iterations 5";
    assert_eq!(line_of(train(&place, "begun", stop)), None);
    let on = "train -s @data -m @begun --sh_degree 0 --start-checkpoint latest --iterations 14";
    assert_eq!(line_of(place.run(on)), None);
    assert_eq!(setting("begun", "dropout"), "0.0");
    assert_eq!(line_of(train(&place, "quiet", "--quiet")), None);
    assert_eq!(setting("quiet", "dropout"), "0.1");
    place.run("train -s @data -m x --few-photos maybe").refused(&["maybe", "few-photos"]);
}

/// Exposures are switched on where photos differ in them. The same command continues with them, and one photo does not matter.
#[test]
fn presets_learn_exposures_where_photos_differ_in_them() {
    let place = TestFolder::new();
    let run = |model: &str, more: &str| {
        place.run(format!("train -s @data -m @{model} --preset fast {SCHEDULE} {more}")).ok().stderr
    };
    assert!(!run("alike", "--iterations 6").contains("differ in exposure"));
    assert_eq!(setting(&place, "alike", "exposure"), "false");
    for index in (0..VIEWS).step_by(2) {
        let path = place.at("data/images").join(photo_name(index));
        let mut photo = Photo::read(&path, [0.0; 3]).expect("a photo");
        photo.rgb.iter_mut().for_each(|value| *value = (0.6 * f32::from(*value)) as u8);
        photo.write_png(&path).expect("written");
    }
    let begun = "--checkpoint-every 3 --start-checkpoint auto --iterations";
    let said = run("dark", &format!("{begun} 6"));
    assert_says(&said, &["photos differ in exposure", "--exposure=false"]);
    assert!(!run("dark", &format!("{begun} 8")).contains("differ in exposure"));
    assert_eq!(setting(&place, "dark", "exposure"), "true");
    assert!(!run("off", "--iterations 6 --exposure=false").contains("differ in exposure"));
}

/// A model with observations gives depths for training. For a model without them, an error says so before the
/// training.
#[test]
fn points_are_taken_for_depths_where_photos_show_them() {
    let place = TestFolder::empty();
    write_observed(&place.at("data"));
    train(&place, "model", "--few-photos off --depth-points 0.1 --eval").ok();
    assert_eq!(setting(&place, "model", "depth_points"), "0.1");
    train(&place, "without", "--few-photos off --eval").ok();
    assert!(place.ply("model", 12) != place.ply("without", 12));

    write_dataset(&place.at("bare"));
    let bare = format!("train -s @bare -m @none --iterations 12 {SCHEDULE} --depth-points 0.1");
    place.run(bare).refused(&["which photos show which points", "--depth-points"]);
    train(&place, "none", "--depth-points 0.1 -d depths").refused(&["depth_points", "-d"]);
    train(&place, "none", "--dropout 0.95").refused(&["dropout", "0.95", "0.9"]);
    assert!(!place.has("none"), "nothing is left of a run that was refused");
}

const FEW: &str = "--iterations 2 --sh-degree 0 --eval-share 0";

/// An error names each such setting and what would use it. No folder is created.
#[test]
fn settings_without_effect_are_refused() {
    let place = TestFolder::new();
    place.write_scene("scene.ply", &wall(0));
    place.write("my.toml", "lens_lr = 0.5\n");
    for (options, words) in [
        ("--strategy reference --cap-max 50000", ["cap_max: is 50000", "budget"]),
        ("--noise-lr 1e4 --strategy budget", ["noise_lr", "mcmc"]),
        ("--strategy=budget --cap-max=900 --cap-ratio=3", ["cap_ratio", "without --cap-max"]),
        ("--antialiasing=false --antialiasing-detached", ["antialiasing_detached", "--antialiasing"]),
        ("--pose-lr 1e-3", ["pose_lr", "--pose-opt"]),
        ("--exposure-lr-final 0.1", ["exposure_lr_final", "--exposure"]),
        ("--exposure-reg 0.1", ["exposure_reg", "--exposure"]),
        ("--lens-reg 0.1", ["lens_reg", "--lens-effects"]),
        ("--depth-l1-weight-final 0.1", ["depth_l1_weight_final", "-d"]),
        ("--strategy=mcmc --densify-grad-threshold=1e-4", ["densify_grad_threshold", "reference"]),
        ("--strategy mcmc --percent-dense 0.1", ["percent_dense", "reference"]),
        ("--strategy mcmc --min-opacity 0.1", ["min_opacity", "reference or budget"]),
        ("--init @scene.ply --initial-scale 0.5", ["initial_scale", "--init"]),
        ("--strategy=fixed --opacity-reset-interval=9", ["opacity_reset_interval", "budget"]),
        ("--config @my.toml", ["lens_lr: is 0.5", "--lens-effects"]),
    ] {
        let train = format!("train -s @data -m @model --few-photos off {FEW} {options}");
        place.run(train).refused(&[words[0], words[1], "no effect"]);
        assert!(!place.has("model"), "{options}");
    }
}

#[test]
fn options_without_effect_are_refused() {
    let place = TestFolder::new();
    for path in ["scene.ply", &point_cloud("model", 7)] {
        place.write_scene(path, &wall(0));
    }
    let named: Vec<(String, Camera)> = (0..VIEWS).map(|index| (index.to_string(), view(index))).collect();
    let named = named.iter().map(|(name, camera)| (name.as_str(), camera));
    cameras_json::write(place.at("model/cameras.json"), named, &WorldFrame::default()).expect("written");
    let of_file = ["--iteration", "model folders", "scene.ply is a file"];
    for (line, words) in [
        ("render -o @out @model --orbit 3 --up 0,0,1", &["--up", "cameras.json says where up is"][..]),
        ("render -o @out @model --up 0,0,1", &["--up", "--orbit"]),
        ("render -o @out @scene.ply -s @data --up 0,0,1", &["--up", "--orbit"]),
        ("render -o @out @scene.ply --iteration 7 --orbit 3", &of_file),
        ("eval @scene.ply -s @data --iteration 7", &of_file),
        ("convert @scene.ply @a.spz --iteration 7", &of_file),
    ] {
        place.run(line).refused(words);
        assert!(!place.has("out"), "{line}");
    }
    // Files may be joined with a model.
    place.run("convert @scene.ply @model -o @a.spz --iteration 7").ok();
}

/// Explicit defaults, settings dumped by a run, and settings that a file itself enables are accepted.
#[test]
fn settings_that_are_listed_without_effect_are_read() {
    let place = TestFolder::new();
    let train = |model: &str, more: &str| {
        place.run(format!("train -s @data -m @{model} --quiet {FEW} {more}")).ok();
        place.read_text(format!("{model}/settings.toml"))
    };
    // With few photos the strategy is budget, which has a bound.
    let dump = train("first", "--cap-max 500 --pose-opt --pose-lr 1e-4");
    assert_says(&dump, &["cap_max = 500\n", "strategy = \"budget\""]);
    let dump = train("again", "--config @first/settings.toml --pose-opt=false");
    assert_says(&dump, &["pose_opt = false", "pose_lr = 0.0001"]);
    place.write("own.toml", "pose_opt = true\npose_lr = 0.0001\n");
    train("own", "--config @own.toml --pose-opt=false");
    train("preset", "--preset fast --cap-max 500 --pose-lr 1e-5");
}
