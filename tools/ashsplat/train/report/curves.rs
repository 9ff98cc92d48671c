//! The log of a run as curves.

use ashsplat_program::axis::Axis;
use ashsplat_program::html::escape;
use ashsplat_program::train_log::Rows;
use std::fmt::Write;

const WIDTH: f64 = 560.0;
const HEIGHT: f64 = 220.0;
const LEFT: f64 = 56.0;
const RIGHT: f64 = 14.0;
const TOP: f64 = 12.0;
const BOTTOM: f64 = 28.0;
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
    /// True if the axis begins at 0.
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

/// Draws a curve up to iteration `end`.
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
    let x_axis = Axis { low: first.x.min(1.0), high, step: Axis::new(0.0, high).step };
    let x = |value: f64| LEFT + (WIDTH - LEFT - RIGHT) * x_axis.share(value);
    let y = |value: f64| HEIGHT - BOTTOM - (HEIGHT - TOP - BOTTOM) * y_axis.share(value).clamp(0.0, 1.02);
    grid(&mut out, &x_axis, &y_axis, (&x, &y));
    let line = |value: &dyn Fn(&Bin) -> f64, bins: &mut dyn Iterator<Item = &Bin>| {
        bins.map(|b| format!("{:.1},{:.1}", x(b.x), y(value(b)))).collect::<Vec<_>>().join(" ")
    };
    let color = curve.color;
    if bins.iter().any(|b| b.high > b.low) {
        let (above, below) = (line(&|b| b.high, &mut bins.iter()), line(&|b| b.low, &mut bins.iter().rev()));
        let _ = writeln!(out, "<polygon points=\"{above} {below}\" fill=\"{color}\" opacity=\".18\"/>");
    }
    let points = line(&|b| b.mean, &mut bins.iter());
    let _ = writeln!(
        out,
        "<polyline points=\"{points}\" fill=\"none\" stroke=\"{color}\" stroke-width=\"1.8\"/>"
    );
    for b in bins.iter().filter(|_| curve.dots || bins.len() == 1) {
        let _ = writeln!(
            out,
            "<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"3.2\" fill=\"{color}\"/>",
            x(b.x),
            y(b.mean)
        );
    }
    let data: Vec<String> = bins
        .iter()
        .map(|b| format!("[{:.1},{:.1},{:.0},\"{}\"]", x(b.x), y(b.mean), b.x, number(b.mean, curve.digits)))
        .collect();
    let _ = writeln!(
        out,
        "<path class=\"cursor\" d=\"\" stroke=\"currentColor\" opacity=\".5\"/><circle class=\"cursor\" r=\"0\" fill=\"{color}\"/>\
         <script type=\"application/json\">[{}]</script></svg>",
        data.join(",")
    );
    out
}

type Place<'a> = &'a dyn Fn(f64) -> f64;

fn grid(out: &mut String, x_axis: &Axis, y_axis: &Axis, (x, y): (Place, Place)) {
    let right = WIDTH - RIGHT;
    for value in y_axis.marks() {
        let at = y(value);
        let _ = writeln!(
            out,
            "<path d=\"M{LEFT} {at:.1}H{right}\" stroke=\"var(--line)\"/><text x=\"{}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>",
            LEFT - 7.0,
            at + 4.0,
            y_axis.mark(value)
        );
    }
    for value in x_axis.marks() {
        let (at, bottom) = (x(value), HEIGHT - BOTTOM);
        let anchor = if at > right - 20.0 { "end" } else { "middle" };
        let _ = writeln!(
            out,
            "<path d=\"M{at:.1} {bottom}v4\" stroke=\"var(--line)\"/><text x=\"{at:.1}\" y=\"{}\" text-anchor=\"{anchor}\">{}</text>",
            bottom + 18.0,
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn many_iterations_become_few_points() {
        let points: Vec<(f64, f64)> = (1..=30_000).map(|i| (f64::from(i), f64::from(i % 100))).collect();
        let bins = bins(&points);
        assert!(bins.len() <= POINTS && bins.iter().all(|b| b.low == 0.0 && b.high == 99.0));
    }
}
