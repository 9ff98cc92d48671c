//! LPIPS: perceptual difference of two pictures by the features of a network (Zhang et al., "The Unreasonable Effectiveness of
//! Deep Features as a Perceptual Metric", CVPR 2018; version 0.1 of their weights).
//!
//! Both pictures pass through AlexNet or VGG16. After five of the ReLUs the features of each pixel are divided by their norm.
//! Their squared differences, weighted per channel, are added up and averaged over the pixels (equation 1 of the paper). 0
//! means equal. The weights are not part of this crate: see [`Weights`].
//!
//! Two measures share this name. The authors recommend, and gsplat reports, AlexNet on values from -1 to 1. The reference
//! implementation of 3D Gaussian Splatting reports VGG16 on values from 0 to 1, for which the network was not trained.
//! [`InputRange`] selects the values.

mod bands;
mod network;

pub use network::{Layer, LayerKind, Network, Weights};

use crate::error::{Error, Result};
use crate::frame::{array_of, blocks};
use crate::kernels::lpips::{convolve, feature_difference, max_pool};
use crate::vk::{Buffer, Context, Kernel, MemoryKind, Recorder};
use bands::{Bands, CHANNELS, Map, PICTURES};
use std::ops::Range;

/// Number of rows per invocation of a convolution.
const ROWS: u32 = 4;
const WORKGROUP: u32 = 128;
/// Maximum bytes of all maps. Larger bands are not faster.
const MAX_BYTES: u64 = 256 << 20;
/// Maximum number of multiplications in a dispatch. It takes a fraction of a second on slow devices, so that no watchdog or
/// timeout ends it.
const MAX_WORK: u64 = 1 << 32;
/// Mean and standard deviation of the networks' training pictures, with values from -1 to 1.
const SHIFT: [f32; 3] = [-0.030, -0.088, -0.188];
const SCALE: [f32; 3] = [0.458, 0.448, 0.450];

/// Range of the values that the network receives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum InputRange {
    /// Unchanged, 0 to 1: "unscaled".
    ZeroToOne,
    /// 2x - 1, the range of the networks' training.
    MinusOneToOne,
}

impl Network {
    /// Returns the range that papers use with this network.
    pub fn usual_range(self) -> InputRange {
        match self {
            Self::AlexNet => InputRange::MinusOneToOne,
            Self::Vgg16 => InputRange::ZeroToOne,
        }
    }

    /// Name of the measure with [`Network::usual_range`]: `lpips_alex`, `lpips_vgg_unscaled`.
    pub fn measure(self) -> &'static str {
        match self {
            Self::AlexNet => "lpips_alex",
            Self::Vgg16 => "lpips_vgg_unscaled",
        }
    }
}

/// Weights of a convolution on the device.
struct Filter {
    weights: Buffer,
    biases: Buffer,
}

/// Memory for pictures of one size.
struct Memory {
    size: (u32, u32),
    bands: Bands,
    maps: Vec<Buffer>,
    /// Differences of a band's pixels, per tap.
    differences: Vec<Buffer>,
}

/// A network with its weights on a device.
pub struct Lpips {
    context: Context,
    network: Network,
    workgroup: u32,
    /// Kernels by size and stride.
    convolve: Vec<([u32; 2], Kernel<convolve::Interface>)>,
    pool: Kernel<max_pool::Interface>,
    difference: Kernel<feature_difference::Interface>,
    filters: Vec<Filter>,
    heads: Vec<Buffer>,
    memory: Option<Memory>,
}

