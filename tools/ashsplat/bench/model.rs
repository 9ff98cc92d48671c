//! `bench model`: the least time that each kernel of a measured workload can take on a GPU that is not at hand, from what the
//! kernels move and compute and from the GPU's data sheet. A model, never a measurement.

use super::compiled;
use super::schema::{KernelResult, Report, Run};
use super::{compare, table};
use crate::output;
use ashsplat::{Error, Result};
use clap::{Args, ValueEnum};
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::PathBuf;

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
    /// A file of `profile --static --json` for that GPU: no kernel takes less than one subgroup's estimated cycles
    #[arg(long = "static", value_name = "FILE")]
    compiled: Option<PathBuf>,
    /// Time from one dispatch to the next that waits for it, microseconds: an assumption, no data sheet has it
    #[arg(long, value_name = "US", default_value_t = 3.0, value_parser = parse_time)]
    dispatch_us: f64,
    /// Write the result here (schema ashsplat-model/1)
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
}

fn parse_time(text: &str) -> Result<f64, String> {
    let time = text.parse().ok().filter(|time: &f64| time.is_finite() && *time >= 0.0);
    time.ok_or_else(|| "expected a number of microseconds, 0 or more".to_owned())
}

/// GPUs with public data sheets.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Gpu {
    /// NVIDIA H200 (Hopper)
    H200,
    /// NVIDIA GeForce RTX 4090 (Ada)
    #[value(name = "rtx4090")]
    Rtx4090,
    /// AMD Radeon RX 7900 XTX (RDNA3)
    #[value(name = "rx7900xtx")]
    Rx7900Xtx,
    /// Intel Arc A770 (DG2)
    A770,
}

/// What a data sheet says.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
struct Sheet {
    name: &'static str,
    /// Float lanes that take an instruction each per cycle. RDNA3's second issue is not counted.
    lanes: f64,
    /// Boost clock.
    gigahertz: f64,
    /// Bandwidth of device memory.
    gigabytes_per_second: f64,
}

impl Gpu {
    fn sheet(self) -> Sheet {
        let (name, lanes, gigahertz, gigabytes_per_second) = match self {
            Self::H200 => ("NVIDIA H200", 16_896.0, 1.98, 4800.0),
            Self::Rtx4090 => ("NVIDIA GeForce RTX 4090", 16_384.0, 2.52, 1008.0),
            Self::Rx7900Xtx => ("AMD Radeon RX 7900 XTX", 6144.0, 2.5, 960.0),
            Self::A770 => ("Intel Arc A770", 4096.0, 2.1, 560.0),
        };
        Sheet { name, lanes, gigahertz, gigabytes_per_second }
    }
}

/// Instructions for a Gaussian at a pixel, counted in the machine code of RDNA3's loops (tools/gpu_static.md).
const FORWARD_INSTRUCTIONS: f64 = 45.0;
const BACKWARD_INSTRUCTIONS: f64 = 106.0;
/// Bandwidth that plain copies reach on GPUs, of the data sheet's.
const REACHED: f64 = 0.85;

/// What bounds a kernel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
enum Resource {
    Memory,
    Arithmetic,
    /// One subgroup's own time.
    Latency,
    /// From one dispatch to the next.
    Dispatch,
}

