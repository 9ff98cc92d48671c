//! wgpu_sort 0.1.0 beside ashsplat's sort: pairs of a u32 key and a u32 value.

use crate::measure;
use crate::measure::{Result, Run};
use ashsplat::frame::SORT_ARRIVAL_BYTES;
use ashsplat::passes::sort::{RadixSort, SortBuffers, Values};
use ashsplat::vk::{Buffer, Context, ContextOptions, MemoryKind};
use std::num::NonZeroU32;
use wgpu_0_19 as wgpu;
use wgpu_sort::{GPUSorter, utils};

/// Compares sorts of hashed keys, with the indices as values.
pub fn run(pairs: u32, runs: usize) -> Result<()> {
    let keys: Vec<u32> = (0..pairs).map(hash).collect();
    let mut expected: Vec<(u32, u32)> = keys.iter().copied().zip(0..).collect();
    expected.sort_by_key(|&(key, _)| key);
    let mut ours = Ours::new(&keys)?;
    let mut theirs = Theirs::new(&keys)?;
    let medians = measure::in_turn(runs, || ours.sort(), || theirs.sort())?;
    let right = |sorted: Vec<(u32, u32)>| {
        let keys = sorted.iter().zip(&expected).all(|(a, b)| a.0 == b.0);
        match (sorted == expected, keys) {
            (true, _) => "right and stable",
            (_, true) => "keys right, values not as of a stable sort",
            _ => "wrong",
        }
    };
    let likeness = format!(
        "ours: {}; theirs, {} lanes: {}",
        right(ours.sorted()?),
        theirs.lanes,
        right(theirs.sorted())
    );
    measure::print(&format!("sorting {pairs} pairs: wgpu_sort 0.1.0"), medians, &likeness);
    Ok(())
}

fn hash(i: u32) -> u32 {
    let mut x = i.wrapping_mul(0x9E37_79B9) ^ 0x85EB_CA6B;
    x = (x ^ (x >> 16)).wrapping_mul(0x7FEB_352D);
    x = (x ^ (x >> 15)).wrapping_mul(0x846C_A68B);
    x ^ (x >> 16)
}

/// Subgroup sizes that the crate supports.
const LANES: [u32; 6] = [1, 8, 16, 32, 64, 128];

/// True if wgpu_sort sorts keys with this subgroup size.
fn sorts(device: &wgpu::Device, queue: &wgpu::Queue, lanes: u32) -> bool {
    use wgpu::util::DeviceExt;
    let Some(count) = NonZeroU32::new(8192) else { return false };
    let mut keys: Vec<u32> = (0..count.get()).map(hash).collect();
    let sorter = GPUSorter::new(device, lanes);
    let buffers = sorter.create_sort_buffers(device, count);
    let unsorted = device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
        label: Some("unsorted"),
        contents: bytemuck::cast_slice(&keys),
        usage: wgpu::BufferUsages::COPY_SRC,
    });
    let mut encoder = device.create_command_encoder(&Default::default());
    encoder.copy_buffer_to_buffer(&unsorted, 0, buffers.keys(), 0, unsorted.size());
    sorter.sort(&mut encoder, queue, &buffers, None);
    queue.submit([encoder.finish()]);
    let range = 0..unsorted.size();
    let sorted: Vec<u32> = pollster::block_on(utils::download_buffer(buffers.keys(), device, queue, range));
    keys.sort_unstable();
    let right = sorted.iter().zip(&keys).filter(|(a, b)| a == b).count();
    eprintln!("wgpu_sort with {lanes} lanes: {right} of {count} keys where they belong");
    right == keys.len()
}

struct Ours {
    context: Context,
    sort: RadixSort,
    buffers: Vec<Buffer>,
    pairs: u32,
}

impl Ours {
    fn new(keys: &[u32]) -> Result<Self> {
        let context = Context::new(&ContextOptions::default())?;
        let (sort, pairs) = (RadixSort::new(&context)?, keys.len() as u32);
        let words = 4 * u64::from(pairs);
        let requests = [
            ("counts", 16),
            ("keys a", words),
            ("keys b", words),
            ("values a", words),
            ("values b", words),
            ("histogram", 4 * sort.sizes.sort_histogram_words(pairs.into(), u32::BITS)),
            ("digit totals", 4 * sort.digit_total_words()),
            ("unsorted keys", words),
            ("unsorted values", words),
            ("arrivals", SORT_ARRIVAL_BYTES),
        ];
        let buffers = context.allocate("sort", &requests, MemoryKind::Device)?;
        context.upload(&buffers[0], bytemuck::cast_slice(&[pairs, 0, 0, 0]))?;
        context.upload(&buffers[7], bytemuck::cast_slice(keys))?;
        context.upload(&buffers[9], &[0; SORT_ARRIVAL_BYTES as usize])?;
        let values: Vec<u32> = (0..pairs).collect();
        context.upload(&buffers[8], bytemuck::cast_slice(&values))?;
        Ok(Self { context, sort, buffers, pairs })
    }