impl Lpips {
    /// Builds the kernels and uploads the weights: 10 MB for AlexNet, 59 MB for VGG16.
    ///
    /// # Errors
    /// Same as [`Weights::check`]; when the device refuses a pipeline or memory is short.
    pub fn new(context: &Context, weights: &Weights) -> Result<Self> {
        weights.check()?;
        let network = weights.network;
        let workgroup_size = context.limits().workgroup_size(WORKGROUP);
        let mut convolve: Vec<([u32; 2], Kernel<convolve::Interface>)> = Vec::new();
        for layer in network.convolutions() {
            let window @ [size, stride] = [layer.size, layer.stride];
            if convolve.iter().all(|(known, _)| *known != window) {
                let spec = convolve::Spec { workgroup_size, size, stride, rows: ROWS };
                convolve.push((window, Kernel::new(context, &spec)?));
            }
        }
        let pool = network.layers().iter().find(|layer| layer.kind == LayerKind::MaxPool);
        let [size, stride] = pool.map_or([2, 2], |layer| [layer.size, layer.stride]);
        let mut filters = Vec::new();
        for (layer, (weights, biases)) in network.convolutions().zip(&weights.convolutions) {
            let packed = packed_weights(layer, weights);
            let requests = [("weights", bytes_of(&packed)), ("biases", bytes_of(biases))];
            let buffers = context.allocate("lpips weights", &requests, MemoryKind::Device)?;
            let [weights, own_biases] = array_of(buffers);
            context.upload(&weights, bytemuck::cast_slice(&packed))?;
            context.upload(&own_biases, bytemuck::cast_slice(biases))?;
            filters.push(Filter { weights, biases: own_biases });
        }
        let requests: Vec<_> = weights.heads.iter().map(|head| ("heads", bytes_of(head))).collect();
        let heads = context.allocate("lpips weights", &requests, MemoryKind::Device)?;
        for (buffer, head) in heads.iter().zip(&weights.heads) {
            context.upload(buffer, bytemuck::cast_slice(head))?;
        }
        Ok(Self {
            context: context.clone(),
            network,
            workgroup: workgroup_size,
            convolve,
            pool: Kernel::new(context, &max_pool::Spec { workgroup_size, size, stride })?,
            difference: Kernel::new(context, &feature_difference::Spec { workgroup_size })?,
            filters,
            heads,
            memory: None,
        })
    }

    /// Returns the network.
    pub fn network(&self) -> Network {
        self.network
    }

    /// LPIPS of two pictures in the network's usual range: see [`Lpips::distances`].
    ///
    /// # Errors
    /// Same as [`Lpips::distances`].
    pub fn distance(&mut self, pictures: [&[[f32; 3]]; 2], size: (u32, u32)) -> Result<f64> {
        let range = self.network.usual_range();
        Ok(self.distances(pictures, size, range)?.iter().sum())
    }

    /// The five parts of LPIPS, each the mean over the pixels of a tap; their sum is LPIPS. The pictures are rgb, row-major,
    /// `size` pixels (width, height), and are clamped to [0, 1], but not rescaled to another size.
    ///
    /// Memory is bounded: for large pictures the layers only hold bands of rows. The bits of the result do not depend on the
    /// bands.
    ///
    /// # Errors
    /// [`Error::Argument`] for a picture of a different or too small size; [`Error::TooLarge`] when not even bands of one row
    /// fit the memory; device failures.
    pub fn distances(
        &mut self,
        pictures: [&[[f32; 3]]; 2],
        size: (u32, u32),
        range: InputRange,
    ) -> Result<[f64; 5]> {
        let (width, height) = size;
        let pixels = width as usize * height as usize;
        if let Some(other) = pictures.iter().find(|picture| picture.len() != pixels) {
            let problem = format!("has {} pixels, must have {width}x{height}", other.len());
            return Err(Error::argument("picture for LPIPS", problem));
        }
        self.network.check_size(width, height)?;
        let mut memory = match self.memory.take() {
            Some(memory) if memory.size == size => memory,
            other => {
                drop(other);
                self.allocate(size)?
            }
        };
        let distances = self.run(&mut memory, pictures, range);
        // With a memory limit, frames between two measurements need this memory.
        if self.context.max_memory().is_none() {
            self.memory = Some(memory);
        }
        distances
    }

    /// Frees the memory for the last size of pictures.
    pub fn shrink(&mut self) {
        self.memory = None;
    }

    fn run(&self, memory: &mut Memory, pictures: [&[[f32; 3]]; 2], range: InputRange) -> Result<[f64; 5]> {
        let Memory { bands, maps, differences, .. } = memory;
        let mut sums = [0.0; 5];
        let taps: Vec<usize> = self.taps().collect();
        for rows in &bands.rows {
            let texels = input(&bands.maps[0], rows[0].end, pictures, range);
            self.context.upload(&maps[0], bytemuck::cast_slice(&texels))?;
            self.context.run("lpips", |r| self.record(r, bands, rows, maps, differences))?;
            for ((sum, &map), buffer) in sums.iter_mut().zip(&taps).zip(differences.iter()) {
                let values = rows[map].len() as u64 * u64::from(bands.maps[map].width);
                self.context.download_chunks(&buffer.range(0, 4 * values), |bytes| {
                    for value in bytes.chunks_exact(4) {
                        *sum += f64::from(bytemuck::pod_read_unaligned::<f32>(value));
                    }
                })?;
            }
        }
        for (sum, &map) in sums.iter_mut().zip(&taps) {
            *sum /= f64::from(bands.maps[map].width) * f64::from(bands.maps[map].height);
        }
        Ok(sums)
    }

