//! The photometric loss by blocks and by sweeps against its twins: `loss/ssim_forward`, `loss/ssim_forward_sweep`,
//! `loss/ssim_backward`, and `loss/ssim_backward_sweep`; and the whole loss by the engine.

use crate::common::prelude::*;
use crate::reference::loss::LAMBDA_DSSIM;
use crate::reference::ssim::{Plane, SsimPlane, ssim_backward, ssim_forward};
use ashsplat::frame::Strips;
use ashsplat::kernels::loss as kernels;
use ashsplat::passes::loss::{Loss, LossInputs, NativeLayout, PhotoFormat, photo_on_device};

const BACKGROUND: [f64; 3] = [0.25, 0.5, 0.75];

struct Pictures {
    size: [u32; 2],
    /// Colour without background, and transmittance, as the blending writes them.
    accumulated: Vec<[f32; 4]>,
    /// RGBA8.
    photo: Vec<u32>,
    /// True if the photograph's fourth byte is a mask.
    masked: bool,
}

impl Pictures {
    /// Random pictures with structure, so that SSIM is neither 0 nor 1.
    fn random(size: [u32; 2]) -> Pictures {
        let mut random = Random::new(u64::from(size[0]) << 32 | u64::from(size[1]));
        let count = (size[0] * size[1]) as usize;
        let mut accumulated = Vec::new();
        let mut photo = Vec::new();
        for i in 0..count {
            let (x, y) = (i as f64 % f64::from(size[0]), (i as f64 / f64::from(size[0])).floor());
            let wave = [0, 1, 2].map(|c| 0.5 + 0.4 * (0.3 * x + 0.2 * y * f64::from(c)).sin());
            let transmittance = random.unit() * 0.5;
            let rendered = wave.map(|w| (w * (1.0 - transmittance) + 0.3 * random.signed()) as f32);
            accumulated.push([rendered[0], rendered[1], rendered[2], transmittance as f32]);
            let bytes = wave.map(|w| ((w + 0.1 * random.signed()) * 255.0).clamp(0.0, 255.0) as u32);
            // The fourth byte is unused.
            photo.push(bytes[0] | bytes[1] << 8 | bytes[2] << 16 | random.below(256) << 24);
        }
        Pictures { size, accumulated, photo, masked: false }
    }

    /// Same as [`Self::random`], but a mask of blocks and single pixels leaves about half of the pixels.
    fn masked(size: [u32; 2]) -> Pictures {
        let mut pictures = Pictures { masked: true, ..Pictures::random(size) };
        let mut random = Random::new(7 + u64::from(size[0]));
        for (i, word) in pictures.photo.iter_mut().enumerate() {
            let (x, y) = (i as u32 % size[0], i as u32 / size[0]);
            let counts = match (x / 13 + y / 13) % 3 {
                0 => true,
                1 => false,
                _ => random.below(2) == 0,
            };
            *word = *word & 0x00FF_FFFF | if counts { 0xFF00_0000 } else { 0 };
        }
        pictures
    }

    fn counts(&self, pixel: usize) -> bool {
        !self.masked || self.photo[pixel] >> 24 != 0
    }

    fn pixels(&self) -> usize {
        self.accumulated.len()
    }

    /// A channel of the composited picture and of the photograph.
    fn planes(&self, channel: usize) -> [Plane; 2] {
        let [width, height] = self.size.map(|n| n as usize);
        let rendered = |t: &[f32; 4]| f64::from(t[channel]) + f64::from(t[3]) * BACKGROUND[channel];
        let taken = |word: &u32| f64::from(word >> (8 * channel) & 0xFF) / 255.0;
        let times_mask = |(i, value)| if self.counts(i) { value } else { 0.0 };
        let rendered = self.accumulated.iter().map(rendered).enumerate().map(times_mask).collect();
        let taken = self.photo.iter().map(taken).enumerate().map(times_mask).collect();
        [Plane { width, height, values: rendered }, Plane { width, height, values: taken }]
    }

    fn strips(&self) -> Strips {
        let [width, height] = self.size;
        Strips { width, height }
    }

