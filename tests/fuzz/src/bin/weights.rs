//! Weights of LPIPS: the first layers of a network, with wrong names, shapes, types and offsets.
#![no_main]

use arbitrary::Arbitrary;
use ashsplat::passes::lpips::Network;
use ashsplat_files::{HostMemory, lpips_weights};
use ashsplat_fuzz::hostile::{Change, Filling, MAX_BYTES, Number, Patch, safetensors};
use ashsplat_fuzz::{folder, in_one_line, within};
use libfuzzer_sys::fuzz_target;
use serde_json::{Map, Value, json};
use std::path::PathBuf;
use std::sync::LazyLock;

static FILE: LazyLock<PathBuf> = LazyLock::new(|| folder("weights").join("input.safetensors"));

#[derive(Arbitrary, Debug)]
struct File {
    vgg: bool,
    /// Number of layers.
    layers: u8,
    /// Index of the naming scheme.
    names: u8,
    /// Kind of a tensor that is not F32.
    other_kind: Option<u8>,
    others: Vec<(u8, u8)>,
    filling: Filling,
    changes: Vec<Change>,
    cut: Option<u16>,
    header: Number,
    patches: Vec<Patch>,
}

impl File {
    fn bytes(&self) -> Vec<u8> {
        let network = if self.vgg { Network::Vgg16 } else { Network::AlexNet };
        let prefix = ["net", "features", "net.slice1", "net.slice300"][usize::from(self.names % 4)];
        let (mut header, mut end) = (Map::new(), 0);
        let mut tensor = |name: String, shape: &[u32]| {
            let bytes = shape.iter().fold(4, |bytes, &side| bytes * side as usize);
            if end + bytes > MAX_BYTES {
                return;
            }
            let kinds = ["I32", "F16", "F64", "BOOL", "none"];
            let kind = match self.other_kind {
                Some(kind) if usize::from(kind) % 16 == header.len() => kinds[usize::from(kind / 16) % 5],
                _ => "F32",
            };
            header.insert(name, json!({"dtype": kind, "shape": shape, "data_offsets": [end, end + bytes]}));
            end += bytes;
        };
        for layer in network.convolutions().take(usize::from(self.layers % 16)) {
            let shape = [layer.outputs, layer.inputs, layer.size, layer.size];
            tensor(format!("{prefix}.{}.weight", layer.index), &shape);
            tensor(format!("{prefix}.{}.bias", layer.index), &shape[..1]);
        }
        for (k, tap) in network.taps().enumerate().take(usize::from(self.layers / 16)) {
            tensor(format!("lin{k}.model.1.weight"), &[1, tap.outputs, 1, 1]);
        }
        for (name, index) in self.others.iter().take(64) {
            let of = ["net", "features", "net.slice2"][usize::from(name % 3)];
            tensor(format!("{of}.{}.{}", index % 32, ["weight", "bias"][usize::from(name / 3) % 2]), &[1]);
        }
        let (header, tensors) = (Value::Object(header), self.filling.exactly(end));
        safetensors((header, &self.changes), &tensors, (self.header, self.cut, &self.patches))
    }
}

fuzz_target!(|file: File| {
    let bytes = file.bytes();
    std::fs::write(&*FILE, &bytes).expect("written");
    within(bytes.len(), |bound| {
        // None is complete: the smaller network has 10 MB.
        assert!(in_one_line(lpips_weights::read(&*FILE, &HostMemory::new(bound))).is_none());
    });
});
