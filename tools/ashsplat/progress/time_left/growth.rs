//! How many Gaussians there will be, from the schedule of densification and the growth so far.

use ashsplat::trainer::{GrowthSchedule, StrategyType, TrainSettings};

/// Densifications whose mean gain is the present one.
const RECENT: usize = 15;
/// Before this share of the densifications what was foretold was too little in the recorded trainings.
const EARLY: f64 = 0.125;
/// With fewer densifications their trend is not known. At first they add more and more.
const FEW: usize = 6;
/// The gain falls at most with this power of the number of densifications.
const MOST_POWER: f64 = 2.0;
/// The strategy mcmc adds this share at a densification.
const MCMC: f64 = 0.05;
/// A densification splits a Gaussian into two.
const MOST_GROWTH: f64 = 2.0;
/// A budget that is not filled to this share is none: memory or the scene do not allow it.
const FILLED: f64 = 0.9;

/// The growth of a training.
pub struct Growth {
    /// Iterations that will densify, the next one last.
    densifications: Vec<u32>,
    /// Densifications of the whole run.
    all: usize,
    /// The densification whose result the next iteration has.
    due: Option<u32>,
    /// Change of the number of Gaussians by each densification and what followed it.
    gains: Vec<f64>,
    /// Before the last gain and after it.
    gaussians: [f64; 2],
    /// Settings that tell how many there will be, and the number at the start.
    planned: Option<(TrainSettings, u32)>,
}

impl Growth {
    /// Of a run from iteration `first` on, which densifies after some iterations.
    pub fn new(first: u32, iterations: u32, densifies_at: impl Fn(u32) -> bool) -> Growth {
        let densifications: Vec<u32> =
            (first + 1..=iterations).rev().filter(|&iteration| densifies_at(iteration)).collect();
        let all = densifications.len();
        Growth { densifications, all, due: None, gains: Vec::new(), gaussians: [0.0; 2], planned: None }
    }

    /// As the settings have it.
    pub fn of(first: u32, settings: &TrainSettings) -> Growth {
        let growth = Growth::new(first, settings.iterations, |iteration| settings.densifies_at(iteration));
        let planned = match settings.strategy {
            // Without a number it follows from that of the start, which a checkpoint does not tell.
            StrategyType::Budget => first == 0 || settings.cap_max > 0,
            strategy => strategy == StrategyType::Mcmc,
        };
        Growth { planned: planned.then(|| (settings.clone(), 0)), ..growth }
    }

    /// Notes an iteration with so many Gaussians: what a densification adds is there in the iteration after it.
    pub fn add(&mut self, iteration: u32, gaussians: u32) {
        let now = f64::from(gaussians);
        if self.gaussians[1] == 0.0 {
            self.gaussians = [now; 2];
        }
        if let Some((_, start)) = self.planned.as_mut().filter(|(_, start)| *start == 0) {
            *start = gaussians;
        }
        if let Some(densification) = self.due.take() {
            self.gains.push(now - self.gaussians[0]);
            self.gaussians[0] = now;
            let filled = self.plan(densification, self.gaussians[1]).is_none_or(|plan| now >= FILLED * plan);
            self.planned = self.planned.take().filter(|_| filled);
        }
        self.gaussians[1] = now;
        if self.densifications.last() == Some(&iteration) {
            self.due = self.densifications.pop();
        }
    }

    /// Whether there will be more densifications.
    pub fn goes_on(&self) -> bool {
        self.due.is_some() || !self.densifications.is_empty()
    }

    /// Whether it is known well enough to foretell.
    pub fn is_known(&self) -> bool {
        let enough = ((EARLY * self.all as f64) as usize).max(2);
        self.planned.is_some() || self.gains.len() >= enough || !self.goes_on()
    }

    /// What there will be: from which iterations on, how many.
    pub fn forecast(&self) -> Vec<(u32, f64)> {
        let gain = self.gain();
        let mut now = self.gaussians[1];
        let all = self.due.iter().chain(self.densifications.iter().rev());
        let next = all.enumerate().map(|(next, &iteration)| {
            now = self.plan(iteration, now).unwrap_or((now + gain(next)).max(0.0));
            (iteration, now)
        });
        next.collect()
    }

    /// What there will be after a densification of so many, if the strategy has it planned.
    fn plan(&self, iteration: u32, before: f64) -> Option<f64> {
        let (settings, start) = self.planned.as_ref()?;
        Some(match settings.strategy {
            StrategyType::Budget => {
                let budget = f64::from(GrowthSchedule::of(settings, *start).budget(iteration));
                budget.clamp(before, MOST_GROWTH * before)
            }
            // Whatever there is, it grows by a share of that.
            _ => (before * (1.0 + MCMC)).min(f64::from(settings.cap_max)).max(before),
        })
    }

    /// The gain of each densification to come. It falls with a power of their number, as it did so far.
    fn gain(&self) -> impl Fn(usize) -> f64 + use<> {
        let gains = &self.gains;
        let count = gains.len();
        let mean = |part: &[f64]| part.iter().sum::<f64>() / part.len().max(1) as f64;
        let (recent, window) = match count {
            0..FEW => (gains.iter().rev().take(2).copied().fold(0.0, f64::max), 1),
            _ => {
                let window = RECENT.min(count / 2);
                (mean(&gains[count - window..]), window)
            }
        };
        let power = if count < FEW {
            0.0
        } else {
            let (early, late) = (mean(&gains[..count / 2]), mean(&gains[count / 2..]));
            match early > 0.0 && late > 0.0 {
                // The middles of the halves are at a quarter and at three quarters.
                true => ((early / late).ln() / 3f64.ln()).clamp(0.0, MOST_POWER),
                false => MOST_POWER,
            }
        };
        let middle = count as f64 - (window as f64 - 1.0) / 2.0;
        move |next| recent * (middle / (count + next + 1) as f64).powf(power)
    }
}
