//! Times of all kernels in a few iterations.

use ashsplat::vk::{Context, Profile};
use ashsplat_program::html::{self, Cell, shown};
use ashsplat_program::measure::median;

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
    stage: &'static str,
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

    pub fn after(&mut self, iteration: u32) {
        let Some(profile) = self.profile.as_ref().filter(|_| iteration % INTERVAL == OFFSET) else { return };
        self.context.set_profile(None);
        self.timed += 1;
        let before: Vec<usize> = self.kernels.iter().map(|kernel| kernel.microseconds.len()).collect();
        for command in profile.take().iter().flat_map(|submission| &submission.commands) {
            let same = |kernel: &Kernel| kernel.stage == command.scope && kernel.name == command.name;
            let place = self.kernels.iter().position(same).unwrap_or_else(|| {
                let (stage, name) = (command.scope, command.name);
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

    pub fn device(&self) -> String {
        let device = self.context.description();
        format!("{} ({}), {}, Vulkan {}", device.name, device.kind, device.driver, device.api_version)
    }

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
        let max = rows[0].1.max(1e-9);
        let n = f64::from(self.timed.max(1));
        let row = |(kernel, us): &(&Kernel, f64)| {
            vec![
                Cell::Name(shown(kernel.stage).to_owned()),
                Cell::Name(kernel.name.to_owned()),
                Cell::number(f64::from(kernel.calls) / n, 1),
                Cell::number(*us, 1),
                Cell::Number(format!("{:.1} %", 100.0 * us / all.max(1e-9))),
                Cell::Bar(us / max),
            ]
        };
        let none = || Cell::Number(String::new());
        let sum = vec![Cell::Name("all".into()), none(), none(), Cell::number(all, 1), none(), none()];
        let rows: Vec<Vec<Cell>> = rows.iter().map(row).collect();
        html::table(&["stage", "kernel", "calls", "µs", "share", ""], &rows, Some(sum))
    }
}