    fn rendered(&self, layout: NativeLayout) -> Vec<f32> {
        let composited = |t: &[f32; 4]| [0, 1, 2].map(|c| t[c] + t[3] * BACKGROUND[c] as f32);
        match layout {
            NativeLayout::Rows => self.accumulated.as_flattened().to_vec(),
            NativeLayout::Strips => self.strips().planes(self.accumulated.iter().map(composited)),
        }
    }

    fn photo(&self, layout: NativeLayout) -> Vec<u8> {
        let [width, height] = self.size;
        photo_on_device(layout, width, height, self.masked, bytemuck::cast_slice(&self.photo).to_vec())
    }

    fn gradient_words(&self, layout: NativeLayout) -> usize {
        match layout {
            NativeLayout::Rows => 4 * self.pixels(),
            NativeLayout::Strips => 3 * self.strips().values() as usize,
        }
    }

    /// The gradient per pixel. Only blocks have a fourth component.
    fn gradient(&self, layout: NativeLayout, words: &[f32]) -> Vec<[f32; 4]> {
        match layout {
            NativeLayout::Rows => words.as_chunks::<4>().0.to_vec(),
            NativeLayout::Strips => (0..self.pixels() as u32)
                .map(|i| {
                    let (x, y) = (i % self.size[0], i / self.size[0]);
                    let [r, g, b] = [0, 1, 2].map(|plane| words[self.strips().index(plane, x, y)]);
                    [r, g, b, 0.0]
                })
                .collect(),
        }
    }

    /// Workgroup counts: blocks of 16×16, and channels.
    fn grid(&self) -> [u32; 3] {
        [self.size[0].div_ceil(16), self.size[1].div_ceil(16), 3]
    }
}

/// Kernels that compute the window, and the work of one invocation.
#[derive(Clone, Copy, Debug)]
enum Window {
    Block { strip: u32 },
    Sweep { columns: u32 },
}

impl Window {
    fn layout(self) -> NativeLayout {
        match self {
            Self::Block { .. } => NativeLayout::Rows,
            Self::Sweep { .. } => NativeLayout::Strips,
        }
    }

    fn derivative_words(self, pictures: &Pictures) -> usize {
        match self {
            Self::Block { .. } => 9 * pictures.pixels(),
            Self::Sweep { .. } => 9 * pictures.strips().values() as usize,
        }
    }

    /// Index of the word with the derivative by moment `k`.
    fn derivative_place(self, pictures: &Pictures, channel: usize, pixel: usize, k: usize) -> usize {
        let place = match self {
            Self::Block { .. } => channel * pictures.pixels() + pixel,
            Self::Sweep { .. } => {
                let [width, pixel] = [pictures.size[0], pixel as u32];
                pictures.strips().index(channel as u32, pixel % width, pixel / width)
            }
        };
        3 * place + k
    }

    /// Indices of the derivatives below the picture in a strip. Kernels read them, and they are 0.
    fn derivatives_below(self, pictures: &Pictures) -> Vec<usize> {
        if let Self::Block { .. } = self {
            return Vec::new();
        }
        let ([width, height], strips) = (pictures.size, pictures.strips());
        let rows = height..height.next_multiple_of(8);
        let places = (0..3).flat_map(|channel| {
            rows.clone().flat_map(move |y| (0..width).map(move |x| 3 * strips.index(channel, x, y)))
        });
        places.flat_map(|place| [place, place + 1, place + 2]).collect()
    }

    fn partials(self, pictures: &Pictures) -> usize {
        let [width, height] = pictures.size;
        match self {
            Self::Block { .. } => (pictures.grid()[0] * pictures.grid()[1]) as usize,
            Self::Sweep { columns } => (height.div_ceil(8) * width.div_ceil(columns)) as usize,
        }
    }
}

