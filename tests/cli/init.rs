//! `train --init`: training that starts from a scene.

use super::checkpoints::{Place, assert_trained};
use super::*;
use ashsplat_files::splats::{self, ReadOptions};

/// A scene of any format can replace the points.
#[test]
fn a_training_begins_with_a_scene() {
    let place = Place::new();
    let still = "--strategy fixed --position_lr_init 1e-12 --position_lr_final 1e-12 --feature_lr 0 --opacity_lr 0 \
                 --scaling_lr 0 --rotation_lr 0";
    let still: Vec<&str> = still.split_whitespace().collect();
    // SH degree 1 is active from iteration 5 on, so that the scene has higher coefficients.
    assert_trained(&place.train("coarse", &["--iterations", "30", "--sh_degree_interval", "5"]));
    let coarse = place.model("coarse").join("point_cloud/iteration_30/point_cloud.ply");
    let begin = |model: &str, scene: &Path, more: &[&str]| {
        let mut command = program();
        let (data, out) = (place.model("data"), place.model(model));
        command.args(["train", "-s", text(&data), "-m", text(&out), "--quiet", "--init", text(scene)]);
        finish(command.args(more))
    };
    let trained = |model: &str, iteration: u32| {
        let path = place.model(model).join(format!("point_cloud/iteration_{iteration}/point_cloud.ply"));
        splats::read(path, &ReadOptions::default()).expect("a PLY").gaussians
    };
    let first = trained("coarse", 30);
    assert!(first.sh.iter().skip(1).step_by(4).flatten().any(|&c| c != 0.0), "no SH above degree 0");
    // One step with zero rates keeps the scene.
    let options = [still.as_slice(), &["--sh_degree", "1", "--iterations", "1"]].concat();
    assert_trained(&begin("same", &coarse, &options));
    let same = trained("same", 1);
    assert_eq!((same.means.len(), &same.sh), (first.means.len(), &first.sh));
    assert_eq!((&same.opacity_logits, &same.log_scales), (&first.opacity_logits, &first.log_scales));
    assert!(!place.model("same").join("input.ply").exists());
    // The scene's SH degree is active at once.
    let settings = std::fs::read_to_string(place.model("same").join("settings.toml")).expect("settings");
    assert!(settings.contains("sh_degree_start = 1"), "{settings}");
    // Another degree: coefficients are cut or zero.
    let options = [still.as_slice(), &["--sh_degree", "0", "--iterations", "1"]].concat();
    assert_trained(&begin("cut", &coarse, &options));
    assert_eq!(trained("cut", 1).sh.len(), first.means.len());
    let options = [still.as_slice(), &["--sh_degree", "2", "--iterations", "1"]].concat();
    assert_trained(&begin("more", &coarse, &options));
    let more = trained("more", 1);
    let rows = more.sh.chunks_exact(9).zip(first.sh.chunks_exact(4));
    assert!(rows.into_iter().all(|(more, first)| more[..4] == *first && more[4..] == [[0.0; 3]; 5]));
    // Training from a compressed scene, with a checkpoint to resume from.
    let spz = place.model("coarse.spz");
    assert_trained(&finish(program().args(["convert", text(&coarse), text(&spz)])));
    let options = ["--strategy", "reference", "--iterations", "12", "--checkpoint_iterations", "8"];
    assert_trained(&begin("on", &spz, &options));
    let resumed = [options.as_slice(), &["--start-checkpoint", "latest"]].concat();
    let ply = place.ply("on", 12);
    std::fs::remove_dir_all(place.model("on").join("point_cloud")).expect("removed");
    assert_trained(&begin("on", &spz, &resumed));
    assert!(place.ply("on", 12) == ply, "other bits");
    // A file that this training would move away.
    let inside = place.model("on").join("point_cloud/iteration_12/point_cloud.ply");
    assert_refused(&begin("on", &inside, &options), &["lies in the model folder"]);
    // A missing scene.
    let refused = begin("none", &place.model("nowhere.ply"), &[]);
    assert_refused(&refused, &["nowhere.ply"]);
    assert!(!place.model("none").exists());
}
