//! `partition --rounds` and `exchange`: blocks that resume with their neighbours' results.

use super::checkpoints::{Place, assert_trained};
use super::merge::{core, division, job, merge, partition, place, read, status};
use super::*;
use ashsplat::trainer::{Checkpoint, SceneBlock};
use ashsplat_files::CheckpointFile;
use serde_json::Value;

/// Grows from the beginning, and makes a step at the end of a round.
const STRATEGY: [&str; 6] =
    ["--strategy", "reference", "--densify-from-iter", "2", "--densification-interval", "3"];

fn exchange(place: &Place, more: &[&str]) -> Finished {
    finish(program().args(["exchange", text(&place.model("blocks.json"))]).args(more))
}

fn train(place: &Place, number: usize, more: &[&str]) -> Finished {
    job(place, number as u32, &[&STRATEGY[..], more].concat())
}

fn divided(rounds: &str) -> (Place, Vec<Value>) {
    let place = place();
    assert_trained(&partition(&place, "blocks.json", &["--max-gaussians", "300", "--rounds", rounds]));
    let blocks = division(&place)["blocks"].as_array().expect("blocks").clone();
    assert!(blocks.len() > 2);
    (place, blocks)
}

/// Last iteration of a block's round, its share of all iterations.
fn end(block: &Value, round: u64, rounds: u64) -> u64 {
    block["iterations"].as_u64().expect("iterations") * round / rounds
}

fn file_of(place: &Place, block: &Value, name: &str) -> PathBuf {
    place.model(block["folder"].as_str().expect("a folder")).join(name)
}

/// Files of an exchange after the first of two rounds.
fn exchanged(place: &Place, blocks: &[Value]) -> Vec<PathBuf> {
    let name = |block: &Value| format!("exchanged{}.safetensors", end(block, 1, 2));
    let own = blocks.iter().map(|block| file_of(place, block, &name(block)));
    own.chain(["ply", "json"].map(|kind| place.model(&format!("blocks/round_1.{kind}")))).collect()
}

fn kept(of: &Checkpoint, rows: &[usize]) -> Checkpoint {
    let mut kept = of.clone();
    kept.keep(rows);
    kept
}

fn contents(paths: &[PathBuf]) -> Vec<Option<Vec<u8>>> {
    paths.iter().map(|path| std::fs::read(path).ok()).collect()
}

