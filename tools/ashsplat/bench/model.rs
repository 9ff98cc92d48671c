//! `bench model`: the least time that each kernel of a measured workload can take on a GPU that is not at hand, from what the
//! kernels move and compute and from the GPU's data sheet. A model, never a measurement.

use super::compiled;
use super::gpus::{Gpu, Sheet};
use super::schema::{KernelResult, Report, Run};
use super::{compare, table};
use crate::output;
use ashsplat::tuning::Backend;
use ashsplat::{Error, Result};
use clap::Args;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// The schema's name and version, first field of every file.
const SCHEMA: &str = "ashsplat-model/1";

/// What to model.
#[derive(Args)]
pub struct Arguments {
    /// A result of `bench --backend gpu --json`: which kernels ran, and what they moved and computed
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// The GPU
    #[arg(long, value_enum)]
    gpu: Gpu,
    /// A file of `profile --static --json` for that GPU or one like it: says beside the bounds how long one subgroup takes by the
    /// compiler's estimate, which guesses how often loops run
    #[arg(long = "static", value_name = "FILE")]
    compiled: Option<PathBuf>,
    /// Time from one dispatch to the next that waits for it behind a barrier, microseconds: an assumption, no data sheet has it
    #[arg(long, value_name = "US", default_value_t = 3.0, value_parser = parse_time)]
    dispatch_us: f64,
    /// Say what would have to be true for a run to take no longer, milliseconds
    #[arg(long, value_name = "MS", value_parser = parse_time)]
    target_ms: Option<f64>,
    /// Write the result here (schema ashsplat-model/1)
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
}

fn parse_time(text: &str) -> Result<f64, String> {
    let time = text.parse().ok().filter(|time: &f64| time.is_finite() && *time >= 0.0);
    time.ok_or_else(|| "expected a time, 0 or more".to_owned())
}

/// Bandwidth that plain copies reach on GPUs, of the data sheet's.
const REACHED: f64 = 0.85;

/// What bounds a kernel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
enum Resource {
    Memory,
    /// What a core's load/store unit takes in a cycle.
    Transactions,
    Arithmetic,
    /// From one dispatch to the next.
    Dispatch,
}

impl Resource {
    fn name(self) -> &'static str {
        match self {
            Self::Memory => "memory",
            Self::Transactions => "transactions",
            Self::Arithmetic => "arithmetic",
            Self::Dispatch => "dispatches",
        }
    }
}

/// A kernel's least time, microseconds per iteration.
#[derive(Clone, Debug, PartialEq, Serialize)]
struct Bound {
    scope: String,
    kernel: String,
    calls: u32,
    /// Calls that wait behind a barrier; all of them where the file does not say it.
    waits: u32,
    memory_us: f64,
    /// Segments of the first cache's lines that subgroups touch; those of neighbouring accesses from their bytes.
    segments: u64,
    transactions_us: f64,
    /// Null where instructions are not counted: all but blending.
    arithmetic_us: Option<f64>,
    /// One subgroup's own time by a compiler's estimate: no bound, for how often loops run is guessed. Null without a static file.
    latency_us: Option<f64>,
    dispatch_us: f64,
    /// The largest of memory, transactions and arithmetic, and the dispatches.
    time_us: f64,
    set_by: Resource,
}

/// A run's bounds.
#[derive(Clone, Debug, PartialEq, Serialize)]
struct Modelled {
    name: String,
    width: Option<u32>,
    height: Option<u32>,
    gaussians: Option<u32>,
    elements: Option<u64>,
    total_us: f64,
    /// The same where no kernel takes less than `latency_us`: an estimate. Null without a static file.
    estimate_us: Option<f64>,
    /// Commands, and those that wait behind a barrier.
    calls: u32,
    waits: u32,
    target: Option<Target>,
    kernels: Vec<Bound>,
}

