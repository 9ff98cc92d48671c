//! Charts as SVG: axes, lines with bands, and figures of several panels.

use crate::html::{COLORS, escape};
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

    /// Draws a line through points.
    pub fn line(&self, out: &mut String, points: &[(f64, f64)], style: &str, title: &str) {
        let (points, title) = (self.places(points.iter().copied()), escape(title));
        let _ = writeln!(
            out,
            "<polyline points=\"{points}\" fill=\"none\" {style}><title>{title}</title></polyline>"
        );
    }

    /// Draws the band between the least and the most of each point (x, least, most), if they differ anywhere.
    pub fn band(&self, out: &mut String, points: &[(f64, f64, f64)], color: &str) {
        if points.iter().any(|(_, least, most)| most > least) {
            let above = self.places(points.iter().map(|&(x, _, most)| (x, most)));
            let below = self.places(points.iter().rev().map(|&(x, least, _)| (x, least)));
            let _ = writeln!(out, "<polygon points=\"{above} {below}\" fill=\"{color}\" opacity=\".18\"/>");
        }
    }

    /// Draws a dot.
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

/// A line of a panel.
pub struct Line {
    pub name: String,
    pub points: Vec<(f64, f64)>,
    /// The band around it, as for [`Chart::band`].
    pub band: Vec<(f64, f64, f64)>,
    pub width: f64,
}

/// One pair of axes of a figure.
pub struct Panel {
    pub title: String,
    /// Names of the axes.
    pub along: String,
    pub upwards: &'static str,
    pub x: Axis,
    pub y: Axis,
    pub lines: Vec<Line>,
    /// Values of y that are marked by a dashed line, if they are within the axis.
    pub levels: Vec<f64>,
}

const WIDTH: f64 = 470.0;
const HEIGHT: f64 = 360.0;
const ACROSS: [f64; 2] = [60.0, WIDTH - 22.0];
const DOWN: [f64; 2] = [36.0, HEIGHT - 56.0];
/// Height of the line with the title.
const HEAD: f64 = 30.0;
const LEGEND_WIDTH: f64 = 190.0;

/// Draws panels, two in a row, with one legend for all; readable on light and dark pages.
pub fn figure(title: &str, panels: &[Panel]) -> String {
    let mut names: Vec<&str> = Vec::new();
    for line in panels.iter().flat_map(|panel| &panel.lines) {
        if !names.contains(&line.name.as_str()) {
            names.push(&line.name);
        }
    }
    let color =
        |name: &str| COLORS[names.iter().position(|known| *known == name).unwrap_or(0) % COLORS.len()];
    let legend_left = WIDTH * panels.len().min(2) as f64;
    let width = legend_left + LEGEND_WIDTH;
    let rows_height = HEIGHT * panels.len().div_ceil(2) as f64;
    let height = HEAD + rows_height.max(50.0 + 20.0 * names.len() as f64);
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" font-family=\"sans-serif\" \
         font-size=\"12\" fill=\"#222222\">\n<rect width=\"{width}\" height=\"{height}\" fill=\"#ffffff\"/>\n\
         <text x=\"{}\" y=\"20\" text-anchor=\"middle\" font-size=\"13\">{}</text>\n",
        width / 2.0,
        escape(title)
    );
    for (i, panel) in panels.iter().enumerate() {
        let (x, y) = (WIDTH * (i % 2) as f64, HEAD + HEIGHT * (i / 2) as f64);
        let _ = writeln!(out, "<g transform=\"translate({x} {y})\">");
        panel.draw(&mut out, color);
        out.push_str("</g>\n");
    }
    for (i, name) in names.iter().enumerate() {
        let y = HEAD + DOWN[0] + 20.0 * i as f64;
        let _ = writeln!(
            out,
            "<path d=\"M{legend_left} {y}h24\" stroke=\"{}\" stroke-width=\"2\"/><text x=\"{}\" y=\"{}\">{}</text>",
            color(name),
            legend_left + 30.0,
            y + 4.0,
            escape(name)
        );
    }
    out + "</svg>\n"
}

impl Panel {
    fn draw(&self, out: &mut String, color: impl Fn(&str) -> &'static str) {
        let chart = Chart { x: self.x, y: self.y, across: ACROSS, down: DOWN };
        let middle = (ACROSS[0] + ACROSS[1]) / 2.0;
        let _ = writeln!(
            out,
            "<text x=\"{middle}\" y=\"20\" text-anchor=\"middle\">{}</text>\
             <text x=\"{middle}\" y=\"{}\" text-anchor=\"middle\">{}</text>\
             <text transform=\"translate(14 {}) rotate(-90)\" text-anchor=\"middle\">{}</text>",
            escape(&self.title),
            DOWN[1] + 40.0,
            escape(&self.along),
            (DOWN[0] + DOWN[1]) / 2.0,
            self.upwards
        );
        chart.grid(out, "#dddddd");
        for &level in self.levels.iter().filter(|level| (0.0..=1.0).contains(&self.y.share(**level))) {
            let [left, y] = chart.at((self.x.low, level));
            let dashed = "stroke=\"#888888\" stroke-dasharray=\"5 4\"";
            let _ = writeln!(out, "<path d=\"M{left} {y:.1}H{}\" {dashed}/>", ACROSS[1]);
        }
        for Line { name, points, band, width } in &self.lines {
            let color = color(name);
            chart.band(out, band, color);
            chart.line(out, points, &format!("stroke=\"{color}\" stroke-width=\"{width}\""), name);
            points.iter().for_each(|&point| chart.dot(out, point, 2.2, color));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn marks_are_round() {
        let marks = |axis: Axis| axis.marks().map(|value| axis.mark(value)).collect::<Vec<_>>();
        assert_eq!(marks(Axis::new(0.0, 0.23)), ["0", "0.05", "0.10", "0.15", "0.20", "0.25"]);
        assert_eq!(marks(Axis::new(17.3, 31.1)), ["15", "20", "25", "30", "35"]);
        assert_eq!(Axis::new(0.0, 30_000.0).mark(20_000.0), "20k");
        // A single value, or only zeros.
        for axis in [Axis::new(5.0, 5.0), Axis::new(0.0, 0.0)] {
            assert!(axis.marks().count() >= 2);
        }
    }
}
