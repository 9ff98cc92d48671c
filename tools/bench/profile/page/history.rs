//! Columns of the stages' times, one per iteration.

use super::Stages;
use crate::measure::Measured;
use ashsplat_program::html::{escape, shown};
use std::fmt::Write;

const WIDTH: f64 = 1120.0;

/// Stacked columns of device time, one per iteration, with the wall time as a line.
pub fn svg(stages: &Stages, measured: &Measured) -> String {
    let walls: Vec<f64> = measured.iterations.iter().map(|i| i.wall.as_secs_f64() * 1e3).collect();
    let largest = walls.iter().copied().fold(1e-12, f64::max);
    let (height, left) = (190.0, 60.0);
    let column = (WIDTH - left) / walls.len().max(1) as f64;
    let place = |ms: f64| height - 20.0 - ms / largest * (height - 40.0);
    let mut out = format!("<svg width=\"{WIDTH}\" height=\"{height}\">\n");
    for share in [0.0, 0.5, 1.0] {
        let (ms, y) = (largest * share, place(largest * share));
        let _ = writeln!(
            out,
            "<path d=\"M{left} {y:.1}H{WIDTH}\" stroke=\"#8884\"/><text x=\"{}\" y=\"{:.1}\" text-anchor=\"end\">{ms:.1} ms</text>",
            left - 5.0,
            y + 4.0
        );
    }
    for (i, iteration) in measured.iterations.iter().enumerate() {
        let (x, mut below) = (left + column * i as f64, 0.0);
        for stage in stages.iter() {
            let ms = stages.milliseconds(stage, iteration);
            let (top, bottom) = (place(below + ms), place(below));
            below += ms;
            let _ = writeln!(
                out,
                "<rect x=\"{x:.2}\" y=\"{top:.2}\" width=\"{:.2}\" height=\"{:.2}\" fill=\"{}\"><title>iteration {i}, {}: {ms:.3} ms</title></rect>",
                (column - 1.0).max(0.5),
                bottom - top,
                stages.color(stage),
                escape(shown(stage))
            );
        }
    }
    let points = walls
        .iter()
        .enumerate()
        .map(|(i, &wall)| format!("{:.1},{:.1}", left + column * (i as f64 + 0.5), place(wall)));
    let points = points.collect::<Vec<_>>().join(" ");
    let _ = writeln!(
        out,
        "<polyline points=\"{points}\" fill=\"none\" stroke=\"currentColor\" stroke-width=\"1.5\"/></svg>"
    );
    out
}
