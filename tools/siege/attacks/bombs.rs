//! Files that would exhaust all memory, or are damaged: each must be refused in one line.

use crate::data;
use crate::page::{self, Page};
use crate::program::Program;
use crate::siege::{Result, Siege, ensure, text};
use crate::training;
use serde_json::{Value, json};
use std::time::Duration;

const LONGEST: Duration = Duration::from_secs(20);
/// Most memory of a refusal, MiB.
const MAX_MEMORY: u64 = 600;

/// Runs a command that must refuse, and returns its message.
fn refuse(siege: &Siege, arguments: &[&str]) -> Result<String> {
    let ending = Program::start(siege, arguments)?.end(LONGEST)?;
    ending.check_refused().map(|()| ending.errors)
}

/// The result of an attack that took less than `limit` MiB.
fn within(siege: &Siege, limit: u64, message: &str) -> Result<String> {
    let peak = siege.peak_mib();
    ensure!(peak < limit, "takes {peak} MiB");
    Ok(message.into())
}

/// JSON files of 64 MiB beyond `--max-host-memory`.
pub fn bounded_json(siege: &Siege) -> Result<String> {
    /// MiB; the program itself needs two thirds of it.
    const MAX_MIB: u64 = 120;
    let folder = siege.new_folder("bounded")?;
    data::write_small(&folder)?;
    let [tiles, blocks, model] = ["tileset.json", "blocks.json", "refused"].map(|name| folder.join(name));
    let spaces = vec![b' '; 64 << 20];
    for name in ["transforms/transforms.json", "tileset.json", "blocks.json", "cameras.json"] {
        let path = folder.join(name);
        std::fs::create_dir_all(path.parent().unwrap_or(&folder))?;
        std::fs::write(&path, &spaces)?;
    }
    let (data, cameras) = (folder.join("transforms"), folder.join("cameras.json"));
    training::undisturbed(siege)?;
    let ply = training::result_of(&siege.place("undisturbed"));
    let job = format!("{}:1", text(&blocks)?);
    let commands: [&[&str]; 5] = [
        &["train", "-s", text(&data)?, "-m", text(&model)?],
        &["info", text(&tiles)?],
        &["blocks", text(&blocks)?],
        &["train", "--job", &job],
        &["render", text(&ply)?, "--path", text(&cameras)?, "-o", text(&model)?],
    ];
    for command in commands {
        let message = refuse(siege, &[command, &["--max-host-memory", "16M"]].concat())?;
        ensure!(message.contains("more than 16777216 (--max-host-memory)"), "{command:?}: {message}");
    }
    within(siege, MAX_MIB, "each refused by the option's name")
}

/// A page sends a GLB whose JSON takes far more memory than its file.
pub fn upload(siege: &Siege) -> Result<String> {
    const BYTES: usize = 60 << 20;
    const BOUND: u64 = 100;
    let list = "{},".repeat(BYTES / 3);
    let json = format!("{{\"asset\": {{\"version\": \"2.0\"}}, \"nodes\": [{list}{{}}]}}");
    let json = format!("{json}{}", " ".repeat(json.len().next_multiple_of(4) - json.len()));
    let length = json.len() as u32;
    let head =
        [&b"glTF"[..], &2_u32.to_le_bytes(), &(20 + length).to_le_bytes(), &length.to_le_bytes(), b"JSON"]
            .concat();
    let glb = [&head, json.as_bytes()].concat();
    drop((list, json));
    let bound = format!("{BOUND}M");
    let arguments = ["view", "--port", "0", "--max-host-memory", &bound];
    let mut program = Program::start(siege, &arguments)?;
    let host = program.host()?;
    let mut page = Page::open(&host)?;
    let before = program.memory();
    page::post(&host, "/upload/wide.glb", &glb, LONGEST)?;
    let loading = page.until_message("loading", |message| message["failed"].is_string())?;
    let failed = loading["failed"].as_str().unwrap_or_default();
    ensure!(failed.contains("--max-host-memory"), "{failed}");
    let more = siege.peak_mib().saturating_sub(before);
    ensure!(more <= BOUND, "takes {more} MiB more, --max-host-memory {bound}");
    Ok(format!("{more} MiB more of {BOUND}; the page is told the option"))
}

/// A valid blocks.json in which one value at a time is replaced: each is read or refused.
pub fn damaged_blocks(siege: &Siege) -> Result<String> {
    let block = |number: u32, core: Value| {
        json!({
            "number": number, "core": core, "gaussians": 9, "trained": 9, "iterations": 9, "photos": ["0.png"],
            "folder": format!("block_{number}"), "held_out": [], "pixels": 9,
        })
    };
    let sound = json!({
        "version": 1, "origin": [5e6, 0, 0], "unit": 0.1, "scene_extent": 2, "margin": 0.5, "min_share": 0.1,
        "max_gaussians": 9, "iterations": 9, "rounds": 2, "coarse": { "path": "a.ply", "hash": "0", "gaussians": 9 },
        "dataset": {
            "path": "data", "cameras": "0", "images": "images", "resolution": 1, "orientation": "auto", "undistort": false,
            "alpha": "target", "level": "off", "eval": true,
        },
        "blocks": [
            block(1, json!({ "min": [null, null, null], "max": [0, null, null] })),
            block(2, json!({ "min": [0, null, null], "max": [null, null, null] })),
        ],
    });
    let path = siege.new_folder("damaged")?.join("blocks.json");
    let read = |json: &str| {
        std::fs::write(&path, json)?;
        Program::start(siege, &["blocks", text(&path)?])?.end(LONGEST)
    };
    let ending = read(&sound.to_string())?;
    ensure!(ending.code == Some(0), "the sound one is refused: {ending}");
    let others = ["-1", "0", "1e300", "18446744073709551615", "null", "\"../../x\"", "[[]]", "{\"min\": 9}"];
    let (mut open, mut places) = (vec![String::new()], Vec::new());
    while let Some(place) = open.pop() {
        let below: Vec<String> = match sound.pointer(&place) {
            Some(Value::Object(object)) => object.keys().cloned().collect(),
            Some(Value::Array(list)) => (0..list.len()).map(|index| index.to_string()).collect(),
            _ => Vec::new(),
        };
        open.extend(below.iter().map(|name| format!("{place}/{name}")));
        places.push(place);
    }
    let (mut refused, mut taken) = (0, 0);
    let damages = places.iter().flat_map(|place| others.iter().map(move |other| (place, other)));
    for (place, other) in damages.step_by(siege.choose(5, 1)) {
        let mut damaged = sound.clone();
        damaged.pointer_mut(place).ok_or("no such place")?.clone_from(&serde_json::from_str(other)?);
        let ending = read(&damaged.to_string())?;
        if ending.code == Some(0) {
            taken += 1;
        } else {
            ending.check_refused().map_err(|error| format!("{place} {other}: {error}"))?;
            refused += 1;
        }
    }
    within(siege, MAX_MEMORY, &format!("{refused} refused in one line, {taken} read"))
}