/// What would have to be true for a run to take a time.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
struct Target {
    target_ms: f64,
    /// The share of its bound that every kernel has to reach, where a dispatch takes what was assumed; above 1 it is out of reach.
    /// Null where the dispatches alone take longer.
    share_of_bounds: Option<f64>,
    /// The most that a dispatch may take, where every kernel reaches half of its bound; null where it cannot be.
    dispatch_us: Option<f64>,
}

#[derive(Serialize)]
struct File {
    schema: &'static str,
    /// What this is, for whoever sees the file alone.
    note: &'static str,
    gpu: Sheet,
    dispatch_us: f64,
    runs: Vec<Modelled>,
}

const NOTE: &str = "a model from a data sheet, no measurement: the least time that each kernel can take";

/// Runs the command.
pub fn run(arguments: &Arguments) -> Result<()> {
    output::check(&[("--json", arguments.json.as_deref())])?;
    let report = compare::read(&arguments.file)?;
    check(arguments, &report)?;
    let compiled = arguments.compiled.as_deref().map(compiled::read).transpose()?;
    let sheet = arguments.gpu.sheet();
    if let (Some(compiled), Some(path)) = (&compiled, &arguments.compiled) {
        let [device, driver] = [&compiled.device.name, &compiled.device.driver];
        check_compiled(path, [device, driver], &sheet)?;
        say!("latencies: {device}, {driver}");
    }
    let cycles = compiled.as_ref().map(|compiled| {
        let latency = |(kernel, (heaviest, _)): (&str, (&compiled::Pipeline, usize))| {
            Some((kernel.to_owned(), heaviest.figures.latency?))
        };
        compiled::heaviest(compiled).into_iter().filter_map(latency).collect::<BTreeMap<String, f64>>()
    });
    let of = |run: &Run| {
        let modelled = model(run, &sheet, cycles.as_ref(), arguments.dispatch_us);
        Modelled { target: arguments.target_ms.map(|target_ms| target(&modelled, target_ms)), ..modelled }
    };
    let runs: Vec<Modelled> = report.runs.iter().map(of).collect();
    say!("{}: {NOTE}", sheet.name);
    for run in &runs {
        say!("{}", text(run));
    }
    if let Some(path) = &arguments.json {
        let dispatch_us = arguments.dispatch_us;
        output::write_json(path, &File { schema: SCHEMA, note: NOTE, gpu: sheet, dispatch_us, runs })?;
    }
    Ok(())
}

/// Kernels of processors say nothing of a GPU.
fn check(arguments: &Arguments, report: &Report) -> Result<()> {
    let backend = report.device.backend.as_deref();
    let problem = match backend.map(str::parse) {
        Some(Ok(Backend::Gpu)) => return Ok(()),
        Some(_) => format!("has kernels for a {}", backend.unwrap_or_default()),
        None => "does not say for which backend its kernels are: an older program wrote it".to_owned(),
    };
    Err(Error::input(&arguments.file, problem, "measure with --backend gpu"))
}

/// Another vendor's code says nothing of a GPU.
fn check_compiled(path: &Path, [device, driver]: [&str; 2], sheet: &Sheet) -> Result<()> {
    if sheet.drivers.iter().any(|name| driver.starts_with(name)) {
        return Ok(());
    }
    let problem = format!("is of {device}, {driver}");
    Err(Error::input(path, problem, format!("make one by a driver of the {}", sheet.name)))
}

fn model(run: &Run, sheet: &Sheet, cycles: Option<&BTreeMap<String, f64>>, dispatch_us: f64) -> Modelled {
    let kernels: Vec<Bound> =
        run.kernels.iter().map(|kernel| bound(kernel, sheet, cycles, dispatch_us)).collect();
    let workload = &run.workload;
    Modelled {
        name: run.name.clone(),
        width: workload.width,
        height: workload.height,
        gaussians: workload.gaussians,
        elements: workload.elements,
        total_us: kernels.iter().map(|kernel| kernel.time_us).sum(),
        estimate_us: cycles.map(|_| kernels.iter().map(Bound::estimate_us).sum()),
        calls: kernels.iter().map(|kernel| kernel.calls).sum(),
        waits: kernels.iter().map(|kernel| kernel.waits).sum(),
        target: None,
        kernels,
    }
}