/// Runs the forward kernel. Returns derivatives of SSIM per channel and pixel, and partial sums.
fn forward(gpu: &Gpu, pictures: &Pictures, window: Window) -> (Buffer, Buffer) {
    let rendered = &gpu.buffer("rendered", &pictures.rendered(window.layout()));
    let photo = &gpu.buffer("photo", &pictures.photo(window.layout()));
    let count = 3 * window.partials(pictures);
    let derivatives = gpu.untouched::<f32>("derivatives", window.derivative_words(pictures));
    let loss_partials = gpu.untouched::<[f32; 2]>("loss_partials", count);
    let [image_width, image_height] = pictures.size;
    let background = BACKGROUND.map(|x| x as f32);
    let (workgroup_size, float_photo, masked) = (gpu.workgroup(64), false, pictures.masked);
    match window {
        Window::Block { strip } => {
            let subgroup_size = gpu.subgroup();
            let spec =
                kernels::ssim_forward::Spec { workgroup_size, subgroup_size, strip, float_photo, masked };
            let kernel = gpu.kernel::<kernels::ssim_forward::Interface>(&spec);
            let bind = kernels::ssim_forward::Bind {
                accumulated: rendered,
                photo,
                derivatives: &derivatives,
                loss_partials: &loss_partials,
            };
            let push =
                kernels::ssim_forward::Push { image_width, image_height, background, first_channel: 0 };
            gpu.run(|recorder| recorder.dispatch_3d(&kernel, &bind, &push, pictures.grid()));
        }
        Window::Sweep { columns } => {
            let spec = kernels::ssim_forward_sweep::Spec { workgroup_size, float_photo, masked };
            let kernel = gpu.kernel::<kernels::ssim_forward_sweep::Interface>(&spec);
            let bind = kernels::ssim_forward_sweep::Bind {
                rendered,
                photo,
                derivatives: &derivatives,
                loss_partials: &loss_partials,
            };
            let push = kernels::ssim_forward_sweep::Push {
                image_width,
                image_height,
                first_channel: 0,
                invocations: count as u32,
                columns,
                first_partial: 0,
            };
            let workgroups = (count as u64).div_ceil(workgroup_size.into());
            gpu.run(|recorder| recorder.dispatch(&kernel, &bind, &push, workgroups));
        }
    }
    (derivatives, loss_partials)
}

const WEIGHT: f32 = 0.7;

/// Runs the backward kernel. Returns [`WEIGHT`] dL/d(r, g, b) and a fourth component that it does not write.
fn backward(
    gpu: &Gpu,
    pictures: &Pictures,
    derivatives: &Buffer,
    window: Window,
    lambda_dssim: f32,
) -> Vec<[f32; 4]> {
    let rendered = &gpu.buffer("rendered", &pictures.rendered(window.layout()));
    let photo = &gpu.buffer("photo", &pictures.photo(window.layout()));
    let words = pictures.gradient_words(window.layout());
    let image_gradient = gpu.untouched::<f32>("image_gradient", words);
    let [image_width, image_height] = pictures.size;
    let background = BACKGROUND.map(|x| x as f32);
    let (workgroup_size, float_photo, first_channel) = (gpu.workgroup(64), false, 0);
    let masked = pictures.masked;
    match window {
        Window::Block { strip } => {
            let spec = kernels::ssim_backward::Spec { workgroup_size, strip, float_photo, masked };
            let kernel = gpu.kernel::<kernels::ssim_backward::Interface>(&spec);
            let bind = kernels::ssim_backward::Bind {
                accumulated: rendered,
                photo,
                derivatives,
                image_gradient: &image_gradient,
                // Unused without partial sums.
                loss_partials: derivatives,
                losses: &image_gradient,
            };
            let push = kernels::ssim_backward::Push {
                image_width,
                image_height,
                background,
                first_channel,
                lambda_dssim,
                weight: WEIGHT,
                partials: 0,
                loss_row: 0,
            };
            gpu.run(|recorder| recorder.dispatch_3d(&kernel, &bind, &push, pictures.grid()));
        }
        Window::Sweep { columns } => {
            let subgroup_size = gpu.subgroup();
            let spec =
                kernels::ssim_backward_sweep::Spec { workgroup_size, subgroup_size, float_photo, masked };
            let kernel = gpu.kernel::<kernels::ssim_backward_sweep::Interface>(&spec);
            let bind = kernels::ssim_backward_sweep::Bind {
                rendered,
                photo,
                derivatives,
                image_gradient: &image_gradient,
                // Unused without partial sums.
                loss_partials: derivatives,
                losses: &image_gradient,
            };
            let invocations = 3 * window.partials(pictures) as u32;
            let push = kernels::ssim_backward_sweep::Push {
                image_width,
                image_height,
                first_channel,
                invocations,
                columns,
                lambda_dssim,
                partials: 0,
                loss_row: 0,
                weight: WEIGHT,
            };
            let workgroups = u64::from(invocations.div_ceil(workgroup_size));
            gpu.run(|recorder| recorder.dispatch(&kernel, &bind, &push, workgroups));
        }
    }
    pictures.gradient(window.layout(), &gpu.read::<f32>(&image_gradient, words))
}

