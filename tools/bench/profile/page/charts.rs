//! Bar and area charts.

use super::Stages;
use crate::measure::Measured;
use crate::schema::{Run, Spread};
use ashsplat_program::html::{escape, shown};
use std::fmt::Write;

const WIDTH: f64 = 1120.0;
const LEFT: f64 = 130.0;

/// One bar per stage.
pub fn stages(stages: &Stages, measured: &Measured) -> String {
    let rows: Vec<Row> = stages
        .iter()
        .filter_map(|stage| {
            let times = measured.iterations.iter().map(|iteration| stages.milliseconds(stage, iteration));
            let spread = Spread::of(times.collect())?;
            let text = format!("{:.3} ms", spread.median);
            Some(Row {
                name: shown(stage).to_owned(),
                value: spread.median,
                most: spread.p90,
                text,
                color: stages.color(stage),
            })
        })
        .collect();
    bars(&rows)
}

/// One bar per arena.
pub fn memory(run: &Run) -> String {
    let row = |arena: &crate::schema::Arena| {
        let value = arena.peak_bytes as f64;
        let text = format!("{:.2} MiB", value / 1_048_576.0);
        Row { name: arena.name.clone(), value, most: value, text, color: "#4e79a7" }
    };
    bars(&run.memory.iter().map(row).collect::<Vec<_>>())
}

struct Row {
    name: String,
    value: f64,
    /// End of the whisker.
    most: f64,
    text: String,
    color: &'static str,
}

fn bars(rows: &[Row]) -> String {
    let largest = rows.iter().map(|row| row.most.max(row.value)).fold(1e-12, f64::max);
    let height = 20.0 * rows.len() as f64 + 4.0;
    let mut out = format!("<svg width=\"{WIDTH}\" height=\"{height}\">\n");
    for (i, row) in rows.iter().enumerate() {
        let scale = (WIDTH - LEFT - 90.0) / largest;
        let (y, width) = (20.0 * i as f64 + 2.0, row.value * scale);
        let end = LEFT + row.most.max(row.value) * scale;
        let _ = writeln!(
            out,
            "<text x=\"{}\" y=\"{}\" text-anchor=\"end\">{}</text>\
             <rect x=\"{LEFT}\" y=\"{y}\" width=\"{width:.2}\" height=\"16\" fill=\"{}\"/>\
             <path d=\"M{:.2} {}H{end:.2}\" stroke=\"currentColor\"/><text x=\"{:.2}\" y=\"{}\">{}</text>",
            LEFT - 6.0,
            y + 12.0,
            escape(&row.name),
            row.color,
            LEFT + width,
            y + 8.0,
            end + 6.0,
            y + 12.0,
            escape(&row.text)
        );
    }
    out.push_str("</svg>\n");
    out
}

/// Stacked columns of device time, one per iteration, with the wall time as a line.
pub fn history(stages: &Stages, measured: &Measured) -> String {
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
