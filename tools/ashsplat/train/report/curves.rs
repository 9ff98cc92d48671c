//! The log of a run as curves.

use ashsplat_program::html::escape;
use ashsplat_program::train_log::Rows;
use std::fmt::Write;

const WIDTH: f64 = 560.0;
const HEIGHT: f64 = 220.0;
/// Ends of the axes.
const LEFT: f64 = 56.0;
const RIGHT: f64 = WIDTH - 14.0;
const TOP: f64 = 12.0;
const BOTTOM: f64 = HEIGHT - 28.0;
/// Approximate number of marks on an axis.
const MARKS: f64 = 5.0;
/// Largest number of points of a curve; more iterations are grouped.
const POINTS: usize = 280;

/// One pair of axes over the iterations.
struct Curve {
    title: &'static str,
    /// Text after a value.
    unit: &'static str,
    color: &'static str,
    digits: usize,
    points: Vec<(f64, f64)>,
    /// True if the points are few and shown one by one.
    dots: bool,
    from_zero: bool,
}

/// Draws loss, PSNR, Gaussians and speed. The PSNR is that of the tracked views if they were measured; `tracked` names
/// them.
pub fn charts(rows: &Rows, tested_on: &str, tracked: &str) -> String {
    let of = |column: &[f64]| rows.iterations.iter().copied().zip(column.iter().copied()).collect::<Vec<_>>();
    // Not every iteration is tested, and a skipped one has no loss.
    let known = |column: &[f64]| of(column).into_iter().filter(|(_, y)| y.is_finite()).collect::<Vec<_>>();
    let (psnr, tracked_psnr, loss) = (known(&rows.psnr), known(&rows.tracked_psnr), known(&rows.loss));
    let (psnr, measured) = match tracked_psnr.is_empty() {
        true => (psnr, format!("mean of the {tested_on} views where they were tested")),
        false => (tracked_psnr, tracked.to_owned()),
    };
    let end = rows.iterations.last().copied().unwrap_or(1.0);
    let curve = |title, unit, color, digits, points| Curve {
        title,
        unit,
        color,
        digits,
        points,
        dots: false,
        from_zero: true,
    };
    let curves = [
        (
            curve("Loss", "", "var(--a)", 4, loss),
            "0.8 L1 + 0.2 (1 − SSIM) by default, of one view each".into(),
        ),
        (Curve { dots: true, from_zero: false, ..curve("PSNR", " dB", "var(--b)", 2, psnr) }, measured),
        (curve("Gaussians", "", "var(--c)", 0, of(&rows.gaussians)), "after each iteration".to_owned()),
        (curve("Speed", " it/s", "var(--d)", 1, speed(rows)), "tests and saving not counted".to_owned()),
    ];
    let mut out = String::from("<div class=\"charts\">\n");
    for (curve, note) in &curves {
        let last = curve.points.last().map(|&(_, value)| value);
        let last =
            last.map(|value| format!("{}{}", number(value, curve.digits), curve.unit)).unwrap_or_default();
        let _ = writeln!(
            out,
            "<figure class=\"chart\"><figcaption><b>{}</b><span>{}</span><output>{last}</output></figcaption>{}</figure>",
            curve.title,
            escape(note),
            svg(curve, end)
        );
    }
    out.push_str("</div>\n");
    out
}

/// Several iterations as one point.
#[derive(Clone, Copy)]
struct Bin {
    x: f64,
    mean: f64,
    low: f64,
    high: f64,
}

fn bins(points: &[(f64, f64)]) -> Vec<Bin> {
    let size = points.len().div_ceil(POINTS).max(1);
    let bin = |part: &[(f64, f64)]| Bin {
        x: part.iter().map(|p| p.0).sum::<f64>() / part.len() as f64,
        mean: part.iter().map(|p| p.1).sum::<f64>() / part.len() as f64,
        low: part.iter().map(|p| p.1).fold(f64::INFINITY, f64::min),
        high: part.iter().map(|p| p.1).fold(f64::NEG_INFINITY, f64::max),
    };
    points.chunks(size).map(bin).collect()
}

/// Iterations per second, averaged over neighbouring iterations.
fn speed(rows: &Rows) -> Vec<(f64, f64)> {
    let size = rows.iterations.len().div_ceil(POINTS / 2).max(1);
    let parts = rows.iterations.chunks(size).zip(rows.milliseconds.chunks(size));
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    parts.map(|(iterations, ms)| (mean(iterations), 1e3 / mean(ms).max(1e-3))).collect()
}

