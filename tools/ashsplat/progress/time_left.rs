//! How long a training still takes. Its iterations cost more the more Gaussians there are, so what is left follows from the
//! schedule of densification, the growth so far, and the measured cost of a Gaussian.

/// Iterations whose cost is taken together.
const BIN: u32 = 100;
/// Of so many iterations one is left out of a bin's mean, the slowest: tests, saving and pauses.
const OUTLIERS: usize = 50;
/// Weight of a bin in the fit of the cost, relative to the next one.
const DECAY: f64 = 0.97;
/// Bins whose median is the present cost.
const PRESENT: usize = 5;
/// Densifications whose mean gain is the present one.
const RECENT: usize = 15;
/// Before this share of the densifications what is foretold was too little in the recorded trainings.
const EARLY: f64 = 0.125;
/// With fewer densifications their trend is not known. At first they add more and more.
const FEW: usize = 6;
/// The gain falls at most with this power of the number of densifications.
const MOST_POWER: f64 = 2.0;
/// No iteration is expected to be cheaper than this part of the present cost.
const LEAST_COST: f64 = 0.2;

/// Seconds that are left.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Left {
    pub seconds: f64,
    /// Whether it is a lower bound, because the growth cannot be told yet.
    pub at_least: bool,
}

/// What was seen of a training, and what is to come.
pub struct TimeLeft {
    iterations: u32,
    /// Iterations that will densify, the next one last.
    densifications: Vec<u32>,
    /// Densifications of the whole run.
    all: usize,
    /// Change of the number of Gaussians at each densification so far.
    gains: Vec<f64>,
    /// Seconds of the iterations of the present bin.
    bin: Vec<f64>,
    size: usize,
    gaussians: f64,
    /// Cost and Gaussians of the last bins, the newest last.
    present: Vec<(f64, f64)>,
    fit: Fit,
    seen_bins: u32,
    /// Up to half of this iteration, and up to it, pictures are smaller than later.
    small_until: u32,
}

/// Weighted sums for cost = a + b · Gaussians.
#[derive(Default)]
struct Fit {
    weight: f64,
    x: f64,
    y: f64,
    xx: f64,
    xy: f64,
}

impl Fit {
    fn add(&mut self, x: f64, y: f64) {
        for (sum, value) in [
            (&mut self.weight, 1.0),
            (&mut self.x, x),
            (&mut self.y, y),
            (&mut self.xx, x * x),
            (&mut self.xy, x * y),
        ] {
            *sum = DECAY * *sum + value;
        }
    }

    /// Seconds per Gaussian. Where there were always about as many, half of the cost is taken for theirs.
    fn slope(&self) -> f64 {
        let (x, y) = (self.x / self.weight, self.y / self.weight);
        let variance = self.xx / self.weight - x * x;
        match variance > (0.05 * x).powi(2) {
            true => (self.xy / self.weight - x * y) / variance,
            false => 0.5 * y / x.max(1.0),
        }
    }
}

impl TimeLeft {
    /// Of a run from iteration `first` on, which densifies after some iterations.
    pub fn new(first: u32, iterations: u32, densifies_at: impl Fn(u32) -> bool) -> TimeLeft {
        let densifications: Vec<u32> =
            (first + 1..=iterations).rev().filter(|&iteration| densifies_at(iteration)).collect();
        TimeLeft {
            iterations,
            all: densifications.len(),
            densifications,
            gains: Vec::new(),
            bin: Vec::new(),
            size: (iterations.saturating_sub(first) / 20).clamp(1, BIN) as usize,
            gaussians: 0.0,
            present: Vec::new(),
            fit: Fit::default(),
            seen_bins: 0,
            small_until: 0,
        }
    }

    /// With a warm-up: what is left cannot be told from smaller pictures.
    pub fn with_small_pictures(self, small_until: u32) -> TimeLeft {
        TimeLeft { small_until, ..self }
    }

