//! The log of a run as curves.

use ashsplat_program::chart::{Axis, Chart};
use ashsplat_program::html::escape;
use ashsplat_program::train_log::Rows;
use std::fmt::Write;

const WIDTH: f64 = 560.0;
const HEIGHT: f64 = 220.0;
const ACROSS: [f64; 2] = [56.0, WIDTH - 14.0];
const DOWN: [f64; 2] = [12.0, HEIGHT - 28.0];
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
    let x_axis = Axis { low: first.x.min(1.0), high, ..Axis::new(0.0, high) };
    let chart = Chart { x: x_axis, y: y_axis, across: ACROSS, down: DOWN };
    chart.grid(&mut out, "var(--line)");
    let color = curve.color;
    let band: Vec<(f64, f64, f64)> = bins.iter().map(|b| (b.x, b.low, b.high)).collect();
    chart.band(&mut out, &band, color);
    let means: Vec<(f64, f64)> = bins.iter().map(|b| (b.x, b.mean)).collect();
    chart.line(&mut out, &means, &format!("stroke=\"{color}\" stroke-width=\"1.8\""), curve.title);
    let dots = means.iter().filter(|_| curve.dots || bins.len() == 1);
    dots.for_each(|&mean| chart.dot(&mut out, mean, 3.2, color));
    let point = |&(iteration, mean): &(f64, f64)| {
        let [x, y] = chart.at((iteration, mean));
        format!("[{x:.1},{y:.1},{iteration:.0},\"{}\"]", number(mean, curve.digits))
    };
    let data: Vec<String> = means.iter().map(point).collect();
    let _ = writeln!(
        out,
        "<path class=\"cursor\" d=\"\" stroke=\"currentColor\" opacity=\".5\"/><circle class=\"cursor\" r=\"0\" fill=\"{color}\"/>\
         <script type=\"application/json\">[{}]</script></svg>",
        data.join(",")
    );
    out
}

/// A number with thousands separators, or with `digits` digits.
fn number(value: f64, digits: usize) -> String {
    if digits == 0 {
        ashsplat_program::progress::thousands(value.round().max(0.0) as u64)
    } else {
        format!("{value:.digits$}")
    }
}