    fn sort(&mut self) -> Result<Run> {
        let Self { context, sort, buffers: b, pairs } = self;
        context.run("unsorted", |r| {
            r.copy(&b[7], &b[1]);
            r.copy(&b[8], &b[3]);
        })?;
        let buffers = SortBuffers {
            counts: &b[0],
            count_index: 0,
            keys: [&b[1], &b[2]],
            values: [&b[3], &b[4]],
            histogram: &b[5],
            digit_totals: &b[6],
            arrivals: &b[9],
        };
        let elements = ashsplat::passes::scan::Workgroups::Elements((*pairs).into());
        measure::time(|| {
            context.run("sort", |r| {
                sort.record(r, &buffers, Values::Given, u32::BITS, elements);
            })?;
            Ok(())
        })
    }

    fn sorted(&self) -> Result<Vec<(u32, u32)>> {
        let read = |buffer: &Buffer| -> Result<Vec<u32>> {
            Ok(bytemuck::pod_collect_to_vec(&self.context.download(buffer)?))
        };
        Ok(read(&self.buffers[1])?.into_iter().zip(read(&self.buffers[3])?).collect())
    }
}

struct Theirs {
    device: wgpu::Device,
    queue: wgpu::Queue,
    sorter: GPUSorter,
    buffers: wgpu_sort::SortBuffers,
    unsorted: [wgpu::Buffer; 2],
    lanes: u32,
}

impl Theirs {
    fn new(keys: &[u32]) -> Result<Self> {
        use wgpu::util::DeviceExt;
        let backends = wgpu::Backends::VULKAN;
        let instance = wgpu::Instance::new(wgpu::InstanceDescriptor { backends, ..Default::default() });
        let adapter = instance.enumerate_adapters(backends).into_iter().next().ok_or("no Vulkan adapter")?;
        let descriptor = wgpu::DeviceDescriptor { required_limits: adapter.limits(), ..Default::default() };
        let (device, queue) = pollster::block_on(adapter.request_device(&descriptor, None))?;
        let count = NonZeroU32::new(keys.len() as u32).ok_or("no pairs")?;
        // The largest size that passes the crate's own trial; if none does, the first of `LANES` that sorts here.
        let guessed = pollster::block_on(utils::guess_workgroup_size(&device, &queue));
        let lanes = guessed.or_else(|| LANES.into_iter().find(|&lanes| sorts(&device, &queue, lanes)));
        let lanes = lanes.ok_or_else(|| {
            format!("wgpu_sort: neither its own trial nor sorting 8192 pairs with {LANES:?} lanes finds a subgroup size that sorts right")
        })?;
        let sorter = GPUSorter::new(&device, lanes);
        let buffers = sorter.create_sort_buffers(&device, count);
        let values: Vec<u32> = (0..count.get()).collect();
        let unsorted = [keys, &values].map(|words| {
            device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
                label: Some("unsorted"),
                contents: bytemuck::cast_slice(words),
                usage: wgpu::BufferUsages::COPY_SRC,
            })
        });
        Ok(Self { device, queue, sorter, buffers, unsorted, lanes })
    }

    fn sort(&mut self) -> Result<Run> {
        let mut encoder = self.device.create_command_encoder(&Default::default());
        for (from, to) in self.unsorted.iter().zip([self.buffers.keys(), self.buffers.values()]) {
            encoder.copy_buffer_to_buffer(from, 0, to, 0, from.size());
        }
        self.queue.submit([encoder.finish()]);
        self.device.poll(wgpu::Maintain::Wait);
        measure::time(|| {
            let mut encoder = self.device.create_command_encoder(&Default::default());
            self.sorter.sort(&mut encoder, &self.queue, &self.buffers, None);
            self.queue.submit([encoder.finish()]);
            self.device.poll(wgpu::Maintain::Wait);
            Ok(())
        })
    }

    fn sorted(&self) -> Vec<(u32, u32)> {
        let read = |buffer: &wgpu::Buffer| -> Vec<u32> {
            let range = 0..self.unsorted[0].size();
            pollster::block_on(utils::download_buffer(buffer, &self.device, &self.queue, range))
        };
        read(self.buffers.keys()).into_iter().zip(read(self.buffers.values())).collect()
    }
}
