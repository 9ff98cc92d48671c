//! `bench scan` and `bench sort`: the primitives alone, checked.

use super::measure::{Iterations, Measured, measure};
use super::schema::{CopyBandwidth, Run, Workload};
use super::synthetic;
use super::traffic::Traffic;
use super::workload::Fnv;
use ashsplat::frame::SORT_ARRIVAL_BYTES;
use ashsplat::passes::scan::{Scan, ScanBuffers, Workgroups};
use ashsplat::passes::sort::{RadixSort, SortBuffers, Values};
use ashsplat::vk::{Buffer, Context, MemoryKind};
use ashsplat::{Error, Result};

#[derive(Clone, Copy)]
pub struct Job<'a> {
    pub context: &'a Context,
    pub iterations: Iterations,
    pub copy: Option<&'a CopyBandwidth>,
    /// Number of values or pairs.
    pub elements: u32,
    pub seed: u64,
}

impl Job<'_> {
    fn buffers(&self, requests: &[(&'static str, u64)]) -> Result<Vec<Buffer>> {
        self.context.allocate("primitive", requests, MemoryKind::Device)
    }

    fn run(&self, name: &str, input: &[u32], measured: &Measured) -> Run {
        let mut hash = Fnv::default();
        hash.add(bytemuck::cast_slice(input));
        let workload = Workload {
            source: format!("synthetic, seed {}", self.seed),
            hash: hash.hex(),
            elements: Some(self.elements.into()),
            ..Workload::default()
        };
        measured.run(self.context, name, workload, (&Traffic::bound(), self.copy))
    }
}

/// Measures the exclusive prefix sum.
pub fn scan(job: &Job) -> Result<Run> {
    let scan = Scan::new(job.context)?;
    let values = synthetic::counts(job.seed, job.elements as usize);
    let (words, scratch) = (u64::from(job.elements) * 4, scan.block_words(job.elements.into()) * 4);
    let requests = [("counts", 16), ("values", words), ("prefix", words), ("block_sums", scratch)];
    let b = job.buffers(&requests)?;
    upload(job.context, &b[0], &[job.elements, 0, 0, 0])?;
    upload(job.context, &b[1], &values)?;
    let buffers = ScanBuffers {
        counts: &b[0],
        count_index: 0,
        total_index: 1,
        values: &b[1],
        prefix: &b[2],
        block_sums: &b[3],
    };
    let elements = Workgroups::Elements(job.elements.into());
    let iterate = || {
        let recorded = job.context.run("scan", |r| r.scope("scan", |r| scan.record(r, &buffers, elements)));
        recorded.map(drop)
    };
    let measured = measure(job.context, job.iterations, || Ok(()), iterate)?;
    let next = |sum: &mut u32, &value: &u32| Some(std::mem::replace(sum, sum.wrapping_add(value)));
    let expected = values.iter().scan(0, next);
    let prefix: Vec<u32> = download(job.context, &b[2], job.elements)?;
    if !expected.eq(prefix) {
        return Err(wrong("scan"));
    }
    Ok(job.run("scan", &values, &measured))
}

/// Measures the stable sort of (u32 key, u32 value) pairs.
pub fn sort(job: &Job) -> Result<Run> {
    let sort = RadixSort::new(job.context)?;
    let keys = synthetic::keys(job.seed, job.elements as usize);
    let words = u64::from(job.elements) * 4;
    let histogram = sort.sizes.sort_histogram_words(job.elements.into(), u32::BITS) * 4;
    let requests = [
        ("counts", 16),
        ("keys_a", words),
        ("keys_b", words),
        ("values_a", words),
        ("values_b", words),
        ("histogram", histogram),
        ("digit_totals", sort.digit_total_words() * 4),
        ("unsorted", words),
        ("arrivals", SORT_ARRIVAL_BYTES),
    ];
    let b = job.buffers(&requests)?;
    upload(job.context, &b[0], &[job.elements, 0, 0, 0])?;
    upload(job.context, &b[7], &keys)?;
    upload(job.context, &b[8], &[0; SORT_ARRIVAL_BYTES as usize / 4])?;
    let buffers = SortBuffers {
        counts: &b[0],
        count_index: 0,
        keys: [&b[1], &b[2]],
        values: [&b[3], &b[4]],
        histogram: &b[5],
        digit_totals: &b[6],
        arrivals: &b[8],
    };
    let elements = Workgroups::Elements(job.elements.into());
    let prepare = || {
        let copied = job.context.run("unsorted keys", |r| r.copy(&b[7], &b[1]));
        copied.map(drop)
    };
    let iterate = || {
        let recorded = job.context.run("sort", |r| {
            r.scope("sort", |r| sort.record(r, &buffers, Values::Positions, u32::BITS, elements));
        });
        recorded.map(drop)
    };
    let measured = measure(job.context, job.iterations, prepare, iterate)?;
    let (sorted_keys, sorted_values): (Vec<u32>, Vec<u32>) =
        (download(job.context, &b[1], job.elements)?, download(job.context, &b[3], job.elements)?);
    let mut expected: Vec<(u32, u32)> = keys.iter().copied().zip(0..).collect();
    expected.sort_by_key(|&(key, _)| key);
    if !expected.iter().copied().eq(sorted_keys.into_iter().zip(sorted_values)) {
        return Err(wrong("sort"));
    }
    Ok(job.run("sort", &keys, &measured))
}

fn wrong(what: &str) -> Error {
    Error::argument(what, "gave a wrong result on this device: run the tests (`cargo test --release`)")
}

fn upload(context: &Context, buffer: &Buffer, words: &[u32]) -> Result<()> {
    context.upload(buffer, bytemuck::cast_slice(words))
}

fn download(context: &Context, buffer: &Buffer, count: u32) -> Result<Vec<u32>> {
    if count == 0 {
        return Ok(Vec::new());
    }
    let bytes = context.download(&buffer.range(0, u64::from(count) * 4))?;
    Ok(bytemuck::pod_collect_to_vec(&bytes))
}
