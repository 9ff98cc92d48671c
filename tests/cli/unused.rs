//! Training settings without effect.

use super::*;
use ashsplat::scene::WorldFrame;
use tempfile::tempdir;

const FEW: [&str; 6] = ["--iterations", "2", "--sh-degree", "0", "--eval-share", "0"];

/// An error names each such setting and what would use it. No folder is created.
#[test]
fn settings_without_effect_are_refused() {
    let folder = tempdir().expect("a temporary folder");
    let (data, model, file) =
        (folder.path().join("data"), folder.path().join("model"), folder.path().join("my.toml"));
    write_dataset(&data);
    let usual = ["train", "-s", text(&data), "-m", text(&model), "--few-photos", "off"];
    let refused = |more: &[&str], words: [&str; 2]| {
        let run = finish(program().args(usual).args(FEW).args(more));
        assert_refused(&run, &[&words[..], &["no effect"]].concat());
        assert!(!model.exists(), "{more:?}");
    };
    refused(&["--cap-max", "50000"], ["cap_max: is 50000", "budget"]);
    refused(&["--noise-lr", "1e4", "--strategy", "budget"], ["noise_lr", "mcmc"]);
    refused(&["--strategy=budget", "--cap-max=900", "--cap-ratio=3"], ["cap_ratio", "without --cap-max"]);
    refused(&["--antialiasing-detached"], ["antialiasing_detached", "--antialiasing"]);
    refused(&["--pose-lr", "1e-3"], ["pose_lr", "--pose-opt"]);
    refused(&["--exposure-lr-final", "0.1"], ["exposure_lr_final", "--exposure"]);
    refused(&["--exposure-reg", "0.1"], ["exposure_reg", "--exposure"]);
    refused(&["--lens-reg", "0.1"], ["lens_reg", "--lens-effects"]);
    refused(&["--depth-l1-weight-final", "0.1"], ["depth_l1_weight_final", "-d"]);
    refused(&["--strategy=mcmc", "--densify-grad-threshold=1e-4"], ["densify_grad_threshold", "reference"]);
    refused(&["--strategy", "mcmc", "--percent-dense", "0.1"], ["percent_dense", "reference"]);
    refused(&["--strategy", "mcmc", "--min-opacity", "0.1"], ["min_opacity", "reference or budget"]);
    let scene = folder.path().join("scene.ply");
    let gaussians = ashsplat_files::initial_gaussians(&wall_points(), 0).expect("Gaussians");
    ashsplat_files::ply::write(&scene, &gaussians).expect("written");
    refused(&["--init", text(&scene), "--initial-scale", "0.5"], ["initial_scale", "--init"]);
    refused(&["--strategy=fixed", "--opacity-reset-interval=9"], ["opacity_reset_interval", "budget"]);
    std::fs::write(&file, "lens_lr = 0.5\n").expect("written");
    refused(&["--config", text(&file)], ["lens_lr: is 0.5", "--lens-effects"]);
    // One of several compared strategies may use it.
    let (out, both) = (folder.path().join("out"), "--strategies=reference,mcmc");
    let bench = ["bench", "quality", text(&data), "-o", text(&out), both];
    refuse(&[&bench[..], &["--pose-lr", "1e-3"]].concat(), &["pose_lr", "no effect"]);
    refuse(&[&bench[..], &["--cap-max", "7"]].concat(), &["cap_max", "400 Gaussians"]);
}

/// Options of `render`, `eval` and `convert` without effect.
#[test]
fn options_without_effect_are_refused() {
    let folder = tempdir().expect("a temporary folder");
    let at = |name: &str| folder.path().join(name);
    let (scene, data, model, out) = (at("scene.ply"), at("data"), at("model"), at("out"));
    write_dataset(&data);
    let gaussians = ashsplat_files::initial_gaussians(&wall_points(), 0).expect("Gaussians");
    let saved = model.join("point_cloud/iteration_7/point_cloud.ply");
    std::fs::create_dir_all(saved.parent().expect("a folder")).expect("created");
    for path in [&scene, &saved] {
        ashsplat_files::ply::write(path, &gaussians).expect("written");
    }
    let named: Vec<(String, Camera)> = (0..VIEWS).map(|index| (index.to_string(), view(index))).collect();
    let named = named.iter().map(|(name, camera)| (name.as_str(), camera));
    ashsplat_files::cameras_json::write(model.join("cameras.json"), named, &WorldFrame::default())
        .expect("written");
    let render = |more: &[&str], words: &[&str]| {
        refuse(&[&["render", "-o", text(&out)], more].concat(), words);
        assert!(!out.exists(), "{more:?}");
    };
    let up = ["--up", "0,0,1"];
    render(&[&[text(&model), "--orbit", "3"][..], &up].concat(), &["--up", "cameras.json says where up is"]);
    render(&[&[text(&model)][..], &up].concat(), &["--up", "--orbit"]);
    render(&[&[text(&scene), "-s", text(&data)][..], &up].concat(), &["--up", "--orbit"]);
    let of_file = ["--iteration", "model folders", "scene.ply is a file"];
    render(&[text(&scene), "--iteration", "7", "--orbit", "3"], &of_file);
    refuse(&["eval", text(&scene), "-s", text(&data), "--iteration", "7"], &of_file);
    refuse(&["convert", text(&scene), text(&at("a.spz")), "--iteration", "7"], &of_file);
    // Files may be joined with a model.
    let joined = at("a.spz");
    succeed(&["convert", text(&scene), text(&model), "-o", text(&joined), "--iteration", "7"]);
}

/// Explicit defaults, settings dumped by a run, and settings that a file itself enables are accepted.
#[test]
fn settings_that_are_listed_without_effect_are_read() {
    let folder = tempdir().expect("a temporary folder");
    let at = |name: &str| folder.path().join(name);
    let data = at("data");
    write_dataset(&data);
    let train = |model: &str, more: &[&str]| {
        let model = at(model);
        let usual = ["train", "-s", text(&data), "-m", text(&model), "--quiet"];
        succeed(&[&usual[..], &FEW, more].concat());
        std::fs::read_to_string(model.join("settings.toml")).expect("a dump")
    };
    // With few photos the strategy is budget, which has a bound.
    let dump = train("first", &["--cap-max", "500", "--pose-opt", "--pose-lr", "1e-4"]);
    assert!(dump.contains("cap_max = 500\n") && dump.contains("strategy = \"budget\""), "{dump}");
    let (config, own) = (at("first/settings.toml"), at("own.toml"));
    let dump = train("again", &["--config", text(&config), "--pose-opt=false"]);
    assert!(dump.contains("pose_opt = false") && dump.contains("pose_lr = 0.0001"), "{dump}");
    std::fs::write(&own, "pose_opt = true\npose_lr = 0.0001\n").expect("written");
    train("own", &["--config", text(&own), "--pose-opt=false"]);
    train("preset", &["--preset", "fast", "--cap-max", "500", "--pose-lr", "1e-5"]);
}