/// Image sizes around the block and apron sizes.
const SIZES: [[u32; 2]; 8] = [[1, 1], [5, 3], [16, 16], [17, 5], [15, 33], [31, 48], [64, 10], [90, 70]];

const TOLERANCE: GradientTolerance = GradientTolerance { relative_l2: 2e-5, max_over_max: 2e-5 };

/// Checks windows, by sweeps only where the device can run them, over pictures of all sizes, with and without a mask.
fn check_all(sweeps: bool, check: fn(&Gpu, &Pictures, Window)) {
    let gpu = Gpu::new();
    let windows = match sweeps {
        false => [2, 4, 8].map(|strip| Window::Block { strip }),
        true if gpu.has_texels("the loss by sweeps") => [3, 7, 48].map(|columns| Window::Sweep { columns }),
        true => return,
    };
    for (size, &window) in SIZES.into_iter().flat_map(|size| windows.iter().map(move |w| (size, w))) {
        check(&gpu, &Pictures::random(size), window);
        check(&gpu, &Pictures::masked(size), window);
    }
}

fn check_forward(gpu: &Gpu, pictures: &Pictures, window: Window) {
    let (derivatives, partials) = forward(gpu, pictures, window);
    let count = pictures.pixels();
    let derivatives = gpu.read::<f32>(&derivatives, window.derivative_words(pictures));
    assert!(window.derivatives_below(pictures).iter().all(|&place| derivatives[place] == 0.0));
    let per_channel = window.partials(pictures);
    let partials = gpu.read::<[f32; 2]>(&partials, 3 * per_channel);
    for channel in 0..3 {
        let [x, y] = pictures.planes(channel);
        let twin = ssim_forward(&x, &y);
        let place = |pixel: usize, k: usize| window.derivative_place(pictures, channel, pixel, k);
        let column = |k: usize| (0..count).map(|i| f64::from(derivatives[place(i, k)])).collect::<Vec<f64>>();
        for (k, expected) in [&twin.d_mean, &twin.d_square, &twin.d_product].into_iter().enumerate() {
            // The derivatives reach 1/C2 if a window has no variance.
            let largest = expected.iter().fold(1.0_f64, |largest, x| largest.max(x.abs()));
            elementwise("derivative", &column(k), expected, 1e-4 * largest, 1e-4)
                .expect("derivatives of SSIM");
        }
        let sums = &partials[channel * per_channel..(channel + 1) * per_channel];
        let sum = |k: usize| sums.iter().map(|s| f64::from(s[k])).sum::<f64>();
        let l1: f64 = x.values.iter().zip(&y.values).map(|(x, y)| (x - y).abs()).sum();
        elementwise("L1", &[sum(0)], &[l1], 0.0, 1e-5).expect("L1");
        elementwise("SSIM", &[sum(1)], &[twin.ssim.iter().sum()], 1e-5 * count as f64, 1e-5).expect("SSIM");
    }
}

#[test]
fn ssim_forward_equals_its_twin() {
    check_all(false, check_forward);
}

#[test]
fn ssim_forward_sweep_equals_its_twin() {
    check_all(true, check_forward);
}