    /// Indices of the compared maps.
    fn taps(&self) -> impl Iterator<Item = usize> {
        let layers = self.network.layers().iter().enumerate();
        layers.filter(|(_, layer)| layer.is_tap).map(|(index, _)| index + 1)
    }

    /// Records all layers of a band.
    fn record(
        &self,
        r: &mut Recorder,
        bands: &Bands,
        rows: &[Range<u32>],
        maps: &[Buffer],
        differences: &[Buffer],
    ) {
        let mut filters = self.filters.iter();
        let mut taps = self.heads.iter().zip(differences);
        for (index, layer) in self.network.layers().iter().enumerate() {
            let filter = if layer.kind == LayerKind::Convolution { filters.next() } else { None };
            let tap = if layer.is_tap { taps.next() } else { None };
            let (input, output) = (&bands.maps[index], &bands.maps[index + 1]);
            let (inputs, outputs) = (&maps[index], &maps[index + 1]);
            let (first, rows) = (rows[index + 1].start, rows[index + 1].len() as u32);
            if rows == 0 {
                continue;
            }
            let kernel = |(known, _): &&([u32; 2], _)| *known == [layer.size, layer.stride];
            match filter.zip(self.convolve.iter().find(kernel)) {
                Some((Filter { weights, biases }, (_, kernel))) => {
                    let push = convolve::Push {
                        in_blocks: input.blocks,
                        in_height: input.height,
                        in_slots: input.slots,
                        in_pitch: input.pitch(),
                        padding: layer.padding,
                        out_blocks: output.blocks,
                        out_width: output.width,
                        out_slots: output.slots,
                        out_pitch: output.pitch(),
                        out_margin: output.margin,
                        first,
                        rows,
                    };
                    let bind = convolve::Bind { inputs, weights, biases, outputs };
                    r.dispatch_3d(kernel, &bind, &push, self.grid(output, rows.div_ceil(ROWS)));
                }
                None => {
                    let push = max_pool::Push {
                        blocks: output.blocks,
                        in_height: input.height,
                        in_slots: input.slots,
                        in_pitch: input.pitch(),
                        out_width: output.width,
                        out_slots: output.slots,
                        out_pitch: output.pitch(),
                        out_margin: output.margin,
                        first,
                        rows,
                    };
                    let bind = max_pool::Bind { inputs, outputs };
                    r.dispatch_3d(&self.pool, &bind, &push, self.grid(output, rows));
                }
            }
            r.barrier();
            if let Some((heads, differences)) = tap {
                let push = feature_difference::Push {
                    blocks: output.blocks,
                    width: output.width,
                    slots: output.slots,
                    pitch: output.pitch(),
                    margin: output.margin,
                    first,
                    rows,
                };
                let bind = feature_difference::Bind { features: outputs, heads, differences };
                let pixels = u64::from(output.width) * u64::from(rows);
                r.dispatch(&self.difference, &bind, &push, blocks(pixels, self.workgroup.into()));
            }
        }
    }

    /// Grid of a layer's dispatch: one invocation per column and row, or group of rows, for each block and picture.
    fn grid(&self, output: &Map, rows: u32) -> [u32; 3] {
        [(output.width * rows).div_ceil(self.workgroup), output.blocks, PICTURES]
    }

