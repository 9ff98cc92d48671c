//! What an iteration costs with so many Gaussians, from those that were measured.

/// Iterations whose cost is taken together, at most.
const BIN: u32 = 100;
/// The same of the first one: a long training soon says what it takes at least.
const FIRST_BIN: usize = 20;
/// Growth ends a bin early that has this part of the iterations: each bin is of one number of Gaussians, if that does not change
/// too often.
const LEAST_BIN: usize = 4;
/// Of so many iterations one is left out of a bin's mean, the slowest: tests, saving and pauses.
const OUTLIERS: usize = 50;
/// Weight of a bin in the fit, relative to the next one.
const DECAY: f64 = 0.97;
/// Bins that tell how far costs are from the fit now.
const PRESENT: usize = 5;
/// While there were always about as many Gaussians, this share of the cost is taken for theirs.
const SHARE: f64 = 0.55;
/// How much the numbers of Gaussians have to differ before the measured share counts as much: their variance, relative to the
/// square of their mean.
const VARIANCE: f64 = 0.02;

/// Some iterations and their mean number of Gaussians.
#[derive(Clone, Copy)]
struct Bin {
    /// Seconds of an iteration.
    cost: f64,
    gaussians: f64,
    iterations: f64,
}

/// The costs of a training's iterations.
#[derive(Default)]
pub struct Costs {
    /// Seconds of the iterations of the present bin.
    open: Vec<f64>,
    /// The sum of their numbers of Gaussians, and the last one.
    sum: f64,
    gaussians: f64,
    size: usize,
    bins: Vec<Bin>,
}

impl Costs {
    /// Of a run with so many iterations.
    pub fn new(iterations: u32) -> Costs {
        Costs { size: (iterations / 20).clamp(1, BIN) as usize, ..Costs::default() }
    }

    /// Notes an iteration. True when it has changed what is known.
    pub fn add(&mut self, gaussians: f64, seconds: f64) -> bool {
        let grown = gaussians != self.gaussians && self.close(self.size.div_ceil(LEAST_BIN));
        self.gaussians = gaussians;
        self.sum += gaussians;
        self.open.push(seconds);
        let size = if self.bins.is_empty() { self.size.min(FIRST_BIN) } else { self.size };
        (self.open.len() >= size && self.close(1)) || grown
    }

    /// Forgets what was measured: iterations are no longer as they were.
    pub fn forget(&mut self) {
        self.open.clear();
        self.sum = 0.0;
        self.bins.clear();
    }

    fn close(&mut self, least: usize) -> bool {
        if self.open.len() < least {
            return false;
        }
        let mut seconds = std::mem::take(&mut self.open);
        let gaussians = std::mem::take(&mut self.sum) / seconds.len() as f64;
        seconds.sort_by(f64::total_cmp);
        let kept = seconds.len() - seconds.len() / OUTLIERS;
        let cost = seconds[..kept].iter().sum::<f64>() / kept as f64;
        self.bins.push(Bin { cost, gaussians, iterations: kept as f64 });
        true
    }

    /// Seconds of an iteration as they are now; none before anything was measured.
    pub fn present(&self) -> Option<f64> {
        self.bins.last().map(|bin| bin.cost)
    }

    /// Seconds of an iteration with so many Gaussians, a + b · Gaussians; none before anything was measured.
    pub fn by_gaussians(&self) -> Option<impl Fn(f64) -> f64 + use<>> {
        if self.bins.is_empty() {
            return None;
        }
        let weights = (0..self.bins.len()).rev().map(|age| DECAY.powf(age as f64));
        let weighted: Vec<(f64, Bin)> =
            weights.zip(&self.bins).map(|(weight, bin)| (weight * bin.iterations, *bin)).collect();
        let total: f64 = weighted.iter().map(|(weight, _)| weight).sum();
        let mean = |of: &dyn Fn(&Bin) -> f64| {
            weighted.iter().map(|(weight, bin)| weight * of(bin)).sum::<f64>() / total
        };
        let (x, y) = (mean(&|bin| bin.gaussians).max(1.0), mean(&|bin| bin.cost));
        let variance = mean(&|bin| (bin.gaussians - x).powi(2));
        let together = mean(&|bin| (bin.gaussians - x) * (bin.cost - y));
        let prior = VARIANCE * x * x;
        let slope = ((together + prior * SHARE * y / x) / (variance + prior)).clamp(0.0, y / x);
        let fit = move |gaussians: f64| y + slope * (gaussians - x);
        // Costs also change for other reasons; the last ones tell by how much.
        let last = &self.bins[self.bins.len().saturating_sub(PRESENT)..];
        let mut factors: Vec<f64> = last.iter().map(|bin| bin.cost / fit(bin.gaussians)).collect();
        factors.sort_by(f64::total_cmp);
        let factor = *factors.get(factors.len() / 2)?;
        Some(move |gaussians| factor * fit(gaussians))
    }
}
