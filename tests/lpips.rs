//! LPIPS on the device: the same bits with any memory, and errors for invalid inputs.

use ashsplat::Error;
use ashsplat::lpips::{InputRange, Lpips, Network, Weights};
use ashsplat::vk::{Context, ContextOptions, LimitsOverride};

use crate::common::compare::elementwise;
use crate::common::gpu::Gpu;
use crate::common::scenes::Random;
use crate::common::{assert_silent, bounded, options};
use crate::reference::lpips::{ALEXNET, VGG16, formula, lpips};

fn weights(network: Network) -> Weights {
    let own = match network {
        Network::AlexNet => formula(&ALEXNET, 0),
        Network::Vgg16 => formula(&VGG16, 64),
    };
    Weights { network, convolutions: own.convolutions, heads: own.heads }
}

/// Random pixels.
fn picture([width, height]: [u32; 2], seed: u64) -> Vec<[f32; 3]> {
    let mut random = Random::new(seed);
    (0..width * height).map(|_| [0; 3].map(|_| random.unit() as f32)).collect()
}

fn measure(context: &Context, weights: &Weights, size: [u32; 2]) -> [f64; 5] {
    let (a, b) = (picture(size, 1), picture(size, 2));
    let mut lpips = Lpips::new(context, weights).expect("kernels");
    lpips.distances([&a, &b], (size[0], size[1]), InputRange::ZeroToOne).expect("a measurement")
}

/// Peak bytes of the feature maps.
fn maps(context: &Context) -> u64 {
    context.memory().into_iter().find(|arena| arena.name == "lpips").expect("maps").peak_bytes
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
        let max_memory = own + (1 << 20) + maps(gpu.context) / share;
        let context = bounded(Some(max_memory));
        assert_eq!(measure(&context, &weights, size), whole, "with {max_memory} bytes");
        assert!(context.memory_total().peak_bytes <= max_memory);
        assert!(maps(&context) <= maps(gpu.context) / share + (1 << 20));
    }
}

/// No feature map fits a binding as a whole.
#[test]
fn lpips_has_the_same_bits_in_small_bindings() {
    let gpu = Gpu::new();
    let (weights, size) = (weights(Network::Vgg16), [150, 150]);
    let whole = measure(gpu.context, &weights, size);
    // The largest weights take 9 MiB.
    let limits = LimitsOverride { max_storage_buffer_range: Some(10 << 20), ..LimitsOverride::default() };
    let options = ContextOptions { limits_override: Some(limits), ..options() };
    let context = Context::new(&options).expect("a device");
    assert_eq!(measure(&context, &weights, size), whole);
    assert_silent(&context);
}

/// Sizes that windows do not divide evenly, one picture after another with the same kernels.
#[test]
fn lpips_of_pictures_of_any_size() {
    let gpu = Gpu::new();
    let own = formula(&ALEXNET, 0);
    let mut measure = Lpips::new(gpu.context, &weights(Network::AlexNet)).expect("kernels");
    for size @ [width, height] in [[31, 31], [40, 33], [33, 40], [70, 36]] {
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
    let mut message = |pixels: [u32; 2], size: (u32, u32)| {
        let (a, b) = (picture(pixels, 5), picture([size.0, size.1], 6));
        measure.distance([&a, &b], size).expect_err("refused").to_string()
    };
    assert!(message([40, 40], (40, 41)).contains("has 1600 pixels, must have 40x41"));
    assert!(message([30, 40], (30, 40)).contains("30x40 pixels, AlexNet needs 31"));
    let mut few = weights(Network::AlexNet);
    few.convolutions[2].0.pop();
    let error = Lpips::new(gpu.context, &few).err().expect("refused").to_string();
    assert!(error.contains("layer 6"), "{error}");
    let context = bounded(Some(8 << 20));
    let error = Lpips::new(&context, &weights(Network::AlexNet)).err().expect("too large");
    assert!(matches!(error, Error::TooLarge { .. }), "{error}");
}