    /// Allocates memory for the largest bands that fit.
    fn allocate(&self, size: (u32, u32)) -> Result<Memory> {
        let context = &self.context;
        let limits = context.limits();
        let binding = limits.max_storage_buffer_range.min(limits.max_allocation_bytes);
        let taken = context.memory_total().bytes;
        let bound = context.memory_limit().map(|(bytes, name)| (bytes.saturating_sub(taken), name));
        let max = bound.map_or(MAX_BYTES, |(bytes, _)| bytes.min(MAX_BYTES));
        let mut band = size.1;
        loop {
            let bands = Bands::new(self.network, size, band);
            let requests = self.requests(&bands);
            let needed = context.allocation_bytes(&requests)
                + context.staging_bytes(bands.largest()).max(context.min_ring());
            let binds = bands.largest() <= binding;
            let axis = bands.max_grid(self.workgroup) <= limits.max_workgroups_per_axis;
            if binds && axis && (band == 1 || needed <= max && bands.max_work(self.network) <= MAX_WORK) {
                return self.allocate_bands(size, bands, &requests);
            }
            if band == 1 {
                let ((width, height), network) = (size, self.network.name());
                let what = format!("a row of LPIPS of {width}x{height} pixels with {network}");
                let limit = (binding, "maxStorageBufferRange");
                return Err(Error::too_large(what, (bands.largest(), "bytes"), limit));
            }
            band = if band > 128 { (band / 2).next_multiple_of(64) } else { band / 2 };
        }
    }

    fn requests(&self, bands: &Bands) -> Vec<(&'static str, u64)> {
        let maps = bands.maps.iter().map(|map| ("features", map.bytes()));
        let differences = self.taps().map(|map| {
            let values = u64::from(bands.max_rows(map)) * u64::from(bands.maps[map].width);
            ("differences", 4 * values)
        });
        maps.chain(differences).collect()
    }

    /// Allocates memory for these bands, and writes their columns and rows of zeros once.
    fn allocate_bands(
        &self,
        size: (u32, u32),
        bands: Bands,
        requests: &[(&'static str, u64)],
    ) -> Result<Memory> {
        let mut maps = self.context.allocate("lpips", requests, MemoryKind::Device)?;
        let differences = maps.split_off(bands.maps.len());
        self.context.run("lpips zeros", |r| maps.iter().for_each(|map| r.fill(map, 0)))?;
        Ok(Memory { size, bands, maps, differences })
    }
}

fn bytes_of(values: &[f32]) -> u64 {
    size_of_val(values) as u64
}

/// Reorders weights for the kernel: (output block, ky, input block, kx, input of the block, output of the block).
pub fn packed_weights(layer: &Layer, weights: &[f32]) -> Vec<f32> {
    let [inputs, outputs, size] = [layer.inputs, layer.outputs, layer.size].map(|n| n as usize);
    let four = CHANNELS as usize;
    let mut packed = Vec::with_capacity(outputs * inputs.next_multiple_of(four) * size * size);
    for (block, ky) in (0..outputs / four).flat_map(|block| (0..size).map(move |ky| (block, ky))) {
        for (input, kx) in (0..inputs).step_by(four).flat_map(|i| (0..size).map(move |kx| (i, kx))) {
            for input in input..input + four {
                let weight = |output: usize| weights[((output * inputs + input) * size + ky) * size + kx];
                let own =
                    (four * block..four * (block + 1)).map(|o| if input < inputs { weight(o) } else { 0.0 });
                packed.extend(own);
            }
        }
    }
    packed
}

/// Texels of the input map with the rows up to `end`.
fn input(map: &Map, end: u32, pictures: [&[[f32; 3]]; 2], range: InputRange) -> Vec<[f32; 4]> {
    let (slots, pitch) = (map.slots as usize, map.pitch() as usize);
    let (width, margin) = (map.width as usize, map.margin as usize);
    let mut texels = vec![[0.0; 4]; PICTURES as usize * (slots + 1) * pitch];
    for (picture, planes) in pictures.iter().zip(texels.chunks_exact_mut((slots + 1) * pitch)) {
        for row in end.saturating_sub(map.slots) as usize..end as usize {
            let at = row % slots * pitch + margin;
            let pixels = &picture[row * width..(row + 1) * width];
            for (texel, pixel) in planes[at..at + width].iter_mut().zip(pixels) {
                let [r, g, b] = [0, 1, 2].map(|c| {
                    let value = pixel[c].clamp(0.0, 1.0);
                    let value = match range {
                        InputRange::ZeroToOne => value,
                        InputRange::MinusOneToOne => 2.0 * value - 1.0,
                    };
                    (value - SHIFT[c]) / SCALE[c]
                });
                *texel = [r, g, b, 0.0];
            }
        }
    }
    texels
}
