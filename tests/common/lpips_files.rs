//! Files of LPIPS weights, computed by a formula.

use crate::reference::lpips::{ALEXNET, Step, VGG16, formula};
use std::path::Path;

#[derive(Clone, Debug)]
pub struct Tensor {
    pub name: String,
    /// F32, or another kind that the header claims.
    pub kind: &'static str,
    pub shape: Vec<usize>,
    pub values: Vec<f32>,
}

impl Tensor {
    pub fn new(name: &str, shape: &[usize], values: Vec<f32>) -> Tensor {
        Tensor { name: name.into(), kind: "F32", shape: shape.to_vec(), values }
    }
}

/// Weights of AlexNet and its heads. The formula's tags begin at `tag`.
pub fn alexnet(tag: u32) -> Vec<Tensor> {
    tensors(&ALEXNET, &[0, 3, 6, 8, 10], tag)
}

/// Weights of VGG16 and its heads. The formula's tags begin at `tag`.
pub fn vgg16(tag: u32) -> Vec<Tensor> {
    tensors(&VGG16, &[0, 2, 5, 7, 10, 12, 14, 17, 19, 21, 24, 26, 28], tag)
}

fn tensors(steps: &[Step], indices: &[usize], tag: u32) -> Vec<Tensor> {
    let weights = formula(steps, tag);
    let sizes = steps.iter().filter_map(|step| match step {
        Step::Convolve(_, window) => Some(window.size),
        _ => None,
    });
    let mut tensors = vec![];
    for ((index, size), (own, biases)) in indices.iter().zip(sizes).zip(weights.convolutions) {
        let inputs = own.len() / (biases.len() * size * size);
        tensors.push(Tensor::new(&format!("net.{index}.weight"), &[biases.len(), inputs, size, size], own));
        tensors.push(Tensor::new(&format!("net.{index}.bias"), &[biases.len()], biases));
    }
    for (k, head) in weights.heads.into_iter().enumerate() {
        tensors.push(Tensor::new(&format!("lin{k}.model.1.weight"), &[1, head.len(), 1, 1], head));
    }
    tensors
}

pub fn write(path: &Path, tensors: &[Tensor]) {
    let mut header = serde_json::Map::new();
    let mut data: Vec<u8> = vec![];
    for tensor in tensors {
        let begin = data.len();
        data.extend(tensor.values.iter().flat_map(|value| value.to_le_bytes()));
        let entry = serde_json::json!({"dtype": tensor.kind, "shape": tensor.shape, "data_offsets": [begin, data.len()]});
        header.insert(tensor.name.clone(), entry);
    }
    let header = serde_json::Value::Object(header).to_string().into_bytes();
    let mut bytes = (header.len() as u64).to_le_bytes().to_vec();
    bytes.extend(header);
    bytes.extend(data);
    std::fs::write(path, bytes).expect("written");
}