fn check_backward(gpu: &Gpu, pictures: &Pictures, window: Window) {
    let count = pictures.pixels();
    let planes = [0, 1, 2].map(|channel| pictures.planes(channel));
    // Uses the twin's derivatives, so that the test judges only this kernel.
    let twins: [SsimPlane; 3] = planes.each_ref().map(|[x, y]| ssim_forward(x, y));
    let mut derivatives = vec![f32::NAN; window.derivative_words(pictures)];
    for place in window.derivatives_below(pictures) {
        derivatives[place] = 0.0;
    }
    for (channel, t) in twins.iter().enumerate() {
        for i in 0..count {
            for (k, value) in [t.d_mean[i], t.d_square[i], t.d_product[i]].into_iter().enumerate() {
                derivatives[window.derivative_place(pictures, channel, i, k)] = value as f32;
            }
        }
    }
    let derivatives = gpu.buffer("derivatives", &derivatives);
    for lambda in [0.2, 0.0, 1.0] {
        let actual = backward(gpu, pictures, &derivatives, window, lambda);
        let fourth = if let Window::Block { .. } = window { UNTOUCHED } else { 0 };
        assert!(actual.iter().all(|d| d[3].to_bits() == fourth));
        for (channel, ([x, y], twin)) in planes.iter().zip(&twins).enumerate() {
            let expected = ssim_backward(x, y, twin, f64::from(lambda), 3 * count);
            let mut expected: Vec<f64> = expected.iter().map(|d| f64::from(WEIGHT) * d).collect();
            let mut actual: Vec<f64> = actual.iter().map(|d| f64::from(d[channel])).collect();
            for i in 0..count {
                if !pictures.counts(i) {
                    assert_eq!(actual[i], 0.0, "gradient where the mask is");
                    expected[i] = 0.0;
                }
                // Rounding decides the sign of a difference near zero.
                if (x.values[i] - y.values[i]).abs() < 1e-6 {
                    (expected[i], actual[i]) = (0.0, 0.0);
                }
            }
            gradient("image", &actual, &expected, &vec![false; count], TOLERANCE)
                .expect("gradient of the loss");
        }
    }
}

#[test]
fn ssim_backward_equals_its_twin() {
    check_all(false, check_backward);
}

#[test]
fn ssim_backward_sweep_equals_its_twin() {
    check_all(true, check_backward);
}

/// Adds partial sums into row 1 of 3, beside the gradient of a single pixel.
fn added(gpu: &Gpu, partials: &Buffer, count: usize) -> [f64; 3] {
    let workgroup_size = gpu.workgroup(64);
    let spec = kernels::ssim_backward::Spec { workgroup_size, strip: 4, float_photo: false, masked: false };
    let losses = gpu.untouched::<[f32; 4]>("losses", 3);
    let bind = kernels::ssim_backward::Bind {
        accumulated: &gpu.buffer("accumulated", &[[0.5_f32; 4]]),
        photo: &gpu.buffer("photo", &[0_u32]),
        derivatives: &gpu.buffer("derivatives", &[[0.0_f32; 3]; 3]),
        image_gradient: &gpu.untouched::<f32>("image_gradient", 4),
        loss_partials: partials,
        losses: &losses,
    };
    let push = kernels::ssim_backward::Push {
        image_width: 1,
        image_height: 1,
        background: [0.0; 3],
        first_channel: 0,
        lambda_dssim: LAMBDA_DSSIM as f32,
        weight: WEIGHT,
        partials: count as u32,
        loss_row: 1,
    };
    let kernel = gpu.kernel::<kernels::ssim_backward::Interface>(&spec);
    gpu.run(|recorder| recorder.dispatch_3d(&kernel, &bind, &push, [1, 1, 3]));
    let all = gpu.read::<[f32; 4]>(&losses, 3);
    assert!([all[0], all[2]].as_flattened().iter().all(|x| x.to_bits() == UNTOUCHED));
    [0, 1, 2].map(|k| f64::from(all[1][k]))
}

#[test]
fn ssim_backward_adds_the_loss() {
    let gpu = Gpu::new();
    for size in sizes(gpu.workgroup(64) as usize).into_iter().filter(|&size| size > 0) {
        let mut random = Random::new(size as u64);
        // Sums of the magnitude of one pixel's.
        let mut part = || random.unit() as f32 / size as f32;
        let values: Vec<[f32; 2]> = (0..size).map(|_| [part(), part()]).collect();
        let partials = gpu.buffer("loss_partials", &values);
        let [l1, ssim] = [0, 1].map(|k| values.iter().map(|v| f64::from(v[k])).sum::<f64>() / 3.0);
        let loss = f64::from(WEIGHT) * ((1.0 - LAMBDA_DSSIM) * l1 + LAMBDA_DSSIM * (1.0 - ssim));
        let expected = [loss, l1, ssim];
        elementwise("loss", &added(&gpu, &partials, size), &expected, 1e-6, 2e-6).expect("losses");
    }
}

