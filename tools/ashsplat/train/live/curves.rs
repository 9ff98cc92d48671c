//! The curves of a training, in bounded memory.

use ashsplat::train::StepReport;
use ashsplat_program::progress::RunningMean;
use serde_json::{Value, json};
use std::time::Instant;

/// Largest number of points of a curve. Beyond it, every second point is dropped.
const MAX_POINTS: usize = 1024;
/// Weight of the newest loss in the running mean.
const LOSS_WEIGHT: f64 = 0.05;
/// Seconds over which the speed is measured.
const RATE_WINDOW: f64 = 0.5;

/// One curve: (iteration, value).
type Curve = Vec<(u32, f64)>;

pub struct Curves {
    iterations: u32,
    iteration: u32,
    paused: bool,
    /// Iterations between two points of the regular curves.
    stride: u32,
    /// Iteration of the last thinning. Pages with older data receive all points again.
    thinned_at: u32,
    loss: Curve,
    psnr: Curve,
    gaussians: Curve,
    rate: Curve,
    mean_loss: RunningMean,
    window: (Instant, u32),
    last_rate: f64,
    last_gaussians: u32,
}

impl Curves {
    pub fn new(iterations: u32) -> Curves {
        Curves {
            iterations,
            iteration: 0,
            paused: false,
            stride: 1,
            thinned_at: 0,
            loss: Curve::new(),
            psnr: Curve::new(),
            gaussians: Curve::new(),
            rate: Curve::new(),
            mean_loss: RunningMean::new(LOSS_WEIGHT),
            window: (Instant::now(), 0),
            last_rate: 0.0,
            last_gaussians: 0,
        }
    }

    pub fn step(&mut self, report: &StepReport) {
        if self.iteration == 0 {
            self.window = (Instant::now(), report.iteration - 1);
        }
        self.iteration = report.iteration;
        self.last_gaussians = report.gaussians;
        self.mean_loss.add(report.loss.into());
        let seconds = self.window.0.elapsed().as_secs_f64();
        if seconds > RATE_WINDOW {
            self.last_rate = f64::from(report.iteration - self.window.1) / seconds;
            self.rate.push((report.iteration, self.last_rate));
            self.window = (Instant::now(), report.iteration);
        }
        if report.iteration.is_multiple_of(self.stride) {
            self.loss.extend(self.mean_loss.value().map(|mean| (report.iteration, mean)));
            self.gaussians.push((report.iteration, f64::from(report.gaussians)));
        }
        self.thin();
    }

    pub fn psnr(&mut self, iteration: u32, psnr: f64) {
        if psnr.is_finite() {
            self.psnr.push((iteration, psnr));
        }
    }

    /// Notes if training waits; its speed is not measured then.
    pub fn pause(&mut self, paused: bool) {
        if self.paused != paused {
            self.paused = paused;
            self.window = (Instant::now(), self.iteration);
        }
    }

    fn thin(&mut self) {
        for curve in [&mut self.psnr, &mut self.rate] {
            if curve.len() > MAX_POINTS {
                halve(curve);
                self.thinned_at = self.iteration;
            }
        }
        if self.loss.len() > MAX_POINTS {
            self.stride *= 2;
            halve(&mut self.loss);
            halve(&mut self.gaussians);
            self.thinned_at = self.iteration;
        }
    }

    /// New points for a page that knows everything up to iteration `since`.
    pub fn status(&self, since: u32) -> Value {
        let fresh = since < self.thinned_at || since > self.iteration;
        let after = |curve: &Curve| {
            let news = curve.iter().filter(|(at, _)| fresh || *at > since);
            news.map(|(at, value)| json!([at, value])).collect::<Vec<_>>()
        };
        let psnr = self.psnr.last().map(|(_, psnr)| *psnr);
        json!({
            "type": "status", "iteration": self.iteration, "iterations": self.iterations, "paused": self.paused,
            "points": {
                "fresh": fresh, "until": self.iteration, "loss": after(&self.loss), "psnr": after(&self.psnr),
                "gaussians": after(&self.gaussians), "rate": after(&self.rate),
            },
            "last": {
                "loss": self.mean_loss.value(), "psnr": psnr, "gaussians": self.last_gaussians,
                "rate": if self.paused { 0.0 } else { self.last_rate },
            },
        })
    }
}

/// Drops every second point.
fn halve(curve: &mut Curve) {
    let mut index = 0;
    curve.retain(|_| {
        index += 1;
        index % 2 == 0
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    fn step(iteration: u32) -> StepReport {
        StepReport { iteration, loss: 1.0 / iteration as f32, gaussians: iteration, ..StepReport::default() }
    }

    #[test]
    fn iterations_that_are_left_out_have_no_loss() {
        let mut curves = Curves::new(10);
        let skipped = StepReport { loss: f32::NAN, ..step(1) };
        [skipped, step(2)].iter().for_each(|report| curves.step(report));
        assert_eq!(curves.status(0)["points"]["loss"], json!([[2, 0.5]]));
    }

    #[test]
    fn long_trainings_stay_small() {
        let mut curves = Curves::new(100_000);
        (1..=100_000).for_each(|iteration| curves.step(&step(iteration)));
        let status = curves.status(0);
        let points = status["points"]["loss"].as_array().expect("points");
        assert!((MAX_POINTS / 2..=MAX_POINTS + 1).contains(&points.len()), "{}", points.len());
        assert_eq!(status["points"]["fresh"], true);
        let at = |index: usize| points[index][0].as_u64().expect("an iteration");
        assert!(at(0) < 1000 && at(points.len() - 1) > 99_000);
    }
}
