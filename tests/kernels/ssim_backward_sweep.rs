//! `loss/ssim_backward_sweep` against the twin of `loss/ssim_backward`, and the whole loss in all its forms.

use super::ssim_backward::{TOLERANCE, check};
use crate::common::compare::{elementwise, gradient};
use crate::common::gpu::Gpu;
use crate::common::loss::{BACKGROUND, Pictures, SIZES, SWEEPS, Window};
use crate::common::options;
use crate::reference::loss_reduce::loss;
use ashsplat::loss::{Loss, LossInputs, PhotoFormat, Windowing};
use ashsplat::vk::{Context, ContextOptions, LimitsOverride, MemoryKind};

#[test]
fn ssim_backward_sweep_equals_its_twin() {
    let gpu = Gpu::new();
    if !gpu.has_texels("ssim_backward_sweep") {
        return;
    }
    for size in SIZES {
        for columns in SWEEPS {
            check(&gpu, &Pictures::random(size), Window::Sweep { columns });
            check(&gpu, &Pictures::masked(size), Window::Sweep { columns });
        }
    }
}

/// Loss and gradient by the engine, on a device whose buffers hold at most `largest` bytes.
fn engine_loss(pictures: &Pictures, windowing: Windowing, largest: Option<u64>) -> (Vec<u8>, Vec<f32>) {
    let limits = LimitsOverride { max_storage_buffer_range: largest, ..LimitsOverride::default() };
    let options = ContextOptions { limits_override: Some(limits), ..options() };
    let context = Context::new(&options).expect("a device");
    let format = if pictures.masked { PhotoFormat::MaskedRgba8 } else { PhotoFormat::Rgba8 };
    let loss = Loss::with_windowing(&context, format, windowing).expect("kernels");
    let [width, height] = pictures.size;
    let (rendered_values, photo_values) = (pictures.rendered(windowing), pictures.photo(windowing));
    let mut requests = loss.scratch_requests([(width, height)]);
    let parts = requests.len();
    let derivatives = requests.iter().filter(|(name, _)| *name == "ssim_derivatives").count();
    assert_eq!(derivatives, if largest.is_some() { 3 } else { 1 });
    requests.extend([
        ("losses", 16),
        ("rendered", 4 * rendered_values.len() as u64),
        ("photo", photo_values.len() as u64),
        ("image_gradient", 4 * pictures.gradient_words(windowing) as u64),
    ]);
    let buffers = context.allocate("test", &requests, MemoryKind::Device).expect("buffers");
    let (scratch, others) = buffers.split_at(parts);
    let [losses, rendered, photo, image_gradient] = others else { unreachable!("four") };
    context.upload(rendered, bytemuck::cast_slice(&rendered_values)).expect("an upload");
    context.upload(photo, &photo_values).expect("an upload");
    let inputs = LossInputs {
        rendered,
        photo,
        scratch,
        losses,
        row: 0,
        image_gradient,
        width,
        height,
        background: BACKGROUND.map(|x| x as f32),
        lambda_dssim: 0.2,
        weight: 1.0,
    };
    let run = context.run("loss", |recorder| {
        recorder.fill(image_gradient, 0);
        recorder.barrier();
        loss.record(recorder, &inputs);
        Ok(())
    });
    run.expect("a run");
    crate::common::assert_silent(&context);
    let words: Vec<f32> =
        bytemuck::pod_collect_to_vec(&context.download(image_gradient).expect("a gradient"));
    let gradient = pictures.gradient(windowing, &words[..pictures.gradient_words(windowing)]);
    (context.download(losses).expect("losses"), gradient.into_flattened())
}

/// If the derivatives of all channels do not fit into one buffer, the engine computes them one by one, to the same
/// bits.
#[test]
fn loss_in_one_buffer_or_three() {
    let pictures = Pictures::random([67, 41]);
    for windowing in Gpu::new().windowings() {
        let (losses, gradient) = engine_loss(&pictures, windowing, None);
        let (losses_3, gradient_3) = engine_loss(&pictures, windowing, Some(63_000));
        assert!(losses == losses_3 && gradient == gradient_3, "{windowing:?}");
    }
}

