//! PSNR during training: the mean over the same few views each time, so that its curve shows the training, not the
//! choice of views.

use super::Run;
use super::allowance::Allowance;
use ashsplat::train::{StepReport, Trainer};
use ashsplat::{RenderSettings, Result, TrainSettings};
use ashsplat_files::View;
use ashsplat_program::eval::{self, Evaluation, Protocol};
use ashsplat_program::measure::Stopwatch;
use std::time::{Duration, Instant};

/// Default share of training's time.
pub(super) const SHARE: f64 = 0.02;
/// Largest number of tracked views.
const VIEWS: usize = 8;
/// Approximate number of points of a run's curve, and the largest interval between two.
const POINTS: u32 = 200;
const MAX_INTERVAL: u32 = 100;
/// Largest number of iterations without a measurement after the set of Gaussians changed. After many clones or splits,
/// the PSNR is some decibels lower for a while, and would be shown until the next point.
const SETTLING: u32 = 50;

pub(super) fn share(text: &str) -> Result<f64, String> {
    let number = text.parse().ok().filter(|&share| share == 0.0 || (0.001..=0.9).contains(&share));
    number.ok_or_else(|| "expected 0 or a number from 0.001 to 0.9".into())
}

/// At most `max` elements, evenly spread, with the first and the last.
pub(super) fn spread<T: Clone>(all: &[T], max: usize) -> Vec<T> {
    let count = all.len().min(max);
    (0..count).map(|i| all[i * (all.len() - 1) / (count - 1).max(1)].clone()).collect()
}

/// The tracked views, and the times of their measurements.
pub(super) struct Tracking {
    views: Vec<View>,
    /// Number of all test views.
    of: usize,
    /// Least iterations between two points.
    interval: u32,
    next: u32,
    /// Number of iterations without a measurement after the set of Gaussians changed.
    settling: u32,
    /// End of these iterations, and the number of Gaussians after the last one.
    settled: u32,
    gaussians: u32,
    /// True after the first measurement, which builds kernels and does not count.
    warm: bool,
    /// `None` if nothing is to be measured.
    allowance: Option<Allowance>,
}

impl Tracking {
    /// Tracking of a run with these settings, within a share of its time; 0 measures nothing.
    pub(super) fn new(test: &[View], settings: &TrainSettings, share: f64) -> Tracking {
        // A run without an end needs a measurement soon.
        let interval = (settings.iterations / POINTS).clamp(1, MAX_INTERVAL);
        Tracking {
            views: spread(test, VIEWS),
            of: test.len(),
            interval,
            next: interval,
            settling: (settings.densification_interval / 2).min(SETTLING),
            settled: 0,
            gaussians: 0,
            warm: false,
            allowance: (share > 0.0 && !test.is_empty()).then(|| Allowance::new(share)),
        }
    }

    pub(super) fn describe(&self, kind: &str) -> String {
        match (self.views.len(), self.of) {
            (measured, all) if measured < all => {
                format!("mean of the same {measured} of {all} {kind} views each time")
            }
            (all, _) => format!("mean of the {all} {kind} views"),
        }
    }

    /// Notes an iteration. Returns true if the views are to be measured after it.
    pub(super) fn is_due(&mut self, report: &StepReport) -> bool {
        let Some(allowance) = &mut self.allowance else { return false };
        allowance.trained(Duration::try_from_secs_f64(1e-3 * report.milliseconds).unwrap_or_default());
        let before = std::mem::replace(&mut self.gaussians, report.gaussians);
        if before != 0 && before != report.gaussians {
            self.settled = report.iteration + self.settling;
        }
        report.iteration >= self.next.max(self.settled) && allowance.permits()
    }

    /// Notes that the views were measured after an iteration, and the time that it took.
    pub(super) fn measured(&mut self, iteration: u32, time: Duration) {
        self.next = iteration + self.interval;
        let warm = std::mem::replace(&mut self.warm, true);
        if let Some(allowance) = self.allowance.as_mut().filter(|_| warm) {
            allowance.spent(time);
        }
    }

    /// Copies the cameras of these views, by name.
    pub(super) fn follow(&mut self, test: &[View]) {
        for view in &mut self.views {
            if let Some(moved) = test.iter().find(|other| other.name == view.name) {
                view.camera = moved.camera;
            }
        }
    }

    /// The mean PSNR over the views, dB; `None` if masks hide them all.
    fn measure(
        &self,
        trainer: &mut Trainer,
        settings: &RenderSettings,
        protocol: &Protocol,
    ) -> Result<Option<f64>> {
        let mut values = Vec::new();
        for view in &self.views {
            if !eval::is_hidden(view)? {
                let frame = trainer.render(&trainer.with_trained_lens(&view.camera), settings)?;
                let (view, frame) = protocol.prepared(view, frame)?;
                values.push(eval::psnr(&view, &frame)?);
            }
        }
        Ok(mean(&values))
    }

    /// The mean over the tracked views in a test of all views.
    pub(super) fn among(&self, evaluation: &Evaluation) -> Option<f64> {
        let tracked = |name: &str| self.views.iter().any(|view| view.name == name);
        let results = evaluation.views.iter().filter(|result| tracked(&result.name));
        mean(&results.map(|result| result.psnr).collect::<Vec<_>>())
    }
}

fn mean(values: &[f64]) -> Option<f64> {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    Some(mean).filter(|mean| mean.is_finite())
}

impl Run {
    /// The tracked PSNR, if it is measured after this iteration, dB. Training views are measured only for viewers. If a
    /// measurement fails, a warning is printed and training continues.
    pub(super) fn track(&mut self, report: &StepReport, watch: &mut Stopwatch) -> Option<f64> {
        let iteration = report.iteration;
        let due = self.tracking.is_due(report);
        let tested = self.evaluations.last().filter(|tested| tested.iteration == iteration);
        let psnr = match tested {
            Some(tested) => self.tracking.among(&tested.evaluation),
            None if due && (self.views.held_out || self.has_viewers()) => {
                watch.paused(|| self.measure_now(iteration))
            }
            None => None,
        }?;
        self.progress.tested(psnr, iteration);
        self.show_psnr(iteration, psnr);
        Some(psnr)
    }

    fn measure_now(&mut self, iteration: u32) -> Option<f64> {
        let start = Instant::now();
        let settings = self.trainer.render_settings();
        let protocol = self.follow_cameras().and_then(|()| self.protocol());
        let measured =
            protocol.and_then(|protocol| self.tracking.measure(&mut self.trainer, &settings, &protocol));
        self.tracking.measured(iteration, start.elapsed());
        measured.unwrap_or_else(|error| {
            self.tracking.allowance = None;
            let warning = format!("warning: no PSNR until the next test: {error}");
            self.progress.warn(&warning);
            None
        })
    }
}