fn target(run: &Modelled, target_ms: f64) -> Target {
    let dispatches: f64 = run.kernels.iter().map(|kernel| kernel.dispatch_us).sum();
    let (work, time) = (run.total_us - dispatches, target_ms * 1e3);
    Target {
        target_ms,
        share_of_bounds: (time > dispatches).then(|| work / (time - dispatches)),
        dispatch_us: Some((time - 2.0 * work) / f64::from(run.waits.max(1))).filter(|us| *us >= 0.0),
    }
}

/// Segments that a kernel's subgroups touch, of the size of the sheet's lines.
fn segments(kernel: &KernelResult, sheet: &Sheet) -> u64 {
    let bytes = kernel.bytes_read + kernel.bytes_written;
    let Some(counted) = &kernel.transactions else { return bytes / u64::from(sheet.line_bytes) };
    let own = counted.by_lanes.iter().find(|of| of.lanes == sheet.subgroup_size);
    let touched = own.map_or(0, |of| if sheet.line_bytes == 64 { of.of_64 } else { of.of_128 });
    // The arrays are among the kernel's bytes, once a call.
    let neighbours = bytes.saturating_sub(counted.array_bytes * u64::from(kernel.calls));
    touched + neighbours / u64::from(sheet.line_bytes)
}

fn bound(
    kernel: &KernelResult,
    sheet: &Sheet,
    cycles: Option<&BTreeMap<String, f64>>,
    dispatch_us: f64,
) -> Bound {
    let bytes = (kernel.bytes_read + kernel.bytes_written) as f64;
    // Gigabytes per second are kilobytes per microsecond.
    let memory_us = bytes / (REACHED * sheet.gigabytes_per_second * 1e3);
    let segments = segments(kernel, sheet);
    let transactions_us = segments as f64 / (sheet.cores * sheet.gigahertz * 1e3);
    let [forward, backward] = sheet.blend_instructions;
    let instructions = if kernel.kernel.starts_with("backward/") { backward } else { forward };
    let arithmetic_us =
        kernel.samples.map(|n| n as f64 * instructions / (sheet.lanes * sheet.gigahertz * 1e3));
    let alone = cycles.and_then(|cycles| cycles.get(&kernel.kernel));
    let latency_us = alone.map(|cycles| f64::from(kernel.calls) * cycles / (sheet.gigahertz * 1e3));
    let waits = kernel.waits.unwrap_or(kernel.calls);
    let dispatch_us = f64::from(waits) * dispatch_us;
    let work = [
        (memory_us, Resource::Memory),
        (transactions_us, Resource::Transactions),
        (arithmetic_us.unwrap_or(0.0), Resource::Arithmetic),
    ];
    let (work_us, by) = work.into_iter().fold((0.0, Resource::Memory), |a, b| if b.0 > a.0 { b } else { a });
    Bound {
        scope: kernel.scope.clone(),
        kernel: kernel.kernel.clone(),
        calls: kernel.calls,
        waits,
        memory_us,
        segments,
        transactions_us,
        arithmetic_us,
        latency_us,
        dispatch_us,
        time_us: work_us + dispatch_us,
        set_by: if dispatch_us > work_us { Resource::Dispatch } else { by },
    }
}

impl Bound {
    /// Its time, if one subgroup's is as its compiler has it.
    fn estimate_us(&self) -> f64 {
        self.time_us.max(self.latency_us.unwrap_or(0.0) + self.dispatch_us)
    }
}

