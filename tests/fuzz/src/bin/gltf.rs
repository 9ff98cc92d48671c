//! GLB and glTF with counts, offsets and lengths that do not fit the data.
#![no_main]

use arbitrary::Arbitrary;
use ashsplat_files::splats::{self, WriteOptions};
use ashsplat_fuzz::hostile::{Change, Filling, MAX_BYTES, Number, Patch, patch, spoil};
use ashsplat_fuzz::{check_gaussians, folder, gaussians};
use libfuzzer_sys::fuzz_target;
use serde_json::Value;
use std::path::PathBuf;
use std::sync::LazyLock;

/// Length of a file with a repeated node, bytes.
const LONG: usize = 8 << 20;

static FOLDER: LazyLock<PathBuf> = LazyLock::new(|| folder("gltf"));

#[derive(Arbitrary, Debug)]
struct Gltf {
    count: u16,
    degree: u8,
    changes: Vec<Change>,
    /// Replaces the buffer's bytes.
    buffer: Option<Filling>,
    lengths: [Number; 3],
    chunks: Vec<(u8, Filling)>,
    patches: Vec<Patch>,
    /// Plain text, with its buffers in a file beside it.
    text: bool,
    /// Repeats this node until the JSON is 8 MiB long.
    node: Option<Node>,
}

#[derive(Arbitrary, Debug)]
struct Node {
    mesh: Option<u8>,
    children: Vec<u32>,
    unused: bool,
}

impl Node {
    /// A glTF's text with this node repeated.
    fn repeated(&self, text: &str) -> Vec<u8> {
        let keys = [
            self.mesh.map(|mesh| format!("\"mesh\":{mesh}")),
            (!self.children.is_empty()).then(|| format!("\"children\":{:?}", self.children)),
            self.unused.then(|| "\"extras\":[{}]".to_owned()),
        ];
        let node = format!("{{{}}},", keys.into_iter().flatten().collect::<Vec<_>>().join(","));
        format!("{{\"nodes\":[{}{{}}],{}", node.repeat(LONG / node.len()), &text[1..]).into_bytes()
    }
}

fn number(bytes: &[u8], at: usize) -> usize {
    u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]) as usize
}

impl Gltf {
    fn file(&self) -> Vec<u8> {
        let path = FOLDER.join("honest.glb");
        let some = gaussians(usize::from(self.count % 500) + 1, u32::from(self.degree % 4));
        splats::write(&path, &some, &WriteOptions::default()).expect("written");
        let honest = std::fs::read(&path).expect("there");
        let length = number(&honest, 12);
        let mut json: Value = serde_json::from_slice(&honest[20..20 + length]).expect("JSON");
        spoil(&mut json, &self.changes);
        let mut text = match (&self.node, json.as_object_mut()) {
            (Some(node), Some(file)) => {
                file.remove("nodes");
                node.repeated(&json.to_string())
            }
            _ => json.to_string().into_bytes(),
        };
        if self.text {
            patch(&mut text, &self.patches);
            return text;
        }
        text.resize(text.len().next_multiple_of(4), b' ');
        let buffer = &honest[20 + length + 8..];
        let mut buffer = self.buffer.map_or(buffer.to_vec(), |filling| filling.bytes(MAX_BYTES));
        buffer.resize(buffer.len().next_multiple_of(4), 0);
        let mut chunks = vec![(*b"JSON", text), (*b"BIN\0", buffer)];
        for (kind, filling) in self.chunks.iter().take(3) {
            let mut bytes = filling.bytes(MAX_BYTES / 4);
            bytes.resize(bytes.len().next_multiple_of(4), 0);
            chunks.push(([*b"JSON", *b"BIN\0", *b"more"][usize::from(kind % 3)], bytes));
        }
        let all: usize = 12 + chunks.iter().map(|(_, bytes)| 8 + bytes.len()).sum::<usize>();
        let mut file = b"glTF\x02\0\0\0".to_vec();
        file.extend((self.lengths[0].of(all as u64) as u32).to_le_bytes());
        for (index, (kind, bytes)) in chunks.iter().enumerate() {
            let claimed =
                self.lengths.get(index + 1).map_or(bytes.len() as u64, |n| n.of(bytes.len() as u64));
            file.extend((claimed as u32).to_le_bytes());
            file.extend(kind);
            file.extend(bytes);
        }
        patch(&mut file, &self.patches);
        file
    }
}

fuzz_target!(|gltf: Gltf| {
    let bytes = gltf.file();
    let path = FOLDER.join(if gltf.text { "input.gltf" } else { "input.glb" });
    check_gaussians(&path, &bytes);
});
