//! Small files that would take a stack, hours or all memory: each must be refused in one line.

use crate::data;
use crate::program::{Limits, Program};
use crate::siege::{Outcome, Result, Siege, ensure, text};
use serde_json::{Value, json};
use std::io::Write;
use std::path::Path;
use std::time::Duration;

/// Longest that a refusal may take.
const LONGEST: Duration = Duration::from_secs(20);
/// Memory that one may take, MiB.
const MOST_MEMORY: u64 = 600;

fn deep_name() -> String {
    "a/".repeat(100_000) + "x.png"
}

/// A command that must refuse.
fn refuse(siege: &Siege, arguments: &[&str]) -> Result<()> {
    let mut program = Program::start(&siege.program, &Limits::default(), &siege.peak, arguments)?;
    program.end(LONGEST)?.check_refused()
}

/// Training on a data set, which must be refused and leave nothing.
fn refuse_to_train(siege: &Siege, data: &Path) -> Result<Outcome> {
    let model = siege.place("refused");
    refuse(siege, &["train", "-s", text(data)?, "-m", text(&model)?, "--iterations", "1", "--quiet"])?;
    ensure!(!model.exists(), "the model folder was made all the same");
    within_memory(siege, "refused in one line")
}

fn within_memory(siege: &Siege, said: &str) -> Result<Outcome> {
    let peak = siege.peak.mib();
    ensure!(peak < MOST_MEMORY, "takes {peak} MiB");
    Ok(Outcome::Withstood(said.into()))
}

fn transforms(siege: &Siege, frame: Value) -> Result<Outcome> {
    let folder = siege.new_folder("deep")?;
    std::fs::create_dir(folder.join("images"))?;
    image::RgbImage::new(16, 16).save(folder.join("images/0.png"))?;
    data::write_transforms(&folder, 16, &[frame])?;
    refuse_to_train(siege, &folder)
}

pub fn photo_path(siege: &Siege) -> Result<Outcome> {
    transforms(siege, json!({ "file_path": deep_name() }))
}

pub fn mask_path(siege: &Siege) -> Result<Outcome> {
    transforms(siege, json!({ "file_path": "images/0.png", "mask_path": deep_name() }))
}

pub fn colmap_names(siege: &Siege) -> Result<Outcome> {
    let folder = siege.new_folder("deep")?;
    data::write_small(&folder)?;
    let images = folder.join("sparse/0/images.txt");
    let deep = std::fs::read_to_string(&images)?.replace("0.png", &deep_name());
    std::fs::write(images, deep)?;
    refuse_to_train(siege, &folder)
}

pub fn deep_json(siege: &Siege) -> Result<Outcome> {
    let folder = siege.new_folder("deep")?;
    std::fs::write(folder.join("transforms.json"), "[".repeat(100_000))?;
    refuse_to_train(siege, &folder)
}

/// Lists of millions of values that no reader uses.
pub fn wide_json(siege: &Siege) -> Result<Outcome> {
    const BYTES: usize = 16 << 20;
    let folder = siege.new_folder("wide")?;
    let list = |value: &str| format!("[{}{value}]", format!("{value},").repeat(BYTES / (value.len() + 1)));
    let frames = "[{\"file_path\": \"none.png\"}]";
    let cameras = format!("{{\"x\": {}, \"fl_x\": 9, \"frames\": {frames}}}", list("{\"\":0}"));
    std::fs::write(folder.join("transforms.json"), cameras)?;
    refuse_to_train(siege, &folder)?;
    let files = [
        ("nodes.gltf", "info", format!("{{\"nodes\": {}}}", list("{}"))),
        ("blocks.json", "blocks", format!("{{\"version\": 1, \"blocks\": {}}}", list("{}"))),
    ];
    for (name, command, text_of) in files {
        let path = folder.join(name);
        std::fs::write(&path, text_of)?;
        refuse(siege, &[command, text(&path)?])?;
    }
    within_memory(siege, "each refused in one line")
}

/// A pipe without a writer, and a device without an end, in the place of files.
pub fn no_files(siege: &Siege) -> Result<Outcome> {
    let folder = siege.new_folder("pipes")?;
    data::write_small(&folder)?;
    let (pipe, model) = (folder.join("pipe"), siege.place("refused"));
    rustix::fs::mkfifoat(rustix::fs::CWD, &pipe, rustix::fs::Mode::RWXU)?;
    for file in [text(&pipe)?, "/dev/zero"] {
        for command in ["info", "blocks"] {
            refuse(siege, &[command, file])?;
        }
        for option in ["--config", "--start-checkpoint"] {
            refuse(siege, &["train", "-s", text(&folder)?, "-m", text(&model)?, option, file])?;
        }
    }
    within_memory(siege, "each refused in one line")
}

pub fn claims(siege: &Siege) -> Result<Outcome> {
    let folder = siege.new_folder("bombs")?;
    std::fs::create_dir(folder.join("images"))?;
    std::fs::write(folder.join("images/0.png"), data::png_bomb(60_000))?;
    data::write_transforms(&folder, 60_000, &[json!({ "file_path": "images/0.png" })])?;
    refuse_to_train(siege, &folder)?;
    let ply = folder.join("claims.ply");
    std::fs::write(&ply, data::ply_header(4_000_000_000))?;
    refuse(siege, &["info", text(&ply)?])?;
    // Ten Gaussians, and then zeros that nobody has asked for, packed to almost nothing.
    let spz = folder.join("bomb.spz");
    let header =
        [&0x5053_474e_u32.to_le_bytes()[..], &2_u32.to_le_bytes(), &10_u32.to_le_bytes(), &[0, 12, 0, 0]];
    let mut packed = flate2::write::GzEncoder::new(std::fs::File::create(&spz)?, flate2::Compression::fast());
    packed.write_all(&header.concat())?;
    let zeros = vec![0; 1 << 20];
    for _ in 0..siege.choose(100, 1000) {
        packed.write_all(&zeros)?;
    }
    packed.finish()?;
    refuse(siege, &["info", text(&spz)?])?;
    within_memory(siege, "each refused in one line")
}