    /// Notes an iteration that took so long and ended with so many Gaussians. True when the forecast has changed.
    pub fn step(&mut self, iteration: u32, gaussians: u32, seconds: f64) -> bool {
        let now = f64::from(gaussians);
        if self.densifications.last() == Some(&iteration) {
            self.densifications.pop();
            self.gains.push(if self.gaussians > 0.0 { now - self.gaussians } else { 0.0 });
        }
        self.gaussians = now;
        // From here on iterations cost more.
        if self.small_until > 0 && [self.small_until / 2, self.small_until].contains(&iteration) {
            (self.present, self.fit) = (Vec::new(), Fit::default());
            self.bin.clear();
            return true;
        }
        self.bin.push(seconds);
        if self.bin.len() < self.size {
            return false;
        }
        self.bin.sort_by(f64::total_cmp);
        let kept = self.bin.len() - self.bin.len() / OUTLIERS;
        let cost = self.bin[..kept].iter().sum::<f64>() / kept as f64;
        self.bin.clear();
        self.seen_bins += 1;
        // The first bin also builds kernels.
        if self.seen_bins == 2 {
            (self.present, self.fit) = (Vec::new(), Fit::default());
        }
        self.fit.add(now, cost);
        self.present.push((cost, now));
        if self.present.len() > PRESENT {
            self.present.remove(0);
        }
        true
    }

    /// What is left after an iteration; none before anything is known.
    pub fn after(&self, iteration: u32) -> Option<Left> {
        let mut costs: Vec<f64> = self.present.iter().map(|(cost, _)| *cost).collect();
        costs.sort_by(f64::total_cmp);
        let cost = *costs.get(costs.len() / 2)?;
        let gaussians = self.present.iter().map(|(_, n)| n).sum::<f64>() / self.present.len() as f64;
        let slope = self.fit.slope().clamp(0.0, cost / gaussians.max(1.0));
        let of = |n: f64| (cost + slope * (n - gaussians)).max(LEAST_COST * cost);
        let gain = self.gain();
        let (mut seconds, mut at, mut n) = (0.0, iteration, self.gaussians);
        for (next, &densification) in self.densifications.iter().rev().enumerate() {
            seconds += f64::from(densification.saturating_sub(at)) * of(n);
            at = densification.max(at);
            n = (n + gain(next)).max(0.0);
        }
        seconds += f64::from(self.iterations.saturating_sub(at)) * of(n);
        let known = ((EARLY * self.all as f64) as usize).max(2);
        let growing = self.gains.len() < known && !self.densifications.is_empty();
        let at_least = iteration < self.small_until || growing;
        Some(Left { seconds, at_least })
    }