fn svg(curve: &Curve, end: f64) -> String {
    let bins = bins(&curve.points);
    let mut out = format!("<svg viewBox=\"0 0 {WIDTH} {HEIGHT}\" data-unit=\"{}\">\n", curve.unit);
    let Some(first) = bins.first() else {
        let (x, y) = (WIDTH / 2.0, HEIGHT / 2.0);
        let _ = writeln!(
            out,
            "<text x=\"{x}\" y=\"{y}\" text-anchor=\"middle\" opacity=\".6\">never measured</text></svg>"
        );
        return out;
    };
    // The worst single iterations may exceed the axis, so that the curve stays readable.
    let mut tops: Vec<f64> = bins.iter().map(|b| b.high).collect();
    tops.sort_by(f64::total_cmp);
    let high =
        tops[(tops.len() - 1) * 98 / 100].max(bins.iter().map(|b| b.mean).fold(f64::NEG_INFINITY, f64::max));
    let low = bins.iter().map(|b| b.low).fold(f64::INFINITY, f64::min);
    let y_axis = Axis::new(if curve.from_zero { low.min(0.0) } else { low }, high);
    let high = end.max(first.x + 1.0);
    let x_axis = Axis { low: first.x.min(1.0), high, ..Axis::new(0.0, high) };
    grid(&mut out, &x_axis, &y_axis);
    let at = |(x, y): (f64, f64)| {
        // The part of a curve above the axis is cut off, so that the rest stays readable.
        let height = y_axis.share(y).clamp(0.0, 1.02);
        [LEFT + (RIGHT - LEFT) * x_axis.share(x), BOTTOM - (BOTTOM - TOP) * height]
    };
    let places = |points: &mut dyn Iterator<Item = (f64, f64)>| {
        points.map(at).map(|[x, y]| format!("{x:.1},{y:.1}")).collect::<Vec<_>>().join(" ")
    };
    let (color, title) = (curve.color, escape(curve.title));
    // From the least to the most of each point, if they differ anywhere.
    if bins.iter().any(|b| b.high > b.low) {
        let above = places(&mut bins.iter().map(|b| (b.x, b.high)));
        let below = places(&mut bins.iter().rev().map(|b| (b.x, b.low)));
        let _ = writeln!(out, "<polygon points=\"{above} {below}\" fill=\"{color}\" opacity=\".18\"/>");
    }
    let _ = writeln!(
        out,
        "<polyline points=\"{}\" fill=\"none\" stroke=\"{color}\" stroke-width=\"1.8\"><title>{title}</title></polyline>",
        places(&mut bins.iter().map(|b| (b.x, b.mean)))
    );
    for bin in bins.iter().filter(|_| curve.dots || bins.len() == 1) {
        let [x, y] = at((bin.x, bin.mean));
        let _ = writeln!(out, "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"3.2\" fill=\"{color}\"/>");
    }
    let point = |bin: &Bin| {
        let [x, y] = at((bin.x, bin.mean));
        format!("[{x:.1},{y:.1},{:.0},\"{}\"]", bin.x, number(bin.mean, curve.digits))
    };
    let data: Vec<String> = bins.iter().map(point).collect();
    let _ = writeln!(
        out,
        "<path class=\"cursor\" d=\"\" stroke=\"currentColor\" opacity=\".5\"/><circle class=\"cursor\" r=\"0\" fill=\"{color}\"/>\
         <script type=\"application/json\">[{}]</script></svg>",
        data.join(",")
    );
    out
}

/// An axis with marks at 1, 2 or 5 times a power of ten.
struct Axis {
    low: f64,
    high: f64,
    /// Distance of marks.
    step: f64,
}

impl Axis {
    fn new(low: f64, high: f64) -> Self {
        let span = (high - low).max(high.abs() * 0.05).max(1e-6);
        let rough = span / MARKS;
        let power = 10f64.powf(rough.log10().floor());
        let step =
            [1.0, 2.0, 5.0, 10.0].map(|n| n * power).into_iter().find(|step| *step >= rough).unwrap_or(rough);
        let ends = ((low / step + 1e-9).floor() * step, (high / step - 1e-9).ceil() * step);
        Self { low: ends.0, high: ends.1.max(ends.0 + step), step }
    }

    /// Position of a value: 0 at the beginning, 1 at the end.
    fn share(&self, value: f64) -> f64 {
        (value - self.low) / (self.high - self.low)
    }

    fn marks(&self) -> impl Iterator<Item = f64> {
        let (first, last) =
            ((self.low / self.step).ceil() as i64, (self.high / self.step + 1e-6).floor() as i64);
        (first..=last).map(|n| n as f64 * self.step)
    }

    /// A value with as many digits as the marks need.
    fn mark(&self, value: f64) -> String {
        let (unit, divisor) = match self.high.abs() {
            high if high >= 2e6 => ("M", 1e6),
            high if high >= 2e3 => ("k", 1e3),
            _ => ("", 1.0),
        };
        let digits = (-((self.step / divisor).log10() + 1e-9).floor()).max(0.0) as usize;
        if value == 0.0 { "0".into() } else { format!("{:.*}{unit}", digits, value / divisor) }
    }
}

fn grid(out: &mut String, x_axis: &Axis, y_axis: &Axis) {
    for value in y_axis.marks() {
        let y = BOTTOM - (BOTTOM - TOP) * y_axis.share(value);
        let _ = writeln!(
            out,
            "<path d=\"M{LEFT} {y:.1}H{RIGHT}\" stroke=\"var(--line)\"/><text x=\"{}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>",
            LEFT - 6.0,
            y + 4.0,
            y_axis.mark(value)
        );
    }
    for value in x_axis.marks() {
        let x = LEFT + (RIGHT - LEFT) * x_axis.share(value);
        let anchor = if x > RIGHT - 20.0 { "end" } else { "middle" };
        let _ = writeln!(
            out,
            "<path d=\"M{x:.1} {BOTTOM}v4\" stroke=\"var(--line)\"/><text x=\"{x:.1}\" y=\"{}\" text-anchor=\"{anchor}\">{}</text>",
            BOTTOM + 18.0,
            x_axis.mark(value)
        );
    }
}

/// A number with thousands separators, or with `digits` digits.
fn number(value: f64, digits: usize) -> String {
    if digits == 0 {
        ashsplat_program::progress::thousands(value.round().max(0.0) as u64)
    } else {
        format!("{value:.digits$}")
    }
}
