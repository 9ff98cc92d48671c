//! `--blending` and `bench blending`: the two forms of blending, one against the other.

use super::schema::{KernelResult, Run, Spread};
use super::table;
use ashsplat::Blending;
use clap::Args;

/// Form of blending.
#[derive(Args, Clone, Default)]
pub struct FormArguments {
    /// How tiles are blended: by subgroups that cull per region of a tile (regions), or by the paper's batches in shared memory (shared):
    /// the same picture, at a time that depends on the device [default: what was measured to be faster on such devices]
    #[arg(long, value_name = "FORM", value_parser = ["regions", "shared"])]
    blending: Option<String>,
}

impl FormArguments {
    pub fn get(&self) -> Option<Blending> {
        Blending::ALL.into_iter().find(|form| self.blending.as_deref() == Some(name(*form)))
    }
}

/// A form's name in results and on the command line.
pub fn name(blending: Blending) -> &'static str {
    match blending {
        Blending::Regions => "regions",
        Blending::SharedMemory => "shared",
    }
}

/// Returns a run's forward blending kernel and its time, if it has one.
fn kernel(run: &Run) -> Option<(&KernelResult, Spread)> {
    let own = |k: &&KernelResult| k.kernel.starts_with("forward/blend");
    let kernel = run.kernels.iter().find(own)?;
    Some((kernel, kernel.time_us.filter(|time| time.min > 0.0)?))
}

/// One line for each frame blended in both forms: the time of shared memory over that of regions. The two runs of a frame are
/// neighbours.
pub fn ratios(runs: &[Run]) -> String {
    let is_of = |run: &Run, form: Blending| {
        let form_first = run.name.strip_prefix("render-").or(run.name.strip_prefix("draw-"));
        form_first.is_some_and(|rest| rest.starts_with(name(form)))
    };
    let lines = runs.windows(2).filter_map(|pair| {
        let (regions, shared) = match pair {
            [a, b] if is_of(a, Blending::Regions) && is_of(b, Blending::SharedMemory) => (a, b),
            [a, b] if is_of(b, Blending::Regions) && is_of(a, Blending::SharedMemory) => (b, a),
            _ => return None,
        };
        if regions.workload.hash != shared.workload.hash {
            return None;
        }
        let ((kernel_a, a), (kernel_b, b)) = (kernel(regions)?, kernel(shared)?);
        let samples = kernel_a.samples.zip(kernel_b.samples).map_or_else(String::new, |(a, b)| {
            format!(" for {:.2} times as many samples", b as f64 / a.max(1) as f64)
        });
        Some(format!(
            "blending from shared memory takes {:.2} times as long as by regions ({:.2} to {:.2}){samples}: {:.3} and {:.3} ms, {}\n",
            b.median / a.median,
            b.min / a.p90,
            b.p90 / a.min,
            b.median * 1e-3,
            a.median * 1e-3,
            table::describe(&regions.workload)
        ))
    });
    lines.collect()
}