/// Losses and gradient by the engine, on a device whose buffers hold at most `largest` bytes.
fn engine_loss(pictures: &Pictures, layout: NativeLayout, largest: Option<u64>) -> (Vec<f32>, Vec<f32>) {
    let limits = LimitsOverride { max_storage_buffer_range: largest, ..LimitsOverride::default() };
    let options = ContextOptions { limits_override: Some(limits), ..options() };
    let context = Context::new(&options).expect("a device");
    let format = if pictures.masked { PhotoFormat::MaskedRgba8 } else { PhotoFormat::Rgba8 };
    let loss = Loss::with_layout(&context, format, layout).expect("kernels");
    let [width, height] = pictures.size;
    let (rendered_values, photo_values) = (pictures.rendered(layout), pictures.photo(layout));
    let mut requests = loss.scratch_requests([(width, height)]);
    let parts = requests.len();
    let derivatives = requests.iter().filter(|(name, _)| *name == "ssim_derivatives").count();
    assert_eq!(derivatives, if largest.is_some() { 3 } else { 1 });
    requests.extend([
        ("losses", 16),
        ("rendered", 4 * rendered_values.len() as u64),
        ("photo", photo_values.len() as u64),
        ("image_gradient", 4 * pictures.gradient_words(layout) as u64),
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
    });
    run.expect("a run");
    crate::common::assert_silent(&context);
    let floats = |buffer: &Buffer| -> Vec<f32> {
        bytemuck::pod_collect_to_vec(&context.download(buffer).expect("a download"))
    };
    let words = floats(image_gradient);
    let gradient = pictures.gradient(layout, &words[..pictures.gradient_words(layout)]);
    (floats(losses), gradient.into_flattened())
}

/// If the derivatives of all channels do not fit into one buffer, the engine computes them one by one, to the same
/// bits.
#[test]
fn loss_in_one_buffer_or_three() {
    let pictures = Pictures::random([67, 41]);
    for layout in Gpu::new().layouts() {
        let at_once = engine_loss(&pictures, layout, None);
        assert!(at_once == engine_loss(&pictures, layout, Some(63_000)), "{layout:?}");
    }
}

/// A mask that keeps everything changes nothing, to the bit. Masked pixels do not matter, to the bit.
#[test]
fn loss_under_masks() {
    for layout in Gpu::new().layouts() {
        let mut pictures = Pictures::random([67, 41]);
        let unmasked = engine_loss(&pictures, layout, None);
        pictures.masked = true;
        pictures.photo.iter_mut().for_each(|word| *word |= 0xFF00_0000);
        assert!(engine_loss(&pictures, layout, None) == unmasked, "{layout:?}");
        let mut pictures = Pictures::masked([67, 41]);
        let masked = engine_loss(&pictures, layout, None);
        assert!(masked != unmasked);
        let hidden: Vec<usize> = (0..pictures.pixels()).filter(|&i| !pictures.counts(i)).collect();
        for i in hidden {
            pictures.photo[i] = 0x0055_AA11;
            pictures.accumulated[i] = [0.9, 0.1, 1.5, 0.7];
            assert_eq!(masked.1[4 * i..4 * i + 3], [0.0; 3]);
        }
        assert!(engine_loss(&pictures, layout, None) == masked, "{layout:?}");
    }
}

/// Texels need push descriptors: without them, the loss uses its other form.
#[test]
fn loss_without_texels() {
    let options = ContextOptions { push_descriptors: false, ..options() };
    let context = Context::new(&options).expect("a device");
    assert_eq!(NativeLayout::of(context.limits()), NativeLayout::Rows);
    assert!(Loss::new(&context, PhotoFormat::Rgba8).is_ok());
    let refused = Loss::with_layout(&context, PhotoFormat::Rgba8, NativeLayout::Strips).err();
    let message = refused.expect("no texels").to_string();
    let names = message.contains("loss/ssim_forward_sweep") && message.contains("VK_KHR_push_descriptor");
    assert!(names, "{message}");
}
