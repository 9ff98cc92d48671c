//! LPIPS with weights by a formula: the device against the vectors.

use super::Outcome;
use crate::common::compare::elementwise;
use crate::common::gpu::Gpu;
use crate::golden::npz::Npz;
use crate::reference::lpips::{ALEXNET, Step, VGG16, formula};
use ashsplat::passes::lpips::{InputRange, Lpips, Network, Weights};
use std::path::Path;

const DEVICE: f64 = 1e-4;
/// Name in the file, layers, and offset of the weights' formula tag.
const NETWORKS: [(&str, &[Step], u32, Network); 2] =
    [("alex", &ALEXNET, 0, Network::AlexNet), ("vgg", &VGG16, 64, Network::Vgg16)];

fn picture(npz: &Npz, name: &str) -> (Vec<[f64; 3]>, [usize; 2]) {
    let shape = &npz.array(name).shape;
    let pixels = npz.rows::<3>(name).into_iter().map(|rgb| rgb.map(|x| x / 255.0)).collect();
    (pixels, [shape[1], shape[0]])
}

fn compare(npz: &Npz, name: &str, parts: &[f64]) -> Outcome {
    elementwise(&format!("parts of {name}"), parts, npz.values(&format!("{name}_layers")), 0.0, DEVICE)?;
    elementwise(name, &[parts.iter().sum()], npz.values(name), 0.0, DEVICE)?;
    Ok(())
}

fn first_tag(npz: &Npz) -> u32 {
    if npz.has("tag") { npz.scalar("tag") as u32 } else { 0 }
}

pub fn check(path: &Path) -> Outcome {
    let npz = Npz::read(path);
    let gpu = Gpu::new();
    let single = |name: &str| {
        let (picture, [width, height]) = picture(&npz, name);
        (picture.iter().map(|rgb| rgb.map(|x| x as f32)).collect::<Vec<_>>(), (width as u32, height as u32))
    };
    let ((a, size), (b, _)) = (single("a"), single("b"));
    for (name, steps, tags, network) in NETWORKS {
        let own = formula(steps, first_tag(&npz) + tags);
        let weights = Weights { network, convolutions: own.convolutions, heads: own.heads };
        let mut measure = Lpips::new(gpu.context, &weights).expect("kernels");
        for (suffix, range) in [("", InputRange::MinusOneToOne), ("_unscaled", InputRange::ZeroToOne)] {
            let parts = measure.distances([&a, &b], size, range).expect("a measurement");
            compare(&npz, &format!("{name}{suffix}"), &parts)?;
        }
    }
    Ok(())
}
