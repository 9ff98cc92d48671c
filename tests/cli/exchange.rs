//! `partition --rounds` and `exchange`: blocks that resume with their neighbours' results.

use super::merge::{core, file_of, in_core, list, number, scene_of};
use super::*;
use ashsplat::train::{MomentState, SceneBlock};

/// Grows from the beginning, and makes a step at the end of a round.
const STRATEGY: &str = "--strategy reference --densify-from-iter 2 --densification-interval 3";

struct Divided {
    place: TestFolder,
    blocks: Vec<Value>,
}

impl Divided {
    fn new() -> Divided {
        let place = TestFolder::with_coarse_model();
        place.partition("blocks.json", "--max-gaussians 300 --rounds 2").ok();
        let blocks = list(&place.division(), "blocks").clone();
        assert!(blocks.len() > 2);
        Divided { place, blocks }
    }

    fn numbers(&self) -> std::ops::RangeInclusive<usize> {
        1..=self.blocks.len()
    }

    fn exchange(&self, more: &str) -> Finished {
        self.place.run(format!("exchange @blocks.json {more}"))
    }

    fn train(&self, number: usize, more: &str) -> Finished {
        self.place.job(number as u64, &format!("{STRATEGY} {more}"))
    }

    /// Files of this kind at the end of the first round, one for each block.
    fn checkpoints(&self, kind: &str) -> Vec<String> {
        let name = |block| file_of(block, &format!("{kind}{}.safetensors", first_end(block)));
        self.blocks.iter().map(name).collect()
    }

    fn read_all(&self, kind: &str) -> Vec<Checkpoint> {
        let read = |name| Checkpoint::read(self.place.at(name)).expect("a checkpoint");
        self.checkpoints(kind).iter().map(read).collect()
    }

    fn contents(&self, names: &[String]) -> Vec<Vec<u8>> {
        names.iter().map(|name| self.place.read(name)).collect()
    }
}

/// Last iteration of a block's first round, half of all.
fn first_end(block: &Value) -> u64 {
    number(block, "iterations") / 2
}

fn kept(of: &Checkpoint, rows: &[usize]) -> Checkpoint {
    let mut kept = of.clone();
    kept.keep(rows);
    kept
}

