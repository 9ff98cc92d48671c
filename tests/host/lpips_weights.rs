//! Files of tensors: the weights of LPIPS, and damaged checkpoints.

use super::files::{Folder, for_each_mutation};
use crate::common::lpips_files::{Tensor, alexnet, write};
use crate::reference::lpips::{ALEXNET, formula};
use ashsplat::passes::lpips::{Network, Weights};
use ashsplat::train::Checkpoint;
use ashsplat_files::{CheckpointFile, HostMemory, lpips_weights};
use std::path::{Path, PathBuf};

fn read(path: &Path) -> Result<Weights, String> {
    lpips_weights::read(path, &HostMemory::default()).map_err(|e| e.to_string())
}

fn file(folder: &Path, tensors: &[Tensor]) -> PathBuf {
    let path = folder.join("weights.safetensors");
    write(&path, tensors);
    path
}

#[test]
fn lpips_weights_are_read_under_all_their_names() {
    let folder = Folder::new();
    let expected = formula(&ALEXNET, 7);
    for prefix in ["net.", "features.", "net.slice3."] {
        let mut tensors = alexnet(7);
        for tensor in &mut tensors {
            tensor.name = tensor.name.replace("net.", prefix);
        }
        // Other tensors of the file do not matter.
        tensors.push(Tensor::new("scaling_layer.shift", &[1, 3, 1, 1], vec![0.5; 3]));
        let weights = read(&file(&folder, &tensors)).expect("weights");
        assert_eq!(weights.network, Network::AlexNet);
        assert!(weights.convolutions == expected.convolutions && weights.heads == expected.heads, "{prefix}");
    }
}

/// Each bad file has an error with these words.
#[test]
fn lpips_weights_that_are_no_such_are_named() {
    let folder = Folder::new();
    let check = |spoil: &dyn Fn(&mut Vec<Tensor>), words: &[&str]| {
        let mut tensors = alexnet(0);
        spoil(&mut tensors);
        let message = read(&file(&folder, &tensors)).expect_err("refused");
        for word in words.iter().chain(&["weights.safetensors: ", "tools/lpips_weights.py"]) {
            assert!(message.contains(word), "no '{word}' in: {message}");
        }
        assert!(!message.contains('\n'));
    };
    let at = |tensors: &[Tensor], name: &str| tensors.iter().position(|t| t.name == name).expect("there");
    let of = |name: &'static str, change: fn(&mut Tensor)| {
        move |tensors: &mut Vec<Tensor>| {
            let place = at(tensors, name);
            change(&mut tensors[place]);
        }
    };
    check(&|tensors| drop(tensors.remove(at(tensors, "net.6.bias"))), &["lacks", "'net.6.bias'", "AlexNet"]);
    check(&|tensors| drop(tensors.remove(at(tensors, "lin3.model.1.weight"))), &["'lin3.model.1.weight'"]);
    check(&|tensors| tensors.retain(|t| t.name.starts_with("lin")), &["lacks", "'net.0.weight'"]);
    check(
        &|tensors| tensors.push(Tensor::new("features.3.bias", &[192], vec![0.0; 192])),
        &["'features.3.bias'", "'net.3.bias'"],
    );
    // Heads of the other network.
    check(
        &of("lin1.model.1.weight", |t| *t = Tensor::new(&t.name, &[1, 128, 1, 1], vec![0.0; 128])),
        &["'lin1.model.1.weight'", "[1, 128, 1, 1]", "[1, 192, 1, 1]"],
    );
    // Other networks: SqueezeNet begins like VGG16, ResNet like neither.
    check(
        &of("net.0.weight", |t| *t = Tensor::new(&t.name, &[64, 3, 3, 3], vec![0.1; 1728])),
        &["'net.2.weight'", "not the weights of VGG16"],
    );
    check(
        &of("net.0.weight", |t| *t = Tensor::new(&t.name, &[64, 3, 7, 7], vec![0.0; 64 * 147])),
        &["[64, 3, 7, 7]", "[64, 3, 11, 11] of AlexNet", "[64, 3, 3, 3] of VGG16"],
    );
    check(&of("net.8.bias", |t| t.values[17] = f32::NAN), &["'net.8.bias': value 17 is NaN"]);
    check(
        &of("net.3.weight", |t| t.values[2] = 2e20),
        &["tensor 'net.3.weight': value 2 is 2e20, more than any network has"],
    );
    check(
        &of("lin4.model.1.weight", |t| t.values[2] = -0.25),
        &["tensor 'lin4.model.1.weight': value 2 is -0.25, no head of LPIPS has one below 0"],
    );
    check(&of("net.8.weight", |t| t.values.fill(0.0)), &["of convolution 8 are all 0"]);
    check(&of("lin2.model.1.weight", |t| t.values.fill(0.0)), &["'lin2.model.1.weight' are all 0"]);
    check(&of("net.8.bias", |t| t.kind = "I32"), &["'net.8.bias' of I32 [256]"]);
}

#[test]
fn lpips_weights_of_no_file_and_of_half_a_file() {
    let folder = Folder::new();
    let message = read(&folder.join("none.safetensors")).expect_err("nothing there");
    assert!(message.contains("none.safetensors") && message.contains("cannot read"), "{message}");
    let path = file(&folder, &alexnet(0));
    let bytes = std::fs::read(&path).expect("a file");
    for length in [0, 7, 9, bytes.len() / 2, bytes.len() - 1] {
        std::fs::write(&path, &bytes[..length]).expect("written");
        let message = read(&path).expect_err("refused");
        assert!(message.contains("truncated"), "{length}: {message}");
    }
    std::fs::write(&path, &bytes).expect("written");
    let few = lpips_weights::read(&path, &HostMemory::new(1 << 20)).expect_err("too large").to_string();
    assert!(few.contains("--max-host-memory"), "{few}");
}

#[test]
fn damaged_safetensors_are_refused() {
    let (_folder, path) = Folder::with("a.safetensors");
    let header = br#"{"__metadata__":{"format":"ashsplat-checkpoint/3"},"means":{"dtype":"F32","shape":[1,3],"data_offsets":[0,12]}}"#;
    let bytes = [&(header.len() as u64).to_le_bytes(), header.as_slice(), &[0; 12]].concat();
    for_each_mutation(&path, &bytes, || {
        let message = Checkpoint::read(&path).expect_err("no checkpoint").to_string();
        assert!(!message.contains('\n'), "{message}");
    });
}
