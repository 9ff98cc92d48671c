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