#[test]
fn blocks_go_on_with_what_their_neighbours_have_trained() {
    for outside in ["--outside drawn", "--outside masked --moments packed"] {
        let divided = Divided::new();
        let (place, blocks) = (&divided.place, &divided.blocks);
        for number in divided.numbers() {
            divided.train(number, outside).ok().says(&["round 1 of 2 is done"]);
        }
        let waiting = "waiting for an exchange";
        assert!(place.status().0.iter().all(|status| status["state"] == waiting));
        place.merge("scene.ply").refused(&["not trained to the end"]);
        let before = divided.read_all("chkpnt");
        divided.exchange("").ok();
        // A repeated exchange, also over leftovers, gives the same bytes.
        let mut files = divided.checkpoints("exchanged");
        files.extend(["ply", "json"].map(|kind| format!("blocks/round_1.{kind}")));
        let bytes = divided.contents(&files);
        divided.exchange("").ok().says(&["exchanged already"]);
        divided.exchange("--round 1").ok();
        assert!(divided.contents(&files) == bytes);
        place.remove("blocks/round_1.json");
        place.write(&files[1], "half");
        divided.exchange("--quiet").ok();
        assert!(divided.contents(&files) == bytes, "other bytes");

        // Each file has the Gaussians of the block's cell and the neighbours' Gaussians around it, with moments and
        // statistics.
        let margin = place.division()["margin"].as_f64().expect("a margin") as f32;
        for (index, after) in divided.read_all("exchanged").iter().enumerate() {
            let box_of = core(&blocks[index]);
            let rows = |of: usize| -> Vec<usize> {
                let means = &before[of].gaussians.means;
                let wanted = |&row: &usize| {
                    in_core(&blocks[of], means[row]) && SceneBlock::contains(box_of, margin, means[row])
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
            assert!(match &wanted.moments {
                MomentState::F32([first, _]) => first.means.iter().flatten().any(|&x| x != 0.0),
                MomentState::Packed(words) => words.as_flattened().iter().any(|&word| word != 0),
            });
            assert_eq!(
                (wanted.iteration, wanted.optimizer_steps, wanted.due),
                (after.iteration, after.optimizer_steps, after.due)
            );
            let scene = place.gaussians("blocks/round_1.ply");
            let outside = |mean: &&[f32; 3]| !SceneBlock::contains(box_of, margin, **mean);
            let around = scene.means.iter().filter(outside).count();
            assert_eq!(after.block.expect("a block").frozen, around as u64);
        }

        // In any order, and from any checkpoint.
        let every = format!("{outside} --checkpoint-every 1 --start-checkpoint auto");
        for number in divided.numbers().rev() {
            divided.train(number, &every).ok().says(&["written to"]);
        }
        place.merge("scene.ply").ok();
        // A killed training leaves no note, and an earlier checkpoint.
        for (number, block) in (1..).zip(blocks).take(usize::from(outside.contains("masked"))) {
            let scene = scene_of(block);
            let good = place.read(&scene);
            let note = file_of(block, "block.json");
            place.remove(&note);
            place.remove(file_of(block, &format!("chkpnt{}.safetensors", block["iterations"])));
            place.remove(&scene);
            let stop = first_end(block) + 1;
            divided.train(number, &format!("{outside} --checkpoint-iterations {stop}")).ok();
            assert_eq!(place.read_text(file_of(block, "last_checkpoint")), format!("{stop}\n"));
            place.remove(&note);
            place.remove(&scene);
            divided.train(number, &every).ok();
            assert!(place.read(&scene) == good, "block {number}: other bytes");
        }
        place.merge("again.ply").ok();
        assert!(place.read("again.ply") == place.read("scene.ply"), "other bytes");
        divided.exchange("--round 2").refused(&["--round", "after the last of 2 rounds"]);
        assert!(place.gaussians("again.ply").len() > 100);
    }
}

#[test]
fn what_cannot_be_exchanged_is_refused() {
    let divided = Divided::new();
    let (place, blocks) = (&divided.place, &divided.blocks);
    let words = ["blocks.json", "round 1", "1, 2", "not trained to the end of the round"];
    divided.exchange("").refused(&words);
    // A refused exchange writes nothing.
    assert!(!place.has("blocks"));
    for number in 2..=blocks.len() {
        divided.train(number, "").ok();
    }
    let refused = |words: &[&str]| {
        let files = || {
            let mut files = place.files("");
            files.retain(|path| !path.ends_with(".exchange.lock"));
            files
        };
        let before = files();
        divided.exchange("").refused(words);
        assert_eq!(files(), before, "something was written");
    };
    refused(&["blocks.json", "1 not trained to the end of the round", "--job", "blocks.json:1"]);
    divided.train(1, "--lambda-dssim 0.3").ok();
    refused(&["block 2", "other settings than block 1", "lambda_dssim was 0.3, is 0.2"]);
    divided.train(1, "").ok();
    // Everything is valid except one file.
    let changed = |name: &str, change: &dyn Fn(&[u8]) -> Vec<u8>, words: &[&str]| {
        let good = place.read(name);
        place.write(name, change(&good));
        refused(words);
        place.write(name, good);
    };
    let round = file_of(&blocks[0], "round.json");
    for (name, value, words) in [
        ("blocks", Value::from("0"), "1 trained for another division"),
        ("block", 2.into(), "1 trained for another division"),
        ("iteration", 1.into(), "1 at the end of another round"),
    ] {
        let edited = |note: &[u8]| {
            let mut note: Value = serde_json::from_slice(note).expect("JSON");
            note[name] = value.clone();
            note.to_string().into_bytes()
        };
        changed(&round, &edited, &[words]);
    }
    changed(&round, &|_| b"{".to_vec(), &["1 not trained to the end of the round"]);
    let checkpoints = divided.checkpoints("chkpnt");
    let name = format!("chkpnt{}.safetensors", first_end(&blocks[0]));
    let flipped = |bytes: &[u8]| {
        let mut bytes = bytes.to_vec();
        let last = bytes.len() - 9;
        bytes[last] ^= 1;
        bytes
    };
    changed(&checkpoints[0], &flipped, &[&name, "damaged"]);
    changed(&checkpoints[0], &|bytes| bytes[..99].to_vec(), &[&name, "truncated"]);
    let others = |_: &[u8]| place.read(&checkpoints[1]);
    changed(&checkpoints[0], &others, &[&name, "is not that of iteration", "of block 1"]);
    place.rename(&checkpoints[0], "kept");
    refused(&["1 without the checkpoint of the round's end"]);
    place.rename("kept", &checkpoints[0]);
    // A round ends at its share of the division's iterations.
    divided.train(1, "--iterations 30").refused(&["--iterations", "share of the division's"]);
    divided.train(1, "--pose-opt").refused(&["pose_opt", "rounds"]);
    // A new division must not replace one whose blocks have been trained.
    let divide = |file: &str, rounds: &str| place.partition(file, &format!("--max-gaussians 300 {rounds}"));
    divide("blocks.json", "--rounds 3").refused(&["blocks have been trained", "another -o"]);
    divide("other.json", "--rounds 50").refused(&["block ", "too few for 50 rounds"]);
    divide("whole.json", "").ok();
    place.run("exchange @whole.json").refused(&["whole.json", "is of one round", "--rounds"]);
    assert!(!place.has("other.json") && !place.has("whole"));
    // A block must resume with the options that it ended with.
    divided.exchange("").ok();
    divided.train(1, "--outside masked").refused(&["other photographs or cameras"]);
}

#[test]
fn two_exchanges_at_once_are_refused() {
    let place = TestFolder::with_coarse_model();
    place.partition("blocks.json", "--max-gaussians 100000 --rounds 3").ok();
    // A single block is the whole scene: an exchange changes nothing.
    let train = || place.job(1, STRATEGY).ok();
    train();
    let held = super::merge::hold(&place, "blocks/.exchange.lock", "process 1");
    place.run("exchange @blocks.json").refused(&["another exchange (process 1)"]);
    drop(held);
    for _ in 0..2 {
        place.run("exchange @blocks.json").ok();
        train();
    }
    assert!(!place.has("blocks/round_1.ply"), "nothing goes on from there");
    place.merge("scene.ply").ok();
    let init = format!("--init @{}", point_cloud("coarse", 12));
    let plain = format!("{init} --eval --iterations 14 --few-photos off --sh-degree 1 {STRATEGY}");
    place.run(format!("train -s @data -m @whole --quiet {plain}")).ok();
    assert!(place.read("scene.ply") == place.ply("whole", 14), "other bits");
}
