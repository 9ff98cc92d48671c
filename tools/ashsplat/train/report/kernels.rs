//! Times of all kernels in a few iterations.

use ashsplat::vk::{Context, Profile};
use ashsplat_program::html::{escape, shown};
use ashsplat_program::measure::median;
use std::fmt::Write;

/// Interval of the iterations that are timed command by command.
const INTERVAL: u32 = 50;
/// Offset within the interval, so that no densification is timed.
const OFFSET: u32 = 7;
/// Least free memory for timing, which must not make a run fail.
const SPARE_BYTES: u64 = 16 << 20;

/// Measured times.
pub struct KernelTimes {
    context: Context,
    profile: Option<Profile>,
    timed: u32,
    kernels: Vec<Kernel>,
}

struct Kernel {
    stage: String,
    name: &'static str,
    calls: u32,
    /// Time in each timed iteration that ran it; empty without timestamps.
    microseconds: Vec<f64>,
}

impl KernelTimes {
    pub fn new(context: &Context) -> Self {
        Self { context: context.clone(), profile: None, timed: 0, kernels: Vec::new() }
    }

    /// Starts timing before an iteration, if it is due.
    pub fn before(&mut self, iteration: u32) {
        let used = self.context.memory_total().bytes;
        let tight = self.context.memory_limit().is_some_and(|(limit, _)| limit < used + SPARE_BYTES);
        if iteration % INTERVAL == OFFSET && !tight {
            match &self.profile {
                Some(profile) => self.context.set_profile(Some(profile)),
                None => self.profile = Some(self.context.profile()),
            }
        }
    }

    /// Reads the times after an iteration.
    pub fn after(&mut self, iteration: u32) {
        let Some(profile) = self.profile.as_ref().filter(|_| iteration % INTERVAL == OFFSET) else { return };
        self.context.set_profile(None);
        self.timed += 1;
        let before: Vec<usize> = self.kernels.iter().map(|kernel| kernel.microseconds.len()).collect();
        for command in profile.take().iter().flat_map(|submission| &submission.commands) {
            let same = |kernel: &Kernel| kernel.stage == command.scope && kernel.name == command.name;
            let place = self.kernels.iter().position(same).unwrap_or_else(|| {
                let (stage, name) = (command.scope.clone(), command.name);
                self.kernels.push(Kernel { stage, name, calls: 0, microseconds: Vec::new() });
                self.kernels.len() - 1
            });
            let kernel = &mut self.kernels[place];
            kernel.calls += 1;
            let Some(us) = command.nanoseconds.map(|ns| ns * 1e-3) else { continue };
            match kernel.microseconds.get_mut(before.get(place).copied().unwrap_or(0)) {
                Some(sum) => *sum += us,
                None => kernel.microseconds.push(us),
            }
        }
    }

    /// Description of the device.
    pub fn device(&self) -> String {
        let device = self.context.description();
        format!("{} ({}), {}, Vulkan {}", device.name, device.kind, device.driver, device.api_version)
    }

    /// Description of the measurement.
    pub fn note(&self) -> String {
        match (self.timed, self.context.has_timestamps()) {
            (_, false) => "this device has no timestamps: kernels cannot be timed".into(),
            (0, _) => {
                "the run was too short to time any: <code>ashsplat profile train-step</code> does".into()
            }
            (n, _) => format!(
                "device time per iteration, median of the {n} that were timed (every {INTERVAL}th); \
                 <code>ashsplat profile train-step</code> and <code>bench train</code> measure more closely"
            ),
        }
    }

    /// The table of kernels, the most expensive first.
    pub fn table(&self) -> String {
        let mut rows: Vec<(&Kernel, f64)> = self
            .kernels
            .iter()
            .filter_map(|kernel| Some((kernel, median(kernel.microseconds.clone())?)))
            .collect();
        if rows.is_empty() {
            return String::new();
        }
        rows.sort_by(|a, b| b.1.total_cmp(&a.1));
        let all: f64 = rows.iter().map(|row| row.1).sum();
        let most = rows[0].1.max(1e-9);
        let mut out = String::from(
            "<table><tr><th class=\"name\">stage</th><th class=\"name\">kernel</th><th>calls</th><th>µs</th>\
             <th>share</th><th class=\"name bar\"></th></tr>\n",
        );
        let n = f64::from(self.timed.max(1));
        for (kernel, us) in rows {
            let _ = writeln!(
                out,
                "<tr><td class=\"name\">{}</td><td class=\"name\">{}</td><td>{:.1}</td><td>{:.1}</td><td>{:.1} %</td>\
                 <td class=\"name bar\"><i style=\"width:{:.1}%\"></i></td></tr>",
                escape(shown(&kernel.stage)),
                escape(kernel.name),
                f64::from(kernel.calls) / n,
                us,
                100.0 * us / all.max(1e-9),
                100.0 * us / most
            );
        }
        let _ = writeln!(
            out,
            "<tr class=\"sum\"><td class=\"name\">all</td><td></td><td></td><td>{:.1}</td><td></td><td></td></tr></table>",
            all
        );
        out
    }
}