#[test]
fn blocks_go_on_with_what_their_neighbours_have_trained() {
    for outside in ["drawn", "masked"] {
        let outside = ["--outside", outside];
        let (place, blocks) = divided("2");
        for number in 1..=blocks.len() {
            let trained = train(&place, number, &outside);
            assert_trained(&trained);
            assert!(trained.stdout.contains("round 1 of 2 is done"), "{}", trained.stdout);
        }
        let waiting = "waiting for an exchange";
        assert!(status(&place).0.iter().all(|status| status["state"] == waiting));
        assert_refused(&merge(&place, "scene.ply"), &["not trained to the end"]);
        let read_all = |kind: &str| -> Vec<Checkpoint> {
            let read = |block: &Value| {
                let path = file_of(&place, block, &format!("{kind}{}.safetensors", end(block, 1, 2)));
                Checkpoint::read(path).expect("a checkpoint")
            };
            blocks.iter().map(read).collect()
        };
        let before = read_all("chkpnt");
        assert_trained(&exchange(&place, &[]));
        // A repeated exchange, also over leftovers, gives the same bytes.
        let (files, scene) = (exchanged(&place, &blocks), place.model("blocks/round_1.ply"));
        let bytes = contents(&files);
        let again = exchange(&place, &[]);
        assert!(again.code == Some(0) && again.stdout.contains("exchanged already"), "{}", again.stdout);
        assert_trained(&exchange(&place, &["--round", "1"]));
        assert!(contents(&files) == bytes);
        std::fs::remove_file(place.model("blocks/round_1.json")).expect("removed");
        std::fs::write(&files[1], "half").expect("written");
        assert_trained(&exchange(&place, &["--quiet"]));
        assert!(contents(&files) == bytes, "other bytes");

        // Each file has the Gaussians of the block's cell and the neighbours' Gaussians around it, with moments and
        // statistics.
        let margin = division(&place)["margin"].as_f64().expect("a margin") as f32;
        for (index, after) in read_all("exchanged").iter().enumerate() {
            let box_of = core(&blocks[index]);
            let in_cell = |of: usize, mean: [f32; 3]| core(&blocks[of]).contains(Vec3::from_array(mean));
            let rows = |of: usize| -> Vec<usize> {
                let means = &before[of].gaussians.means;
                let wanted = |&row: &usize| {
                    in_cell(of, means[row]) && SceneBlock::contains(box_of, margin, means[row])
                };
                (0..means.len()).filter(wanted).collect()
            };
            let mut wanted = kept(&before[index], &rows(index));
            for other in (0..blocks.len()).filter(|&other| other != index) {
                wanted.append(&kept(&before[other], &rows(other))).expect("of the same settings");
            }
            let own = before[index].gaussians.len();
            assert!(wanted.gaussians.len() > 40 && wanted.gaussians != before[index].gaussians, "{own}");
            assert!(wanted.tensors().iter().map(|t| t.bytes).eq(after.tensors().iter().map(|t| t.bytes)));
            assert!(wanted.first_moments.means.iter().flatten().any(|&x| x != 0.0));
            assert_eq!(
                (wanted.iteration, wanted.optimizer_steps, wanted.due),
                (after.iteration, after.optimizer_steps, after.due)
            );
            let inside = |mean: &[f32; 3]| SceneBlock::contains(box_of, margin, *mean);
            let around = read(&scene).means.iter().filter(|mean| !inside(mean)).count();
            assert_eq!(after.block.expect("a block").frozen, around as u64);
        }

        // In any order, and from any checkpoint.
        let every = ["--checkpoint-every", "1", "--start-checkpoint", "auto"];
        let last: Vec<String> = (1..=blocks.len())
            .rev()
            .map(|number| {
                let block = &blocks[number - 1];
                let trained = train(&place, number, &[&outside[..], &every].concat());
                assert_trained(&trained);
                assert!(trained.stdout.contains("written to"), "{}", trained.stdout);
                format!("point_cloud/iteration_{}/point_cloud.ply", block["iterations"])
            })
            .rev()
            .collect();
        assert_trained(&merge(&place, "scene.ply"));
        let scene = std::fs::read(place.model("scene.ply")).expect("a scene");
        for (number, (block, name)) in (1..).zip(blocks.iter().zip(&last)) {
            // A killed training leaves no note, and an earlier checkpoint.
            let path = file_of(&place, block, name);
            let good = std::fs::read(&path).expect("a scene");
            std::fs::remove_file(file_of(&place, block, "block.json")).expect("removed");
            let newest = file_of(&place, block, &format!("chkpnt{}.safetensors", block["iterations"]));
            std::fs::remove_file(&newest).expect("a checkpoint");
            std::fs::remove_file(&path).expect("removed");
            let stop = (end(block, 1, 2) + 1).to_string();
            let at = [&outside[..], &["--checkpoint-iterations", &stop]].concat();
            assert_trained(&train(&place, number, &at));
            let note = file_of(&place, block, "last_checkpoint");
            assert_eq!(std::fs::read_to_string(&note).ok(), Some(format!("{stop}\n")));
            std::fs::remove_file(file_of(&place, block, "block.json")).expect("removed");
            std::fs::remove_file(&path).expect("removed");
            assert_trained(&train(&place, number, &[&outside[..], &every].concat()));
            assert!(std::fs::read(&path).ok() == Some(good), "block {number}: other bytes");
        }
        assert_trained(&merge(&place, "again.ply"));
        assert!(std::fs::read(place.model("again.ply")).ok() == Some(scene), "other bytes");
        assert_refused(&exchange(&place, &["--round", "2"]), &["--round", "after the last of 2 rounds"]);
        assert!(read(&place.model("again.ply")).len() > 100);
    }
}

