//! `--blending` and `bench blending`: the two forms of blending, one against the other.

use super::schema::{KernelResult, Run, Spread};
use super::table;
use ashsplat::Blending;
use clap::{Args, ValueEnum};

/// A form of blending.
#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Form {
    /// Subgroups that cull per region of a tile
    Regions,
    /// The paper's batches in shared memory
    Shared,
}

/// Which form.
#[derive(Args, Clone, Copy, Default)]
pub struct FormArguments {
    /// How tiles are blended: the same picture, at a time that depends on the device [default: what was measured to be faster on
    /// such devices]
    #[arg(long, value_name = "FORM", value_enum)]
    blending: Option<Form>,
}

impl FormArguments {
    /// What was asked for.
    pub fn get(self) -> Option<Blending> {
        self.blending.map(|form| match form {
            Form::Regions => Blending::Regions,
            Form::Shared => Blending::SharedMemory,
        })
    }
}

/// A form's name in results, as on the command line.
pub fn name(blending: Blending) -> &'static str {
    match blending {
        Blending::Regions => "regions",
        Blending::SharedMemory => "shared",
    }
}

/// The form of a name.
pub fn of_name(named: &str) -> Option<Blending> {
    Blending::ALL.into_iter().find(|&form| name(form) == named)
}

/// A run's kernel that blends forward, where it has a time.
fn kernel(run: &Run) -> Option<(&KernelResult, Spread)> {
    let own = |k: &&KernelResult| k.kernel.starts_with("forward/blend");
    let kernel = run.kernels.iter().find(own)?;
    Some((kernel, kernel.time_us.filter(|time| time.min > 0.0)?))
}

/// One line for each frame that was blended in both forms: what shared memory takes, by what regions take.
pub fn ratios(runs: &[Run]) -> String {
    let of = |form: Blending| {
        let named = format!("render-{}", name(form));
        runs.iter().filter(move |run| run.name.starts_with(&named))
    };
    let pairs = of(Blending::Regions).filter_map(|regions| {
        let same = |run: &&Run| run.workload.hash == regions.workload.hash;
        Some((regions, of(Blending::SharedMemory).find(same)?))
    });
    let lines = pairs.filter_map(|(regions, shared)| {
        let ((kernel_a, a), (kernel_b, b)) = (kernel(regions)?, kernel(shared)?);
        let samples = kernel_a.operations.zip(kernel_b.operations).map_or_else(String::new, |(a, b)| {
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