impl Resource {
    fn name(self) -> &'static str {
        match self {
            Self::Memory => "memory",
            Self::Arithmetic => "arithmetic",
            Self::Latency => "latency",
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
    memory_us: f64,
    /// Null where instructions are not counted: all but blending.
    arithmetic_us: Option<f64>,
    /// Null without a static file.
    latency_us: Option<f64>,
    dispatch_us: f64,
    /// The largest of memory, arithmetic and latency, and the dispatches.
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
    kernels: Vec<Bound>,
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
    let cycles = compiled.as_ref().map(|compiled| {
        let latency = |(kernel, (heaviest, _)): (&str, (&compiled::Pipeline, usize))| {
            Some((kernel.to_owned(), heaviest.figures.latency?))
        };
        compiled::heaviest(compiled).into_iter().filter_map(latency).collect::<BTreeMap<String, f64>>()
    });
    let sheet = arguments.gpu.sheet();
    let of = |run: &Run| model(run, &sheet, cycles.as_ref(), arguments.dispatch_us);
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
    const OF_PROCESSORS: [&str; 4] = ["_serial", "_subgroup_per_tile", "_single_subgroup", "_sweep"];
    let kernels = report.runs.iter().flat_map(|run| &run.kernels);
    let found =
        kernels.map(|k| k.kernel.as_str()).find(|name| OF_PROCESSORS.iter().any(|end| name.ends_with(end)));
    if let Some(kernel) = found {
        let problem = format!("has kernels for processors ({kernel})");
        return Err(Error::input(&arguments.file, problem, "measure with --backend gpu"));
    }
    Ok(())
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
        kernels,
    }
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
    let instructions = match kernel.kernel.as_str() {
        name if name.starts_with("backward/") => BACKWARD_INSTRUCTIONS,
        _ => FORWARD_INSTRUCTIONS,
    };
    let arithmetic_us =
        kernel.samples.map(|n| n as f64 * instructions / (sheet.lanes * sheet.gigahertz * 1e3));
    let alone = cycles.and_then(|cycles| cycles.get(&kernel.kernel));
    let latency_us = alone.map(|cycles| f64::from(kernel.calls) * cycles / (sheet.gigahertz * 1e3));
    let dispatch_us = f64::from(kernel.calls) * dispatch_us;
    let work = [
        (memory_us, Resource::Memory),
        (arithmetic_us.unwrap_or(0.0), Resource::Arithmetic),
        (latency_us.unwrap_or(0.0), Resource::Latency),
    ];
    let (work_us, by) = work.into_iter().fold((0.0, Resource::Memory), |a, b| if b.0 > a.0 { b } else { a });
    Bound {
        scope: kernel.scope.clone(),
        kernel: kernel.kernel.clone(),
        calls: kernel.calls,
        memory_us,
        arithmetic_us,
        latency_us,
        dispatch_us,
        time_us: work_us + dispatch_us,
        set_by: if dispatch_us > work_us { Resource::Dispatch } else { by },
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
        "\n{}{size}: at least {:.3} ms, at most {per_second:.0} per second",
        run.name,
        run.total_us / 1e3
    );
    text += &format!(
        "\n{:<28} {:<34} {:>5} {:>9} {:>9} {:>9} {:>9}  set by",
        "stage", "kernel", "calls", "memory", "arithm.", "latency", "all, us"
    );
    let shown = |time: Option<f64>| time.map_or("-".to_owned(), |time| format!("{time:.1}"));
    for kernel in &run.kernels {
        text += &format!(
            "\n{:<28} {:<34} {:>5} {:>9} {:>9} {:>9} {:>9.1}  {}",
            kernel.scope,
            kernel.kernel,
            kernel.calls,
            shown(Some(kernel.memory_us)),
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
    text + &format!("\ntime in kernels set by: {}", shares.iter().map(share).collect::<Vec<_>>().join(", "))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn kernel(name: &str, calls: u32, bytes: u64, samples: Option<u64>) -> KernelResult {
        let (kernel, scope) = (name.to_owned(), "stage".to_owned());
        KernelResult { scope, kernel, calls, bytes_read: bytes, samples, ..KernelResult::default() }
    }

    /// By hand: 85 MB at 85 % of 1 TB/s are 100 us; 10^9 samples of 45 instructions on 10^4 lanes at 1 GHz are 4500 us.
    #[test]
    fn the_slowest_resource_bounds_a_kernel() {
        let sheet = Sheet { name: "round", lanes: 1e4, gigahertz: 1.0, gigabytes_per_second: 1000.0 };
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
        let cycles = BTreeMap::from([("sort/sort_spine".to_owned(), 10_000.0)]);
        assert_eq!(of(&kernel("sort/sort_spine", 4, 85_000, None), Some(&cycles)), (48.0, Resource::Latency));
    }

    #[test]
    fn data_sheets_are_in_the_order_of_their_generations() {
        let rates = Gpu::value_variants().iter().map(|gpu| gpu.sheet());
        assert!(rates.clone().all(|sheet| (1.0..3.0).contains(&sheet.gigahertz)));
        assert!(rates.clone().all(|sheet| (500.0..5000.0).contains(&sheet.gigabytes_per_second)));
        assert_eq!(rates.count(), 4);
    }
}