/// Training is killed at any time within two rounds, and repeated.
#[test]
fn a_round_that_is_gone_on_with_ends_with_the_same_bits() {
    let (place, blocks) = divided("2");
    let folder = |place: &Place| place.model("blocks");
    let auto = ["--start-checkpoint", "auto", "--checkpoint-every", "2"];
    (1..=blocks.len()).for_each(|number| assert_trained(&train(&place, number, &[])));
    let ends = |place: &Place| -> Vec<PathBuf> {
        let name = |block: &Value| format!("chkpnt{}.safetensors", end(block, 1, 2));
        blocks.iter().map(|block| file_of(place, block, &name(block))).collect()
    };
    let wanted = contents(&ends(&place));
    std::fs::remove_dir_all(folder(&place)).expect("removed");
    for number in (1..=blocks.len()).rev() {
        assert_trained(&train(&place, number, &auto));
        // The note of a round's end is missing.
        std::fs::remove_file(file_of(&place, &blocks[number - 1], "round.json")).expect("noted");
        assert_trained(&train(&place, number, &auto));
        let again = train(&place, number, &auto);
        assert!(again.stdout.contains("round 1 of 2 is done") && !again.stdout.contains("written"));
    }
    assert!(contents(&ends(&place)) == wanted, "other bits");
}

#[test]
fn what_cannot_be_exchanged_is_refused() {
    let (place, blocks) = divided("2");
    let before =
        || files_below(&place.model("")).into_iter().filter(|path| !path.ends_with(".exchange.lock"));
    assert_refused(
        &exchange(&place, &[]),
        &["blocks.json", "round 1", "1, 2", "not trained to the end of the round"],
    );
    // A refused exchange writes nothing.
    assert!(!place.model("blocks").exists());
    for number in 2..=blocks.len() {
        assert_trained(&train(&place, number, &[]));
    }
    let refused = |words: &[&str]| {
        let there: Vec<PathBuf> = before().collect();
        assert_refused(&exchange(&place, &[]), words);
        assert!(before().eq(there), "something was written");
    };
    refused(&["blocks.json", "1 not trained to the end of the round", "--job", "blocks.json:1"]);
    assert_trained(&train(&place, 1, &["--lambda-dssim", "0.3"]));
    refused(&["block 2", "other settings than block 1", "lambda_dssim was 0.3, is 0.2"]);
    assert_trained(&train(&place, 1, &[]));
    // Everything is valid except one file.
    let changed = |name: &str, change: &dyn Fn(&[u8]) -> Vec<u8>, words: &[&str]| {
        let path = file_of(&place, &blocks[0], name);
        let good = std::fs::read(&path).expect("a file");
        std::fs::write(&path, change(&good)).expect("written");
        refused(words);
        std::fs::write(&path, good).expect("written");
    };
    let edited = |name: &'static str, value: Value| {
        move |note: &[u8]| {
            let mut note: Value = serde_json::from_slice(note).expect("JSON");
            note[name] = value.clone();
            note.to_string().into_bytes()
        }
    };
    changed("round.json", &edited("blocks", "0".into()), &["1 trained for another division"]);
    changed("round.json", &edited("block", 2.into()), &["1 trained for another division"]);
    changed("round.json", &edited("iteration", 1.into()), &["1 at the end of another round"]);
    changed("round.json", &|_| b"{".to_vec(), &["1 not trained to the end of the round"]);
    let checkpoint = format!("chkpnt{}.safetensors", end(&blocks[0], 1, 2));
    let flipped = |bytes: &[u8]| {
        let mut bytes = bytes.to_vec();
        let last = bytes.len() - 9;
        bytes[last] ^= 1;
        bytes
    };
    changed(&checkpoint, &flipped, &[&checkpoint, "damaged"]);
    changed(&checkpoint, &|bytes| bytes[..99].to_vec(), &[&checkpoint, "truncated"]);
    let others = file_of(&place, &blocks[1], &format!("chkpnt{}.safetensors", end(&blocks[1], 1, 2)));
    let others = std::fs::read(others).expect("a checkpoint");
    changed(&checkpoint, &|_| others.clone(), &[&checkpoint, "is not that of iteration", "of block 1"]);
    let path = file_of(&place, &blocks[0], &checkpoint);
    std::fs::rename(&path, place.model("kept")).expect("moved");
    refused(&["1 without the checkpoint of the round's end"]);
    std::fs::rename(place.model("kept"), &path).expect("moved");
    // A round ends at its share of the division's iterations.
    assert_refused(&train(&place, 1, &["--iterations", "30"]), &["--iterations", "share of the division's"]);
    assert_refused(&train(&place, 1, &["--pose-opt"]), &["pose_opt", "rounds"]);
    // A new division must not replace one whose blocks have been trained.
    let replaced = partition(&place, "blocks.json", &["--max-gaussians", "300", "--rounds", "3"]);
    assert_refused(&replaced, &["blocks have been trained", "another -o"]);
    let many = partition(&place, "other.json", &["--max-gaussians", "300", "--rounds", "50"]);
    assert_refused(&many, &["block ", "too few for 50 rounds"]);
    assert_trained(&partition(&place, "whole.json", &["--max-gaussians", "300"]));
    let of_one = finish(program().args(["exchange", text(&place.model("whole.json"))]));
    assert_refused(&of_one, &["whole.json", "is of one round", "--rounds"]);
    assert!(!place.model("other.json").exists() && !place.model("whole").exists());
    // A block must resume with the options that it ended with.
    assert_trained(&exchange(&place, &[]));
    assert_refused(&train(&place, 1, &["--outside", "masked"]), &["other photographs or cameras"]);
}