fn text(run: &Modelled) -> String {
    let size = match (run.gaussians, run.width, run.height, run.elements) {
        (Some(n), Some(width), Some(height), _) => {
            format!(", {} Gaussians, {width}x{height}", table::grouped(n.into()))
        }
        (_, _, _, Some(n)) => format!(", {} elements", table::grouped(n)),
        _ => String::new(),
    };
    let per_second = 1e6 / run.total_us.max(1e-9);
    let mut text = format!(
        "\n{}{size}: at least {:.3} ms, at most {per_second:.0} per second; {} commands, {} of them wait behind a barrier",
        run.name,
        run.total_us / 1e3,
        run.calls,
        run.waits
    );
    text += &format!(
        "\n{:<28} {:<34} {:>5} {:>9} {:>9} {:>9} {:>9} {:>9}  set by",
        "stage", "kernel", "calls", "memory", "transact.", "arithm.", "(latency)", "all, us"
    );
    let shown = |time: Option<f64>| time.map_or("-".to_owned(), |time| format!("{time:.1}"));
    for kernel in &run.kernels {
        text += &format!(
            "\n{:<28} {:<34} {:>5} {:>9} {:>9} {:>9} {:>9} {:>9.1}  {}",
            kernel.scope,
            kernel.kernel,
            kernel.calls,
            shown(Some(kernel.memory_us)),
            shown(Some(kernel.transactions_us)),
            shown(kernel.arithmetic_us),
            shown(kernel.latency_us),
            kernel.time_us,
            kernel.set_by.name()
        );
    }
    let mut shares: BTreeMap<Resource, f64> = BTreeMap::new();
    run.kernels.iter().for_each(|kernel| *shares.entry(kernel.set_by).or_default() += kernel.time_us);
    let share = |(by, time): (&Resource, &f64)| {
        format!("{} {:.0} %", by.name(), 100.0 * time / run.total_us.max(1e-9))
    };
    text += &format!("\ntime in kernels set by: {}", shares.iter().map(share).collect::<Vec<_>>().join(", "));
    if let Some(us) = run.estimate_us {
        text += &format!(
            "\nno bound: {:.3} ms where no kernel takes less than one subgroup (latency), by a compiler that guesses how often loops run",
            us / 1e3
        );
    }
    text + &run.target.as_ref().map(said).unwrap_or_default()
}

fn said(target: &Target) -> String {
    let reached = match target.share_of_bounds {
        Some(share) if share <= 1.0 => {
            format!("every kernel has to reach {:.0} % of its bound", 100.0 * share)
        }
        Some(_) => "out of reach by this model".to_owned(),
        None => "the dispatches alone take longer".to_owned(),
    };
    let dispatches = target.dispatch_us.map_or_else(
        || "out of reach at half of the bounds".to_owned(),
        |us| format!("at half of the bounds a dispatch may take {us:.1} us"),
    );
    format!("\nfor {} ms: {reached}; {dispatches}", target.target_ms)
}

#[cfg(test)]
mod tests {
    use super::super::schema::{Segments, Transactions};
    use super::*;

    fn kernel(name: &str, calls: u32, bytes: u64, samples: Option<u64>) -> KernelResult {
        let (kernel, scope) = (name.to_owned(), "stage".to_owned());
        KernelResult { scope, kernel, calls, bytes_read: bytes, samples, ..KernelResult::default() }
    }

    const ROUND: Sheet = Sheet {
        name: "round",
        lanes: 1e4,
        gigahertz: 1.0,
        gigabytes_per_second: 1000.0,
        cores: 100.0,
        subgroup_size: 32,
        line_bytes: 128,
        blend_instructions: [45.0, 106.0],
        drivers: &["round"],
    };

