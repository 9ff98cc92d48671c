//! Bounds the share of training's time that viewers may take.

use std::time::Duration;

/// Work for viewers creates a debt, which training pays off: work of duration `t` is followed by `t (1 -
/// share) / share` of training before the next work for viewers. Unused time is not saved up. So between any
/// two moments viewers have taken at most `share` of the time, except for the last task.
#[derive(Clone, Copy, Debug)]
pub struct Allowance {
    share: f64,
    /// Training time that has to pass.
    debt: Duration,
}

impl Allowance {
    /// An allowance for a share in (0, 1).
    pub fn new(share: f64) -> Allowance {
        Allowance { share, debt: Duration::ZERO }
    }

    /// True if work for viewers may be done now.
    pub fn permits(&self) -> bool {
        self.debt.is_zero()
    }

    /// Notes work for viewers of this duration.
    pub fn spent(&mut self, time: Duration) {
        self.debt += time.mul_f64((1.0 - self.share) / self.share);
    }

    /// Notes that training had the device for this duration.
    pub fn trained(&mut self, time: Duration) {
        self.debt = self.debt.saturating_sub(time);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    const STEPS: usize = 4000;

    /// Simulates training steps of random duration, with pages that request pictures of random cost, always or at
    /// times. Returns for each step the training time and the time for pages after it.
    fn looked_on(share: f64, seed: u64) -> Vec<(Duration, Duration)> {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut allowance = Allowance::new(share);
        let mut wanted = false;
        let milliseconds = |random: &mut ChaCha8Rng, most: f64| {
            Duration::from_secs_f64(1e-3 * most * random.random::<f64>().powi(4))
        };
        let step = |_| {
            let trained = milliseconds(&mut random, 80.0);
            allowance.trained(trained);
            wanted ^= random.random::<f64>() < 0.02;
            let mut spent = Duration::ZERO;
            if wanted && allowance.permits() {
                spent = milliseconds(&mut random, 400.0);
                allowance.spent(spent);
            }
            (trained, spent)
        };
        (0..STEPS).map(step).collect()
    }

    #[test]
    fn viewers_never_take_more_than_their_share() {
        for (seed, share) in [(1, 0.01), (2, 0.1), (3, 0.2), (4, 0.5), (5, 0.9)] {
            let steps = looked_on(share, seed);
            // Between any two moments: from each task to the last.
            let tasks: Vec<usize> = (0..STEPS).filter(|&step| !steps[step].1.is_zero()).collect();
            for &from in tasks.iter().step_by(7) {
                let (mut trained, mut spent) = (0.0, steps[from].1.as_secs_f64());
                for (training, viewing) in &steps[from + 1..] {
                    trained += training.as_secs_f64();
                    if !viewing.is_zero() {
                        let most = share / (1.0 - share) * trained;
                        assert!(spent <= most + 1e-6, "{spent} s, {most} s allowed, at {share}");
                        spent += viewing.as_secs_f64();
                    }
                }
            }
            let sum = |of: fn(&(Duration, Duration)) -> Duration| {
                steps.iter().map(of).sum::<Duration>().as_secs_f64()
            };
            let taken = sum(|step| step.1) / (sum(|step| step.0) + sum(|step| step.1));
            assert!(taken > 0.05 * share, "{taken}: no viewer is served");
        }
    }

    #[test]
    fn idle_time_is_not_saved_up() {
        let second = Duration::from_secs(1);
        let mut allowance = Allowance::new(0.2);
        allowance.trained(1000 * second);
        assert!(allowance.permits(), "the first picture comes at once");
        allowance.spent(second);
        allowance.trained(Duration::from_millis(3999));
        assert!(!allowance.permits());
        allowance.trained(Duration::from_millis(1));
        assert!(allowance.permits(), "a second of five");
    }
}
