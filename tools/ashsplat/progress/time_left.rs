//! How long a training still takes. Its iterations cost more the more Gaussians there are, so what is left follows from the
//! schedule of densification, the growth so far, and the measured cost of a Gaussian.

mod cost;
mod growth;
#[cfg(test)]
mod tests;

use ashsplat::trainer::TrainSettings;
use cost::Costs;
use growth::Growth;

/// Seconds that are left.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Left {
    pub seconds: f64,
    /// Whether it is a lower bound, because the growth cannot be told yet.
    pub at_least: bool,
}

/// What was seen of a training, and what is to come.
pub struct TimeLeft {
    first: u32,
    iterations: u32,
    growth: Growth,
    costs: Costs,
    gaussians: f64,
    /// Up to half of this iteration, and up to it, pictures are smaller than later.
    small_until: u32,
}

impl TimeLeft {
    /// Of a run from iteration `first` on.
    pub fn of(first: u32, settings: &TrainSettings) -> TimeLeft {
        let small_until = settings.warm_up_end();
        TimeLeft { small_until, ..TimeLeft::new(first, settings.iterations, Growth::of(first, settings)) }
    }

    fn new(first: u32, iterations: u32, growth: Growth) -> TimeLeft {
        let costs = Costs::new(iterations.saturating_sub(first));
        TimeLeft { first, iterations, growth, costs, gaussians: 0.0, small_until: 0 }
    }

    /// Notes an iteration that took so long with so many Gaussians. True when the forecast has changed.
    pub fn step(&mut self, iteration: u32, gaussians: u32, seconds: f64) -> bool {
        self.growth.add(iteration, gaussians);
        self.gaussians = f64::from(gaussians);
        // From here on iterations cost more.
        if self.small_until > 0 && [self.small_until / 2, self.small_until].contains(&iteration) {
            self.costs.forget();
            return true;
        }
        // The first iteration also builds kernels.
        iteration > self.first + 1 && self.costs.add(self.gaussians, seconds)
    }

    /// What is left after an iteration; none before anything is known.
    pub fn after(&self, iteration: u32) -> Option<Left> {
        let (present, cost) = (self.costs.present()?, self.costs.by_gaussians()?);
        // As long as nothing is pruned, it is at least this.
        let least = f64::from(self.iterations.saturating_sub(iteration)) * present;
        if iteration < self.small_until || !self.growth.is_known() {
            return Some(Left { seconds: least, at_least: true });
        }
        let (mut seconds, mut at, mut gaussians) = (0.0, iteration, self.gaussians);
        let mut grows = false;
        for (densification, after) in self.growth.forecast() {
            seconds += f64::from(densification.saturating_sub(at)) * cost(gaussians);
            at = densification.max(at);
            grows |= after > gaussians;
            gaussians = after;
        }
        seconds += f64::from(self.iterations.saturating_sub(at)) * cost(gaussians);
        Some(Left { seconds: if grows { seconds.max(least) } else { seconds }, at_least: false })
    }
}