    /// The gain of each densification to come. It falls with a power of their number, as it did so far.
    fn gain(&self) -> impl Fn(usize) -> f64 {
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

#[cfg(test)]
mod tests {
    use super::*;
    use ashsplat::trainer::TrainSettings;

    /// Iteration, Gaussians and processor seconds so far, every hundred iterations of a training. Processor time, because the
    /// machine did other work too; alone on it wall-clock time is in proportion.
    struct Recorded {
        name: &'static str,
        text: &'static str,
        settings: TrainSettings,
    }

    fn recorded() -> Vec<Recorded> {
        let of = |name, text, settings: TrainSettings| Recorded { name, text, settings };
        let usual = |iterations| TrainSettings { iterations, ..TrainSettings::default() };
        let demo = TrainSettings { densify_from_iter: 120, densify_until_iter: 720, ..usual(1200) };
        vec![
            of("2000 iterations", include_str!("recorded/photographs_2000.csv"), usual(2000)),
            of("7000 iterations", include_str!("recorded/photographs_7000.csv"), usual(7000)),
            of("11,400 iterations", include_str!("recorded/small_photographs_11400.csv"), usual(11_400)),
            of("the demo", include_str!("recorded/demo_1200.csv"), demo),
        ]
    }

    fn rows(text: &str) -> Vec<(u32, u32, f64)> {
        let row = |line: &str| {
            let mut fields = line.split(',');
            let mut next = || fields.next().expect("a field");
            let (iteration, gaussians) =
                (next().parse().expect("a number"), next().parse().expect("a number"));
            (iteration, gaussians, next().parse().expect("seconds"))
        };
        text.lines().map(row).collect()
    }

    /// From a third of the run on, within a quarter; the last fiftieth is seconds.
    #[test]
    fn recorded_trainings_are_foretold() {
        for Recorded { name, text, settings } in recorded() {
            let rows = rows(text);
            let total = rows.last().expect("rows").2;
            let mut left =
                TimeLeft::new(0, settings.iterations, |iteration| settings.densifies_at(iteration));
            let (mut before, mut seen, mut had, mut checked) = (0, 0.0, rows[0].1, 0);
            for &(iteration, gaussians, seconds) in &rows {
                let each = (seconds - seen) / f64::from(iteration - before);
                // Kernels are built in the first iteration; the others of the first row cost as those of the second.
                let usual = if before == 0 {
                    (rows[1].2 - rows[0].2) / f64::from(rows[1].0 - rows[0].0)
                } else {
                    each
                };
                for step in before + 1..=iteration {
                    let cost = if step == 1 { seconds - usual * f64::from(iteration - 1) } else { usual };
                    left.step(step, if step == iteration { gaussians } else { had }, cost);
                }
                (before, seen, had) = (iteration, seconds, gaussians);
                let really = total - seconds;
                if iteration < settings.iterations / 3 || really < total / 50.0 {
                    continue;
                }
                let foretold = left.after(iteration).expect("known");
                let ratio = foretold.seconds / really;
                assert!((0.75..=1.25).contains(&ratio), "{name}, {iteration}: {ratio:.2} of {really:.0} s");
                assert!(!foretold.at_least, "{name}, {iteration}");
                checked += 1;
            }
            assert!(checked >= 7, "{name}: {checked}");
        }
    }

    #[test]
    fn what_does_not_grow_is_exact() {
        let mut left = TimeLeft::new(100, 1100, |_| false);
        assert_eq!(left.after(100), None);
        for iteration in 101..=600 {
            // A test now and then, and kernels that are built at first.
            let seconds = if iteration % 100 == 0 || iteration == 101 { 5.0 } else { 0.1 };
            left.step(iteration, 5000, seconds);
        }
        let Left { seconds, at_least } = left.after(600).expect("known");
        assert!((seconds - 50.0).abs() < 1e-6 && !at_least, "{seconds}");
        assert!(left.after(1100).expect("known").seconds.abs() < 1e-6);
    }

    #[test]
    fn growth_that_is_not_known_is_said() {
        let mut left = TimeLeft::new(0, 3000, |iteration| iteration > 500 && iteration.is_multiple_of(100));
        for iteration in 1..=500 {
            left.step(iteration, 1000, 0.01);
        }
        assert!(left.after(500).expect("known").at_least);
        // An eighth of 25 densifications.
        for iteration in 501..=800 {
            assert!(left.after(iteration).expect("known").at_least, "{iteration}");
            left.step(iteration, 1000 + 10 * (iteration - 500), 0.01);
        }
        assert!(!left.after(800).expect("known").at_least);
    }

    /// What small pictures cost says nothing of whole ones.
    #[test]
    fn small_pictures_foretell_no_more_than_a_lower_bound() {
        let mut left = TimeLeft::new(0, 1000, |_| false).with_small_pictures(400);
        let mut foretold = Vec::new();
        for iteration in 1..=500 {
            let seconds = if iteration <= 200 {
                0.01
            } else if iteration <= 400 {
                0.02
            } else {
                0.05
            };
            left.step(iteration, 1000, seconds);
            if [150, 200, 350, 400].contains(&iteration) {
                foretold.push(left.after(iteration).map(|left| left.at_least));
            }
        }
        assert_eq!(foretold, [Some(true), None, Some(true), None]);
        let Left { seconds, at_least } = left.after(500).expect("known");
        assert!((seconds - 25.0).abs() < 1e-9 && !at_least, "{seconds}");
    }
}
