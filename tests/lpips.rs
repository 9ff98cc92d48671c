//! LPIPS on the device: the same bits with any memory, and errors for invalid inputs.

use crate::common::prelude::*;
use crate::reference::lpips::{ALEXNET, VGG16, formula, lpips};
use ashsplat::passes::lpips::{InputRange, Lpips, Network, Weights};

fn weights(network: Network) -> Weights {
    let own = match network {
        Network::AlexNet => formula(&ALEXNET, 0),
        Network::Vgg16 => formula(&VGG16, 64),
    };
    Weights { network, convolutions: own.convolutions, heads: own.heads }
}

fn picture([width, height]: [u32; 2], seed: u64) -> Vec<[f32; 3]> {
    let mut random = Random::new(seed);
    (0..width * height).map(|_| [0; 3].map(|_| random.unit() as f32)).collect()
}

fn measure(context: &Context, weights: &Weights, size: [u32; 2]) -> [f64; 5] {
    let (a, b) = (picture(size, 1), picture(size, 2));
    let mut lpips = Lpips::new(context, weights).expect("kernels");
    lpips.distances([&a, &b], (size[0], size[1]), InputRange::ZeroToOne).expect("a measurement")
}

#[test]
fn lpips_has_the_same_bits_in_little_memory() {
    let gpu = Gpu::new();
    let (weights, size) = (weights(Network::AlexNet), [61, 150]);
    gpu.context.reset_memory_peaks();
    let whole = measure(gpu.context, &weights, size);
    assert!(whole.iter().all(|part| *part > 0.0), "{whole:?}");
    let own: u64 = weights.convolutions.iter().map(|(w, b)| 4 * (w.len() + b.len()) as u64).sum();
    for share in [2, 4] {
        let max_memory = own + (1 << 20) + arena_peak(gpu.context, "lpips") / share;
        let context = bounded(Some(max_memory));
        assert_eq!(measure(&context, &weights, size), whole, "with {max_memory} bytes");
        assert!(context.memory_total().peak_bytes <= max_memory);
        assert!(arena_peak(&context, "lpips") <= arena_peak(gpu.context, "lpips") / share + (1 << 20));
    }
}

/// No feature map fits a binding as a whole.
#[test]
fn lpips_has_the_same_bits_in_small_bindings() {
    let gpu = Gpu::new();
    let (weights, size) = (weights(Network::Vgg16), [150, 150]);
    let whole = measure(gpu.context, &weights, size);
    // The largest weights take 9 MiB.
    let context = with_range(10 << 20);
    assert_eq!(measure(&context, &weights, size), whole);
    assert_silent(&context);
}

/// Sizes that windows do not divide evenly, one picture after another with the same kernels.
#[test]
fn lpips_of_pictures_of_any_size() {
    let (own, weights) = (formula(&ALEXNET, 0), weights(Network::AlexNet));
    let [mut texels, mut stored] =
        [Gpu::new(), Gpu::without_texels()].map(|gpu| Lpips::new(gpu.context, &weights).expect("kernels"));
    let sizes = [[31, 31], [40, 33], [33, 40], [70, 36]];
    for (size @ [width, height], with_texels) in sizes.into_iter().flat_map(|n| [(n, true), (n, false)]) {
        let measure = if with_texels { &mut texels } else { &mut stored };
        let (a, b) = (picture(size, 3), picture(size, 4));
        let parts =
            measure.distances([&a, &b], (width, height), InputRange::MinusOneToOne).expect("a measurement");
        let wide = |picture: &[[f32; 3]]| -> Vec<[f64; 3]> {
            picture.iter().map(|rgb| rgb.map(|x| 2.0 * f64::from(x) - 1.0)).collect()
        };
        let expected = lpips(&ALEXNET, &own, [&wide(&a), &wide(&b)], size.map(|n| n as usize));
        elementwise("part", &parts, &expected, 0.0, 1e-4).unwrap_or_else(|e| panic!("{size:?}: {e}"));
        let same = measure.distance([&a, &a], (width, height)).expect("a measurement");
        assert_eq!(same, 0.0, "of equal pictures");
        let sum = measure.distance([&a, &b], (width, height)).expect("a measurement");
        assert_eq!(sum, parts.iter().sum::<f64>());
    }
}

#[test]
fn lpips_refuses_what_it_cannot_measure() {
    let gpu = Gpu::new();
    let mut measure = Lpips::new(gpu.context, &weights(Network::AlexNet)).expect("kernels");
    let mut refused = |pixels: [u32; 2], size: (u32, u32), said: &str| {
        let (a, b) = (picture(pixels, 5), picture([size.0, size.1], 6));
        assert_says(refusal(measure.distance([&a, &b], size)), &[said]);
    };
    refused([40, 40], (40, 41), "has 1600 pixels, must have 40x41");
    refused([30, 40], (30, 40), "30x40 pixels, AlexNet needs 31");
    let mut few = weights(Network::AlexNet);
    few.convolutions[2].0.pop();
    assert_says(refusal(Lpips::new(gpu.context, &few)), &["layer 6"]);
    let context = bounded(Some(8 << 20));
    let error = Lpips::new(&context, &weights(Network::AlexNet)).err().expect("too large");
    assert!(matches!(error, Error::TooLarge { .. }), "{error}");
}
