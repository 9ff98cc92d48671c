//! Share of the device's arithmetic rate that the blending kernels reach. Their samples are counted in a separate run; the
//! operations of a sample are known.

use super::frames::PlannedWork;
use super::schema::{ArithmeticRate, Run};
use super::tasks::Task;
use ashsplat::frame::LaunchSizes;
use ashsplat::vk::{Context, Limits, SpecOverride};
use ashsplat::{BlendSamples, Result};
use ashsplat_program::args::DeviceArguments;

/// Counts samples on a context of its own, which opens when a task first needs it.
pub struct Counter<'a> {
    device: &'a DeviceArguments,
    context: Option<Context>,
}

impl<'a> Counter<'a> {
    pub fn new(device: &'a DeviceArguments) -> Self {
        Self { device, context: None }
    }

    /// Counts the samples of a task's frame. None for tasks that blend nothing, and for training, which blends differently in
    /// each iteration.
    pub fn count(&mut self, task: &Task) -> Result<Option<BlendSamples>> {
        let Task::Frames(plan, _) = task else { return Ok(None) };
        let context = match &mut self.context {
            Some(context) => context,
            none => {
                let counts =
                    SpecOverride { kernel: String::new(), constant: "COUNT_HITS".to_owned(), bits: 1 };
                none.insert(self.device.context_with(|options| options.overrides.push(counts))?)
            }
        };
        PlannedWork::new(context, plan)?.samples().map(Some)
    }

    /// Prints the messages of the validation layer during counting.
    pub fn report_validation(&self) {
        self.context.iter().for_each(|context| self.device.report_validation(context));
    }
}

/// Additions, subtractions, multiplications and divisions of a sample in glsl/include/blending.glsl, for the opacity and all
/// that follows. Comparisons, minima, selections, shuffles and exp2 do not count.
struct Operations {
    regions: f64,
    shared: f64,
    backward: f64,
}

impl Operations {
    /// Operations with or without chained opacities, at a subgroup size.
    fn of(chained: bool, subgroup_size: u32, region_height: u32) -> Self {
        // Pixels of a lane in one column; see region_shape.glsl.
        let rows = f64::from(region_height / (subgroup_size / subgroup_size.min(8)).max(1));
        let opacity = |rows: f64| {
            if chained && rows > 2.0 {
                // 16 at the middle of a column and for its two quotients, then two products a row.
                (16.0 + 2.0 * (rows - 1.0)) / rows
            } else {
                // dy, the form, the product; three more per column.
                6.0 + 3.0 / rows
            }
        };
        // 1 - alpha, T (1 - alpha), the weight, three colours by product and sum.
        let forward = |rows: f64| opacity(rows) + 9.0;
        // 1 - alpha, the weight, g . c (5), the rest (2), dL/dalpha (3), dL/dpower, T, three colours (6), dy and the column's
        // moments (6); dx and the sums over columns, 10 a column.
        let backward = opacity(rows) + 26.0 + 10.0 / rows;
        // Without chains, the pixels of an invocation of blend_shared.comp are scattered.
        Self { regions: forward(rows), shared: forward(if chained { rows } else { 1.0 }), backward }
    }
}

/// Enters samples and operations of the blending kernels into a run.
pub fn enter(run: &mut Run, samples: BlendSamples, limits: &Limits, arithmetic: Option<&ArithmeticRate>) {
    let LaunchSizes { tuning, blend, .. } = LaunchSizes::new(limits);
    let operations = Operations::of(tuning.incremental_exp, blend.lanes, blend.region_height);
    for kernel in &mut run.kernels {
        let (samples, operations) = match kernel.kernel.as_str() {
            "forward/blend" => (samples.forward, operations.regions),
            "forward/blend_shared" => (samples.forward, operations.shared),
            name if name.starts_with("backward/blend_backward") => (samples.backward, operations.backward),
            _ => continue,
        };
        if samples == 0 {
            continue;
        }
        let counted = samples as f64 * operations;
        kernel.samples = Some(samples);
        kernel.operations = Some(counted as u64);
        kernel.gigaoperations_per_second = kernel.time_us.map(|time| counted / time.median * 1e-3);
        let best = arithmetic.map(|rate| rate.gigaoperations_per_second);
        kernel.share_of_arithmetic =
            kernel.gigaoperations_per_second.zip(best).map(|(rate, best)| rate / best);
    }
}
