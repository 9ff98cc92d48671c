//! Results for people.

use super::schema::{Report, Run, Spread, Workload};
use ashsplat_program::progress::thousands;
use std::fmt::Write;

pub fn describe(w: &Workload) -> String {
    let mut text = String::new();
    if let Some(elements) = w.elements {
        let _ = write!(text, "{} elements", thousands(elements));
    }
    if let (Some(n), Some(degree)) = (w.gaussians, w.sh_degree) {
        let _ = write!(text, "{} Gaussians of SH degree {degree}", thousands(n.into()));
    }
    if let (Some(width), Some(height)) = (w.width, w.height) {
        let _ = write!(text, ", {width}x{height}");
    }
    if let (Some(visible), Some(instances)) = (w.visible, w.instances) {
        let _ = write!(
            text,
            ", {} visible, {} instances",
            thousands(visible.into()),
            thousands(instances.into())
        );
    }
    if let Some(longest) = w.longest_tile {
        let _ = write!(text, ", longest tile {}", thousands(longest.into()));
    }
    format!("{text} ({})", w.source)
}

/// The whole report, readable in 120 columns.
pub fn render(report: &Report) -> String {
    let mut out = String::new();
    let d = &report.device;
    let _ = writeln!(
        out,
        "{} ({}), {}, Vulkan {}, subgroups of {}",
        d.name, d.kind, d.driver, d.api_version, d.subgroup_size
    );
    let _ = writeln!(out, "{}", report.program);
    if let Some(copy) = &report.copy_bandwidth {
        let _ = writeln!(
            out,
            "copy bandwidth {:.2} GB/s (read and write, {} MiB{})",
            copy.gigabytes_per_second,
            copy.bytes >> 20,
            by_host(&copy.clock)
        );
    }
    if let Some(arithmetic) = &report.arithmetic {
        let rate = arithmetic.gigaoperations_per_second;
        let by_host = by_host(&arithmetic.clock);
        let _ = writeln!(
            out,
            "arithmetic {rate:.1} GFLOP/s (multiplications and additions on registers{by_host})"
        );
    }
    if report.settings.clock == "host" {
        let _ = writeln!(
            out,
            "timed by the host's clock (no timestamps on the device, or --host-clock): no time per kernel"
        );
    }
    for run in &report.runs {
        one_run(&mut out, run);
    }
    out
}

/// Note that host times contain more than the device's work.
fn by_host(clock: &str) -> &'static str {
    if clock == "host" { "; by the host's clock, submitting and waiting included" } else { "" }
}

fn one_run(out: &mut String, run: &Run) {
    let _ = writeln!(out, "\n{}: {}", run.name, describe(&run.workload));
    let milliseconds = |s: &Spread| format!("{:.3} ms (least {:.3}, p90 {:.3})", s.median, s.min, s.p90);
    let _ = writeln!(out, "  wall       {}", milliseconds(&run.wall_ms));
    if let Some(device) = &run.device_ms {
        let _ = writeln!(out, "  device     {}", milliseconds(device));
    }
    let s = &run.split;
    let share = |ms: f64| format!("{ms:.3} ms ({:.1} %)", 100.0 * ms / s.wall_ms.max(1e-9));
    let kernels = s.kernels_ms.map_or_else(|| "unknown".to_owned(), share);
    let _ = writeln!(
        out,
        "  mean wall  {:.3} ms = kernels {kernels} + recording {}",
        s.wall_ms,
        share(s.recording_ms)
    );
    let (submitting, waiting) = (share(s.submitting_ms), share(s.waiting_ms));
    let _ = writeln!(
        out,
        "             + submitting {submitting} + waiting {waiting} + host {}",
        share(s.host_ms)
    );
    if let Some(between) = &run.between_submissions_ms {
        let _ = writeln!(out, "  between submissions {}", milliseconds(between));
    }
    if let Some(untimed) = &run.untimed_ms {
        let _ = writeln!(out, "  untimed    {}, {}", milliseconds(untimed), rate(run, untimed.mean * 1e-3));
    }
    if let Some(cpu) = &run.cpu_seconds {
        let _ = writeln!(
            out,
            "  processor  {:.4} CPU-seconds per iteration (least {:.4}, p90 {:.4}, mean {:.4})",
            cpu.median, cpu.min, cpu.p90, cpu.mean
        );
    }
    kernels_table(out, run);
    for k in &run.kernels {
        if let (Some(rate), Some(share)) = (k.gigaoperations_per_second, k.share_of_arithmetic) {
            let _ = writeln!(
                out,
                "  {}: {rate:.1} GFLOP/s, {:.0} % of the arithmetic above",
                k.kernel,
                100.0 * share
            );
        }
    }
    let arenas = run.memory.iter().map(|a| format!("{} {:.1}", a.name, a.peak_bytes as f64 / 1048576.0));
    let _ = writeln!(out, "  peak device memory, MiB: {}", arenas.collect::<Vec<_>>().join(", "));
}

fn rate(run: &Run, seconds: f64) -> String {
    match run.workload.elements {
        Some(elements) => format!("{:.1} million elements/s", elements as f64 / seconds * 1e-6),
        None => format!("{:.1} /s", 1.0 / seconds),
    }
}

fn kernels_table(out: &mut String, run: &Run) {
    let sum: f64 = run.kernels.iter().filter_map(|k| Some(k.time_us?.median)).sum();
    let _ = writeln!(
        out,
        "  {:<16} {:<26} {:>5} {:>10} {:>9} {:>9} {:>9} {:>6} {:>8} {:>8} {:>7} {:>6}",
        "stage",
        "kernel",
        "calls",
        "workgroups",
        "µs",
        "least",
        "p90",
        "share",
        "MB read",
        "written",
        "GB/s",
        "copy"
    );
    for k in &run.kernels {
        let number = |value: Option<f64>, digits: usize| {
            value.map_or_else(|| "-".to_owned(), |value| format!("{value:.digits$}"))
        };
        let time = k.time_us;
        let _ = writeln!(
            out,
            "  {:<16} {:<26} {:>5} {:>10} {:>9} {:>9} {:>9} {:>6} {:>8.2} {:>8.2} {:>7} {:>6}",
            k.scope,
            k.kernel,
            k.calls,
            k.workgroups.map_or_else(|| "-".to_owned(), |n| n.to_string()),
            number(time.map(|t| t.median), 1),
            number(time.map(|t| t.min), 1),
            number(time.map(|t| t.p90), 1),
            time.map_or_else(|| "-".to_owned(), |t| format!("{:.1}%", 100.0 * t.median / sum.max(1e-9))),
            k.bytes_read as f64 * 1e-6,
            k.bytes_written as f64 * 1e-6,
            number(k.gigabytes_per_second, 2),
            k.share_of_copy_bandwidth.map_or_else(|| "-".to_owned(), |s| format!("{:.0}%", 100.0 * s)),
        );
    }
}