/// A mask that keeps everything changes nothing, to the bit. Masked pixels do not matter, to the bit.
#[test]
fn loss_under_masks() {
    for windowing in Gpu::new().windowings() {
        let mut pictures = Pictures::random([67, 41]);
        let unmasked = engine_loss(&pictures, windowing, None);
        pictures.masked = true;
        pictures.photo.iter_mut().for_each(|word| *word |= 0xFF00_0000);
        assert!(engine_loss(&pictures, windowing, None) == unmasked, "{windowing:?}");
        let mut pictures = Pictures::masked([67, 41]);
        let masked = engine_loss(&pictures, windowing, None);
        assert!(masked != unmasked);
        let hidden: Vec<usize> = (0..pictures.pixels()).filter(|&i| !pictures.counts(i)).collect();
        for i in hidden {
            pictures.photo[i] = 0x0055_AA11;
            pictures.accumulated[i] = [0.9, 0.1, 1.5, 0.7];
            assert_eq!(masked.1[4 * i..4 * i + 3], [0.0; 3]);
        }
        assert!(engine_loss(&pictures, windowing, None) == masked, "{windowing:?}");
    }
}

/// Loss and gradient against both pictures times the mask, in f64.
#[test]
fn loss_under_a_mask_is_that_of_the_pictures_times_the_mask() {
    let pictures = Pictures::masked([67, 41]);
    let count = pictures.pixels();
    let interleaved = |which: usize| -> Vec<f64> {
        let planes = [0, 1, 2].map(|channel| pictures.planes(channel)[which].values.clone());
        (0..count).flat_map(|i| [planes[0][i], planes[1][i], planes[2][i]]).collect()
    };
    let twin = loss(&interleaved(0), &interleaved(1), 67, 41);
    let by_mask = |i: usize| if pictures.counts(i / 3) { 1.0 } else { 0.0 };
    let expected: Vec<f64> = twin.gradient.iter().enumerate().map(|(i, d)| d * by_mask(i)).collect();
    for windowing in Gpu::new().windowings() {
        let (losses, actual) = engine_loss(&pictures, windowing, None);
        let losses: Vec<f32> = bytemuck::pod_collect_to_vec(&losses);
        let losses = [0, 1, 2].map(|k| f64::from(losses[k]));
        elementwise("loss", &losses, &[twin.loss, twin.l1, twin.ssim], 1e-6, 1e-5).expect("losses");
        let actual = (0..3 * count).map(|i| f64::from(actual[i / 3 * 4 + i % 3])).collect::<Vec<f64>>();
        let skip = vec![false; count];
        gradient("image", &actual, &expected, &skip, TOLERANCE).expect("gradient under a mask");
    }
}

/// Both forms give the same loss.
#[test]
fn loss_by_blocks_and_by_sweeps() {
    if !Gpu::new().has_texels("the loss by sweeps") {
        return;
    }
    let pictures = Pictures::random([90, 70]);
    let [blocks, sweeps] =
        [Windowing::Blocks, Windowing::Sweeps].map(|windowing| engine_loss(&pictures, windowing, None));
    let numbers = |bytes: &[u8]| bytemuck::pod_collect_to_vec::<u8, f32>(bytes);
    for (a, b) in numbers(&blocks.0).iter().zip(&numbers(&sweeps.0)) {
        assert!((a - b).abs() <= 1e-6, "{a} {b}");
    }
    let largest = blocks.1.iter().fold(0.0_f32, |largest, x| largest.max(x.abs()));
    let difference = blocks.1.iter().zip(&sweeps.1).fold(0.0_f32, |worst, (a, b)| worst.max((a - b).abs()));
    assert!(difference <= 2e-5 * largest && largest > 0.0, "{difference} of {largest}");
}

/// Texels need push descriptors: without them, the loss uses its other form.
#[test]
fn loss_without_texels() {
    let options = ContextOptions { push_descriptors: false, ..options() };
    let context = Context::new(&options).expect("a device");
    assert_eq!(Windowing::for_device(context.limits()), Windowing::Blocks);
    assert!(Loss::new(&context, PhotoFormat::Rgba8).is_ok());
    let refused = Loss::with_windowing(&context, PhotoFormat::Rgba8, Windowing::Sweeps).err();
    let message = refused.expect("no texels").to_string();
    assert!(
        message.contains("loss/ssim_forward_sweep") && message.contains("VK_KHR_push_descriptor"),
        "{message}"
    );
}