#[cfg(unix)]
#[test]
fn two_exchanges_at_once_are_refused() {
    use nix::fcntl::{Flock, FlockArg};
    let place = place();
    assert_trained(&partition(&place, "blocks.json", &["--max-gaussians", "100000", "--rounds", "3"]));
    // A single block is the whole scene: an exchange changes nothing.
    assert_trained(&job(&place, 1, &STRATEGY));
    let path = place.model("blocks/.exchange.lock");
    std::fs::write(&path, "process 1").expect("written");
    let file = std::fs::File::open(&path).expect("it is there");
    let held = Flock::lock(file, FlockArg::LockExclusiveNonblock).expect("free");
    assert_refused(&exchange(&place, &[]), &["another exchange (process 1)"]);
    drop(held);
    assert_trained(&exchange(&place, &[]));
    assert_trained(&job(&place, 1, &STRATEGY));
    assert_trained(&exchange(&place, &[]));
    assert!(!place.model("blocks/round_1.ply").exists(), "nothing goes on from there");
    assert_trained(&job(&place, 1, &STRATEGY));
    assert_trained(&merge(&place, "scene.ply"));
    let whole = place.model("coarse/point_cloud/iteration_12/point_cloud.ply");
    let plain = ["--init", text(&whole), "--eval", "--iterations", "14", "--few-photos", "off"];
    let (data, model) = (place.model("data"), place.model("whole"));
    let same = finish(
        program()
            .args(["train", "-s", text(&data), "-m", text(&model), "--quiet", "--sh-degree", "1"])
            .args(plain)
            .args(STRATEGY),
    );
    assert_trained(&same);
    let merged = std::fs::read(place.model("scene.ply")).expect("a scene");
    assert!(merged == place.ply("whole", 14), "other bits");
}
