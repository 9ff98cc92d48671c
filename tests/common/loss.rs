//! The kernels of the loss, with their inputs on the device.

use ashsplat::kernels::loss::{ssim_backward, ssim_backward_sweep, ssim_forward, ssim_forward_sweep};
use ashsplat::loss::{Windowing, photo_on_device};
use ashsplat::plan::Strips;
use ashsplat::vk::Buffer;

use super::gpu::Gpu;
use super::scenes::Random;
use crate::reference::ssim_forward::Plane;

pub const BACKGROUND: [f64; 3] = [0.25, 0.5, 0.75];

/// A rendered picture and a photograph.
pub struct Pictures {
    pub size: [u32; 2],
    /// Colour without background, and transmittance, as the blending writes them.
    pub accumulated: Vec<[f32; 4]>,
    /// RGBA8.
    pub photo: Vec<u32>,
    /// True if the photograph's fourth byte is a mask.
    pub masked: bool,
}

impl Pictures {
    /// Random pictures with structure, so that SSIM is neither 0 nor 1.
    pub fn random(size: [u32; 2]) -> Pictures {
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
    pub fn masked(size: [u32; 2]) -> Pictures {
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

    /// True if the mask keeps a pixel.
    pub fn counts(&self, pixel: usize) -> bool {
        !self.masked || self.photo[pixel] >> 24 != 0
    }

    pub fn pixels(&self) -> usize {
        self.accumulated.len()
    }

    /// A channel of the composited picture and of the photograph.
    pub fn planes(&self, channel: usize) -> [Plane; 2] {
        let [width, height] = self.size.map(|n| n as usize);
        let rendered = |t: &[f32; 4]| f64::from(t[channel]) + f64::from(t[3]) * BACKGROUND[channel];
        let taken = |word: &u32| f64::from(word >> (8 * channel) & 0xFF) / 255.0;
        let times_mask = |(i, value)| if self.counts(i) { value } else { 0.0 };
        let rendered = self.accumulated.iter().map(rendered).enumerate().map(times_mask).collect();
        let taken = self.photo.iter().map(taken).enumerate().map(times_mask).collect();
        [Plane { width, height, values: rendered }, Plane { width, height, values: taken }]
    }

    pub fn strips(&self) -> Strips {
        let [width, height] = self.size;
        Strips { width, height }
    }

    /// The rendered picture in the layout of this form of the loss.
    pub fn rendered(&self, windowing: Windowing) -> Vec<f32> {
        let composited = |t: &[f32; 4]| [0, 1, 2].map(|c| t[c] + t[3] * BACKGROUND[c] as f32);
        match windowing {
            Windowing::Blocks => self.accumulated.as_flattened().to_vec(),
            Windowing::Sweeps => self.strips().planes(self.accumulated.iter().map(composited)),
        }
    }

    /// The photograph in the layout of this form of the loss.
    pub fn photo(&self, windowing: Windowing) -> Vec<u8> {
        let [width, height] = self.size;
        photo_on_device(windowing, width, height, self.masked, bytemuck::cast_slice(&self.photo).to_vec())
    }

    /// Number of words of the gradient.
    pub fn gradient_words(&self, windowing: Windowing) -> usize {
        match windowing {
            Windowing::Blocks => 4 * self.pixels(),
            Windowing::Sweeps => 3 * self.strips().values() as usize,
        }
    }

    /// The gradient per pixel; the fourth component is only that of blocks.
    pub fn gradient(&self, windowing: Windowing, words: &[f32]) -> Vec<[f32; 4]> {
        match windowing {
            Windowing::Blocks => words.as_chunks::<4>().0.to_vec(),
            Windowing::Sweeps => (0..self.pixels() as u32)
                .map(|i| {
                    let (x, y) = (i % self.size[0], i / self.size[0]);
                    let [r, g, b] = [0, 1, 2].map(|plane| words[self.strips().index(plane, x, y)]);
                    [r, g, b, 0.0]
                })
                .collect(),
        }
    }

    /// Workgroup counts: blocks of 16×16, and channels.
    pub fn grid(&self) -> [u32; 3] {
        [self.size[0].div_ceil(16), self.size[1].div_ceil(16), 3]
    }
}

/// Kernels that compute the window, and the work of one invocation.
#[derive(Clone, Copy, Debug)]
pub enum Window {
    Block { strip: u32 },
    Sweep { columns: u32 },
}

impl Window {
    pub fn windowing(self) -> Windowing {
        match self {
            Self::Block { .. } => Windowing::Blocks,
            Self::Sweep { .. } => Windowing::Sweeps,
        }
    }

    /// Number of words of the derivatives.
    pub fn derivative_words(self, pictures: &Pictures) -> usize {
        match self {
            Self::Block { .. } => 9 * pictures.pixels(),
            Self::Sweep { .. } => 9 * pictures.strips().values() as usize,
        }
    }

    /// Index of the word with the derivative by moment `k`.
    pub fn derivative_place(self, pictures: &Pictures, channel: usize, pixel: usize, k: usize) -> usize {
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
    pub fn derivatives_below(self, pictures: &Pictures) -> Vec<usize> {
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

    /// Number of partial sums of a channel.
    pub fn partials(self, pictures: &Pictures) -> usize {
        let [width, height] = pictures.size;
        match self {
            Self::Block { .. } => (pictures.grid()[0] * pictures.grid()[1]) as usize,
            Self::Sweep { columns } => (height.div_ceil(8) * width.div_ceil(columns)) as usize,
        }
    }
}

/// Runs the forward kernel. Returns derivatives of SSIM per channel and pixel, and partial sums.
pub fn forward(gpu: &Gpu, pictures: &Pictures, window: Window) -> (Buffer, Buffer) {
    let rendered = &gpu.buffer("rendered", &pictures.rendered(window.windowing()));
    let photo = &gpu.buffer("photo", &pictures.photo(window.windowing()));
    let count = 3 * window.partials(pictures);
    let derivatives = gpu.untouched::<f32>("derivatives", window.derivative_words(pictures));
    let loss_partials = gpu.untouched::<[f32; 2]>("loss_partials", count);
    let [image_width, image_height] = pictures.size;
    let background = BACKGROUND.map(|x| x as f32);
    let (workgroup_size, float_photo, masked) = (gpu.workgroup(64), false, pictures.masked);
    match window {
        Window::Block { strip } => {
            let subgroup_size = gpu.subgroup();
            let spec = ssim_forward::Spec { workgroup_size, subgroup_size, strip, float_photo, masked };
            let kernel = gpu.kernel::<ssim_forward::Interface>(&spec);
            let bind = ssim_forward::Bind {
                accumulated: rendered,
                photo,
                derivatives: &derivatives,
                loss_partials: &loss_partials,
            };
            let push = ssim_forward::Push { image_width, image_height, background, first_channel: 0 };
            gpu.run(|recorder| recorder.dispatch_3d(&kernel, &bind, &push, pictures.grid()));
        }
        Window::Sweep { columns } => {
            let spec = ssim_forward_sweep::Spec { workgroup_size, float_photo, masked };
            let kernel = gpu.kernel::<ssim_forward_sweep::Interface>(&spec);
            let bind = ssim_forward_sweep::Bind {
                rendered,
                photo,
                derivatives: &derivatives,
                loss_partials: &loss_partials,
            };
            let push = ssim_forward_sweep::Push {
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

/// Weight of the loss.
pub const WEIGHT: f32 = 0.7;

/// Runs the backward kernel. Returns [`WEIGHT`] dL/d(r, g, b) and a fourth component that it does not write.
pub fn backward(
    gpu: &Gpu,
    pictures: &Pictures,
    derivatives: &Buffer,
    window: Window,
    lambda_dssim: f32,
) -> Vec<[f32; 4]> {
    let rendered = &gpu.buffer("rendered", &pictures.rendered(window.windowing()));
    let photo = &gpu.buffer("photo", &pictures.photo(window.windowing()));
    let words = pictures.gradient_words(window.windowing());
    let image_gradient = gpu.untouched::<f32>("image_gradient", words);
    let [image_width, image_height] = pictures.size;
    let background = BACKGROUND.map(|x| x as f32);
    let (workgroup_size, float_photo, first_channel) = (gpu.workgroup(64), false, 0);
    let masked = pictures.masked;
    match window {
        Window::Block { strip } => {
            let spec = ssim_backward::Spec { workgroup_size, strip, float_photo, masked };
            let kernel = gpu.kernel::<ssim_backward::Interface>(&spec);
            let bind = ssim_backward::Bind {
                accumulated: rendered,
                photo,
                derivatives,
                image_gradient: &image_gradient,
            };
            let push = ssim_backward::Push {
                image_width,
                image_height,
                background,
                first_channel,
                lambda_dssim,
                weight: WEIGHT,
            };
            gpu.run(|recorder| recorder.dispatch_3d(&kernel, &bind, &push, pictures.grid()));
        }
        Window::Sweep { columns } => {
            let subgroup_size = gpu.subgroup();
            let spec = ssim_backward_sweep::Spec { workgroup_size, subgroup_size, float_photo, masked };
            let kernel = gpu.kernel::<ssim_backward_sweep::Interface>(&spec);
            let bind = ssim_backward_sweep::Bind {
                rendered,
                photo,
                derivatives,
                image_gradient: &image_gradient,
                // Unused without partial sums.
                loss_partials: derivatives,
                losses: &image_gradient,
            };
            let invocations = 3 * window.partials(pictures) as u32;
            let push = ssim_backward_sweep::Push {
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
    pictures.gradient(window.windowing(), &gpu.read::<f32>(&image_gradient, words))
}

/// Image sizes around the block and apron sizes.
pub const SIZES: [[u32; 2]; 8] = [[1, 1], [5, 3], [16, 16], [17, 5], [15, 33], [31, 48], [64, 10], [90, 70]];

/// Columns per invocation of the sweeping kernels.
pub const SWEEPS: [u32; 3] = [3, 7, 48];
