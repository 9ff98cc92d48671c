//! Weight files of LPIPS: safetensors with the tensors of a network and of the heads, under PyTorch's names.

use std::path::Path;

use safetensors::{Dtype, SafeTensors};

use crate::host_memory::HostMemory;
use crate::regular_file;
use ashsplat::passes::lpips::{Layer, Network, Weights};
use ashsplat::{Error, Result};

const REMEDY: &str =
    "give the weights of LPIPS 0.1 with AlexNet or VGG16, as tools/lpips_weights.py writes them";

/// No weight of a trained network is as large. A damaged weight may be, and would make LPIPS 0 or NaN.
const LARGEST: f32 = 1000.0;

/// Reads the weights of a network and of the heads of LPIPS. The tensor shapes identify the network.
///
/// All tensors are F32, in PyTorch's order. With N the index of a convolution in torchvision's `features`:
/// - `net.N.weight` `[outputs, inputs, size, size]` and `net.N.bias` `[outputs]`; `features.N` or lpips' `net.sliceK.N`
///   may replace `net.N`,
/// - `linK.model.1.weight` [1, channels, 1, 1], K from 0 to 4.
///
/// Other tensors are ignored.
pub fn read(path: impl AsRef<Path>, memory: &HostMemory) -> Result<Weights> {
    let path = path.as_ref();
    // Twice the file: its bytes, and the weights made of them.
    let (bytes, _lease) = regular_file::read_within(path, 2, memory)?;
    parse(&bytes).map_err(|problem| Error::input(path, problem, REMEDY))
}

fn parse(bytes: &[u8]) -> Result<Weights, String> {
    let tensors = SafeTensors::deserialize(bytes)
        .map_err(|e| format!("is truncated or no safetensors file ({} bytes): {e}", bytes.len()))?;
    let network = network_of(&tensors)?;
    let convolution = |layer: &Layer| {
        let Layer { index, inputs, outputs, size, .. } = *layer;
        let of = |part: &str, shape: &[u32]| {
            let name = named(&tensors, index, part)?.ok_or_else(|| missing(index, part, network))?;
            values(&tensors, &name, shape, network)
        };
        let weights = of("weight", &[outputs, inputs, size, size])?;
        refuse_zeros(&weights, || format!("of convolution {index}"))?;
        Ok((weights, of("bias", &[outputs])?))
    };
    let convolutions = network.convolutions().map(convolution).collect::<Result<_, String>>()?;
    let head = |(k, tap): (usize, &Layer)| {
        let name = format!("lin{k}.model.1.weight");
        if tensors.tensor(&name).is_err() {
            return Err(format!("lacks the tensor '{name}': LPIPS with {} has five", network.name()));
        }
        let weights = values(&tensors, &name, &[1, tap.outputs, 1, 1], network)?;
        refuse_zeros(&weights, || format!("'{name}'"))?;
        // Section 3 of LPIPS: the result is a distance, so training keeps the weights from being negative.
        match weights.iter().position(|&weight| weight < 0.0) {
            Some(at) => Err(format!(
                "tensor '{name}': value {at} is {}, no head of LPIPS has one below 0",
                weights[at]
            )),
            None => Ok(weights),
        }
    };
    let heads = network.taps().enumerate().map(head).collect::<Result<_, String>>()?;
    Ok(Weights { network, convolutions, heads })
}

/// Refuses weights that make LPIPS the same for all pictures.
fn refuse_zeros(weights: &[f32], which: impl Fn() -> String) -> Result<(), String> {
    match weights.iter().all(|&weight| weight == 0.0) {
        true => Err(format!("the weights {} are all 0, those of no trained network are", which())),
        false => Ok(()),
    }
}

/// The network, by the file's first convolution.
fn network_of(tensors: &SafeTensors) -> Result<Network, String> {
    let Some(name) = named(tensors, 0, "weight")? else {
        return Err("lacks the tensor 'net.0.weight' (or 'features.0.weight') of a network".into());
    };
    let shape = tensors.tensor(&name).map_err(|e| e.to_string())?.shape().to_vec();
    let first = |network: Network| {
        let layer = network.layers()[0];
        [layer.outputs, layer.inputs, layer.size, layer.size].map(|n| n as usize)
    };
    let found = Network::ALL.into_iter().find(|&network| shape == first(network));
    found.ok_or_else(|| {
        let of = |network: Network| format!("{:?} of {}", first(network), network.name());
        format!("has a tensor '{name}' of {shape:?}, not {}", Network::ALL.map(of).join(" or "))
    })
}

/// The name of a convolution's tensor in the file.
fn named(tensors: &SafeTensors, index: u32, part: &str) -> Result<Option<String>, String> {
    let end = format!(".{index}.{part}");
    let is_one = |name: &&str| match name.strip_suffix(&end) {
        Some("net" | "features") => true,
        Some(start) => start.strip_prefix("net.slice").is_some_and(|k| k.parse::<u8>().is_ok()),
        None => false,
    };
    let mut found: Vec<&str> = tensors.names().into_iter().filter(is_one).collect();
    found.sort_unstable();
    match found[..] {
        [] => Ok(None),
        [name] => Ok(Some(name.to_owned())),
        [one, other, ..] => Err(format!("has the tensor '{one}' also as '{other}'")),
    }
}

fn missing(index: u32, part: &str, network: Network) -> String {
    format!("lacks the tensor 'net.{index}.{part}': these are not the weights of {}", network.name())
}

fn values(tensors: &SafeTensors, name: &str, shape: &[u32], network: Network) -> Result<Vec<f32>, String> {
    let tensor = tensors.tensor(name).map_err(|e| e.to_string())?;
    let wanted: Vec<usize> = shape.iter().map(|&n| n as usize).collect();
    if tensor.dtype() != Dtype::F32 || tensor.shape() != wanted {
        let (kind, has) = (tensor.dtype(), tensor.shape());
        return Err(format!(
            "has a tensor '{name}' of {kind:?} {has:?}, {} has F32 {wanted:?}",
            network.name()
        ));
    }
    let values: Vec<f32> = bytemuck::pod_collect_to_vec(tensor.data());
    match values.iter().position(|value| value.is_nan() || value.abs() > LARGEST) {
        Some(at) => {
            Err(format!("tensor '{name}': value {at} is {:e}, more than any network has", values[at]))
        }
        None => Ok(values),
    }
}
