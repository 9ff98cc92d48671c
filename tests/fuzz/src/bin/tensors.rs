//! Checkpoints with a header whose shapes, offsets and settings do not fit the tensors.
#![no_main]

use arbitrary::Arbitrary;
use ashsplat::train::checkpoint::Checkpoint;
use ashsplat_files::CheckpointFile;
use ashsplat_fuzz::hostile::{Change, Filling, MAX_BYTES, Number, Patch, safetensors};
use ashsplat_fuzz::{checkpoint, folder, gaussians, in_one_line, within};
use libfuzzer_sys::fuzz_target;
use serde_json::Value;
use std::path::PathBuf;
use std::sync::LazyLock;

static FILE: LazyLock<PathBuf> = LazyLock::new(|| folder("tensors").join("input.safetensors"));

#[derive(Arbitrary, Debug)]
struct Tensors {
    count: u16,
    degree: u8,
    changes: Vec<Change>,
    /// Bytes after the tensors.
    more: Option<Filling>,
    cut: Option<u16>,
    header: Number,
    patches: Vec<Patch>,
}

impl Tensors {
    fn file(&self) -> Vec<u8> {
        let sh_degree = u32::from(self.degree % 4);
        let gaussians = gaussians(usize::from(self.count % 1500) + 1, sh_degree);
        let checkpoint = checkpoint(gaussians, sh_degree);
        checkpoint.write(&*FILE).expect("written");
        let honest = std::fs::read(&*FILE).expect("there");
        let length = u64::from_le_bytes(honest[..8].try_into().expect("eight")) as usize;
        let header: Value = serde_json::from_slice(&honest[8..8 + length]).expect("JSON");
        let more = self.more.map_or(Vec::new(), |filling| filling.bytes(MAX_BYTES));
        let tensors = [&honest[8 + length..], &more].concat();
        safetensors((header, &self.changes), &tensors, (self.header, self.cut, &self.patches))
    }
}

fuzz_target!(|tensors: Tensors| {
    let bytes = tensors.file();
    std::fs::write(&*FILE, &bytes).expect("written");
    within(bytes.len(), |_| {
        if let Some(checkpoint) = in_one_line(Checkpoint::read(&*FILE)) {
            checkpoint.write(&*FILE).expect("written");
            assert_eq!(Checkpoint::read(&*FILE).expect("its own").fingerprint(), checkpoint.fingerprint());
        }
    });
});
