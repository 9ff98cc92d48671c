//! Charts as SVG: axes, lines with bands.

use crate::html::escape;
use std::fmt::Write;

/// Approximate number of marks on an axis.
const MARKS: f64 = 5.0;

/// An axis with marks at 1, 2 or 5 times a power of ten.
#[derive(Clone, Copy)]
pub struct Axis {
    pub low: f64,
    pub high: f64,
    /// Distance of marks.
    pub step: f64,
}

impl Axis {
    /// An axis that covers `low` to `high`.
    pub fn new(low: f64, high: f64) -> Self {
        let span = (high - low).max(high.abs() * 0.05).max(1e-6);
        let rough = span / MARKS;
        let power = 10f64.powf(rough.log10().floor());
        let step =
            [1.0, 2.0, 5.0, 10.0].map(|n| n * power).into_iter().find(|step| *step >= rough).unwrap_or(rough);
        let ends = ((low / step + 1e-9).floor() * step, (high / step - 1e-9).ceil() * step);
        Self { low: ends.0, high: ends.1.max(ends.0 + step), step }
    }

    /// Position of a value: 0 at the beginning, 1 at the end.
    pub fn share(&self, value: f64) -> f64 {
        (value - self.low) / (self.high - self.low)
    }

    /// The values at the marks.
    pub fn marks(&self) -> impl Iterator<Item = f64> {
        let (first, last) =
            ((self.low / self.step).ceil() as i64, (self.high / self.step + 1e-6).floor() as i64);
        (first..=last).map(|n| n as f64 * self.step)
    }

    /// A value with as many digits as the marks need.
    pub fn mark(&self, value: f64) -> String {
        let (unit, divisor) = match self.high.abs() {
            high if high >= 2e6 => ("M", 1e6),
            high if high >= 2e3 => ("k", 1e3),
            _ => ("", 1.0),
        };
        let digits = (-((self.step / divisor).log10() + 1e-9).floor()).max(0.0) as usize;
        if value == 0.0 { "0".into() } else { format!("{:.*}{unit}", digits, value / divisor) }
    }
}

/// Two axes and the pixels between which they lie.
pub struct Chart {
    pub x: Axis,
    pub y: Axis,
    /// Left and right end of the x axis.
    pub across: [f64; 2],
    /// Upper and lower end of the y axis.
    pub down: [f64; 2],
}

impl Chart {
    /// Place of a point on the paper.
    pub fn at(&self, (x, y): (f64, f64)) -> [f64; 2] {
        let ([left, right], [top, bottom]) = (self.across, self.down);
        // The part of a curve above the axis is cut off, so that the rest stays readable.
        let height = self.y.share(y).clamp(0.0, 1.02);
        [left + (right - left) * self.x.share(x), bottom - (bottom - top) * height]
    }

    /// Draws the marks of both axes.
    pub fn grid(&self, out: &mut String, color: &str) {
        let ([left, right], [top, bottom]) = (self.across, self.down);
        for value in self.y.marks() {
            let y = bottom - (bottom - top) * self.y.share(value);
            let _ = writeln!(
                out,
                "<path d=\"M{left} {y:.1}H{right}\" stroke=\"{color}\"/><text x=\"{}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>",
                left - 6.0,
                y + 4.0,
                self.y.mark(value)
            );
        }
        for value in self.x.marks() {
            let x = left + (right - left) * self.x.share(value);
            let anchor = if x > right - 20.0 { "end" } else { "middle" };
            let _ = writeln!(
                out,
                "<path d=\"M{x:.1} {bottom}v4\" stroke=\"{color}\"/><text x=\"{x:.1}\" y=\"{}\" text-anchor=\"{anchor}\">{}</text>",
                bottom + 18.0,
                self.x.mark(value)
            );
        }
    }

    pub fn line(&self, out: &mut String, points: &[(f64, f64)], style: &str, title: &str) {
        let (points, title) = (self.places(points.iter().copied()), escape(title));
        let _ = writeln!(
            out,
            "<polyline points=\"{points}\" fill=\"none\" {style}><title>{title}</title></polyline>"
        );
    }

    /// Draws the band between the least and the most of each point (x, least, most), if they differ anywhere.
    pub fn band(&self, out: &mut String, points: &[(f64, f64, f64)], color: &str) {
        if points.iter().any(|(_, min, max)| max > min) {
            let above = self.places(points.iter().map(|&(x, _, max)| (x, max)));
            let below = self.places(points.iter().rev().map(|&(x, min, _)| (x, min)));
            let _ = writeln!(out, "<polygon points=\"{above} {below}\" fill=\"{color}\" opacity=\".18\"/>");
        }
    }

    pub fn dot(&self, out: &mut String, point: (f64, f64), radius: f64, color: &str) {
        let [x, y] = self.at(point);
        let _ = writeln!(out, "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{radius}\" fill=\"{color}\"/>");
    }

    fn places(&self, points: impl Iterator<Item = (f64, f64)>) -> String {
        let place = |point| {
            let [x, y] = self.at(point);
            format!("{x:.1},{y:.1}")
        };
        points.map(place).collect::<Vec<_>>().join(" ")
    }
}