    /// By hand: 10^8 segments by 100 cores of 10^9 cycles a second are 1000 us; an array of 12.8 MB is not counted twice.
    #[test]
    fn scattered_accesses_take_a_cycle_of_a_core_for_each_segment() {
        let counted = Segments { lanes: 32, of_32: 4, of_64: 5, of_128: 100_000_000 };
        let transactions = Transactions { bytes: 0, array_bytes: 12_800_000, by_lanes: vec![counted] };
        let gather = KernelResult {
            transactions: Some(transactions),
            waits: Some(1),
            ..kernel("forward/count", 3, 38_400_000, None)
        };
        let found = bound(&gather, &ROUND, None, 2.0);
        assert_eq!((found.segments, found.waits), (100_000_000, 1));
        assert!((found.time_us - 1002.0).abs() < 1e-6, "{found:?}");
        assert_eq!(found.set_by, Resource::Transactions);
        // Neighbours share lines: their bytes bound them.
        let stream = bound(&kernel("scan/scan_apply", 1, 12_800_000, None), &ROUND, None, 2.0);
        assert_eq!((stream.segments, stream.set_by), (100_000, Resource::Memory));
    }

    /// By hand: 850 MB take 1000 us at their bound, ten waits of 3 us come to that.
    #[test]
    fn targets_say_what_would_have_to_be_true() {
        let bytes = kernel("optimizer/adam", 10, 850_000_000, None);
        let run = Run { kernels: vec![bytes], ..Run::default() };
        let modelled = model(&run, &ROUND, None, 3.0);
        assert!((modelled.total_us - 1030.0).abs() < 1e-6, "{modelled:?}");
        let of = |ms| {
            let Target { share_of_bounds, dispatch_us, .. } = target(&modelled, ms);
            [share_of_bounds, dispatch_us].map(|value| value.map(|value| (value * 1e3).round() / 1e3))
        };
        assert_eq!(of(2.03), [Some(0.5), Some(3.0)]);
        assert_eq!(of(1.0), [Some(1.031), None]);
        assert_eq!(of(0.02), [None, None]);
    }

    /// By hand: 85 MB at 85 % of 1 TB/s are 100 us; 10^9 samples of 45 instructions on 10^4 lanes at 1 GHz are 4500 us.
    #[test]
    fn the_slowest_resource_bounds_a_kernel() {
        let sheet = ROUND;
        let of = |kernel: &KernelResult, cycles| {
            let bound = bound(kernel, &sheet, cycles, 2.0);
            ((bound.time_us * 1e3).round() / 1e3, bound.set_by)
        };
        assert_eq!(of(&kernel("optimizer/adam", 1, 85_000_000, None), None), (102.0, Resource::Memory));
        let blend = kernel("forward/blend", 1, 85_000_000, Some(1_000_000_000));
        assert_eq!(of(&blend, None), (4502.0, Resource::Arithmetic));
        let backward = kernel("backward/blend_backward", 1, 0, Some(1_000_000_000));
        assert_eq!(of(&backward, None), (10_602.0, Resource::Arithmetic));
        assert_eq!(of(&kernel("sort/sort_spine", 4, 85_000, None), None), (8.1, Resource::Dispatch));
        // 4 times 10,000 cycles at 1 GHz are 40 us: beside the bound, for they are estimated.
        let cycles = BTreeMap::from([("sort/sort_spine".to_owned(), 10_000.0)]);
        let spine = kernel("sort/sort_spine", 4, 85_000, None);
        assert_eq!(of(&spine, Some(&cycles)), (8.1, Resource::Dispatch));
        let run = Run { kernels: vec![spine], ..Run::default() };
        assert_eq!(model(&run, &ROUND, Some(&cycles), 2.0).estimate_us, Some(48.0));
        assert_eq!(model(&run, &ROUND, None, 2.0).estimate_us, None);
    }

    #[test]
    fn compilers_of_another_vendor_are_refused() {
        let of = |driver| check_compiled(Path::new("static.json"), ["device", driver], &Gpu::H200.sheet());
        assert!(of("NVK Mesa 25").is_ok());
        let error = of("radv Mesa 25").expect_err("refused").to_string();
        assert!(
            error.contains("static.json: is of device, radv Mesa 25") && error.contains("NVIDIA H200"),
            "{error}"
        );
    }
}
